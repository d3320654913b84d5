"""`python -m fuzz_house --minutes n`: every target in turn, and what they found."""

import argparse
import os
import resource
import shutil
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from fuzz_house import rust, seeds
from fuzz_house.core_calls import Caller, stub_entries
from hostile import evidence

CANARIES = 10
SHARES = {"rust": 0.7, "readers": 0.2, "_core": 0.1}
"""Of the time, by what is attacked."""


def core_calls(seconds: float, seed: int, kept: Path) -> dict[str, Any]:
    """Calls of `_core` in children; a call that ends one, or panics, is a finding."""
    kept.mkdir(parents=True, exist_ok=True)
    until, findings, calls = time.monotonic() + seconds, [], 0
    while time.monotonic() < until and len(findings) < 3:
        ours, theirs = os.pipe()
        sys.stdout.flush()
        child = os.fork()
        if child == 0:
            os.close(ours)
            try:
                _call_all(seed, until, theirs, kept / "last.txt")
            finally:
                os._exit(1)
        os.close(theirs)
        with os.fdopen(ours) as said:
            numbers = said.read().split()
        calls += int(numbers[-1]) if numbers else 0
        _, status = os.waitpid(child, 0)
        for place in kept.glob("tmp*"):
            shutil.rmtree(place)
        if os.waitstatus_to_exitcode(status):
            last = (kept / "last.txt").read_text(errors="replace")
            findings.append(f"seed {seed}: exit {os.waitstatus_to_exitcode(status)}: {last[:600]}")
        seed += 1
    return {"executions": calls, "edges": 0, "findings": findings}


def _call_all(seed: int, until: float, pipe: int, last: Path) -> None:
    memory = 3 * 2**30
    resource.setrlimit(resource.RLIMIT_AS, (memory, memory))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    caller, count = Caller(seed), 0
    names, rng = list(caller.entries), np.random.default_rng(seed)
    stop = min(
        until, time.monotonic() + 30
    )  # a new child now and then: each has objects of its own
    told = os.open(last.resolve(), os.O_CREAT | os.O_TRUNC | os.O_WRONLY)
    os.chdir(tempfile.mkdtemp(dir=last.parent))  # some calls write files
    error = ""
    while time.monotonic() < stop and not error:
        name = names[rng.integers(len(names))]
        try:
            caller.call(name)
        except BaseException as raised:
            error = f"{type(raised).__name__}: {raised}"
        count += 1
        os.pwrite(told, (error + " in " + caller.last).encode("utf-8", "replace").ljust(3000), 0)
        if count % 100 == 0:
            os.write(pipe, f"{count}\n".encode())
    os.write(pipe, f"{count}\n".encode())
    os._exit(1 if error else 0)


def turns(chosen: list[str], minutes: float, folder: Path, seed: int) -> Iterator[tuple[str, Any]]:
    """The result of every target, named by its kind."""
    names = rust.targets()
    wanted = [name for name in names if not chosen or name in chosen]
    if wanted:
        driver = rust.build(folder / "build")
        seeds.fresh(folder)
        share = 1.0 if chosen else SHARES["rust"]
        for name, told in rust.run_all(driver, wanted, 60 * minutes * share, folder, seed):
            yield f"rust {name}", vars(told)
    if chosen and set(chosen) <= set(names):
        return
    from fuzz_house import readers

    readers.warm_up()
    with tempfile.TemporaryDirectory() as place:
        found = readers.seeds(Path(place) / "seeds")
        wanted = [name for name in found if not chosen or name in chosen]
        for name in wanted:
            share = 1.0 if chosen else SHARES["readers"]
            seconds = 60 * minutes * share / len(wanted)
            kept = folder / "findings" / f"reader{name}"
            yield f"reader {name}", readers.run(name, found[name], seconds, kept, seed)
    if not chosen or "_core" in chosen:
        seconds = 60 * minutes * (1.0 if chosen else SHARES["_core"])
        yield "_core calls", core_calls(seconds, seed, folder / "findings" / "core")


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m fuzz_house", description=__doc__)
    parser.add_argument("--minutes", type=float, default=10.0, help="for all targets together")
    parser.add_argument("--target", action="append", default=[], help="only these")
    parser.add_argument("--seed", type=int, default=int(time.time()) % 2**31)
    parser.add_argument("--folder", type=Path, default=Path("target/fuzz"))
    parser.add_argument("--evidence", action="store_true", help="add the counts to docs/evidence")
    parser.add_argument("--keep", type=int, help="copy so many inputs per Rust target to git")
    chosen = parser.parse_args()
    findings, canaries, counts = [], set(), {}
    for name, told in turns(chosen.target, chosen.minutes, chosen.folder, chosen.seed):
        canaries |= told.get("canaries", set())
        findings += [f"{name}: {one}" for one in told["findings"]]
        bad = len(told["findings"])
        met = "".join(f", planted bug {number}" for number in sorted(told.get("canaries", ())))
        counts[name] = {"ok": told["executions"] - bad, "untyped": bad}
        print(
            f"{name}: {told['executions']:,} executions, {told['edges']:,} edges,"
            f" {bad} findings{met}"
        )
        sys.stdout.flush()
    if chosen.keep is not None:
        driver = rust.build(chosen.folder / "build")
        for name in rust.targets():
            print(
                f"{name}: {rust.minimised(driver, name, chosen.folder, chosen.keep)} files in git"
            )
    total = sum(sum(one.values()) for one in counts.values())
    spent = resource.getrusage(resource.RUSAGE_CHILDREN)
    print(
        f"{total:,} executions of {len(counts)} targets, seed {chosen.seed},"
        f" {(spent.ru_utime + spent.ru_stime) / 60:.1f} minutes of processor time;"
        f" {len(findings)} findings"
    )
    print(f"{len(canaries)} of {CANARIES} planted bugs found: {sorted(canaries)}")
    for finding in findings:
        print(finding)
    if chosen.evidence:
        evidence.add("fuzz house", counts)
    idle = [name for name, told in counts.items() if not sum(told.values())]
    if idle:
        print(f"never ran: {', '.join(idle)}")
    return 1 if findings or idle else 0


if __name__ == "__main__":
    assert stub_entries()
    sys.exit(main())
