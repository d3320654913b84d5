"""Runs of the Rust targets of `tests/rust/fuzz` under libFuzzer."""

import os
import re
import shutil
import subprocess
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass, field
from pathlib import Path

ROOT = Path(__file__).parents[2]
TARGETS = re.compile(r'^    \("(\w+)", (\w+)::(\w+)\),$', re.MULTILINE)
MOD = ROOT / "tests" / "rust" / "fuzz" / "mod.rs"
CORPUS = ROOT / "tests" / "rust" / "fuzz" / "corpus"
LONGEST = {
    **dict.fromkeys(("lcvm", "state_map", "state_many"), 9000),
    **dict.fromkeys(("state_tracker", "state_filter"), 3000),
    "state_detector": 12000,
}
"""Longest input [bytes], where it is not `USUAL`: a longer seed is cut, and says nothing."""
SLOW = {"rooms": 4, "detector": 2, "filter": 3, "many": 2, "clusters": 2}
"""How many times the time of others a target gets: a run of it is long."""
USUAL = 1500
MOST_FINDINGS = 3
"""Of one target in one run: the rest is most likely the same bug."""
MEMORY = 3 * 2**30
"""Address space of a run [bytes]; what does not fit is refused, as it is on a small machine."""
LIMITED = ("/bin/sh", "-c", f'ulimit -c 0; ulimit -v {MEMORY // 1024}; exec "$0" "$@"')


@dataclass
class Told:
    """What one run of a target says.

    Attributes
    ----------
    executions, edges : int
        Inputs that were run, and edges of the program that were reached.
    findings : list of Path
        Inputs that crash, hang, or take too much memory.
    canaries : set of int
        Planted bugs that were met.
    """

    executions: int = 0
    edges: int = 0
    findings: list[Path] = field(default_factory=list)
    canaries: set[int] = field(default_factory=set)


def targets() -> list[str]:
    """Names of all Rust targets."""
    return [found[0] for found in TARGETS.findall(MOD.read_text())]


def shares(wanted: list[str]) -> dict[str, float]:
    """Share of the time that each target gets."""
    weights = {name: SLOW.get(name, 1) for name in wanted}
    return {name: weight / sum(weights.values()) for name, weight in weights.items()}


def build(folder: Path) -> Path:
    """The driver, built in `folder`."""
    environment = os.environ | {
        "CARGO_TARGET_DIR": str(folder.resolve()),
        "RUSTC_WRAPPER": str(ROOT / "fuzz" / "rustc.sh"),
    }
    told = ["cargo", "build", "--release", "--locked", "--quiet"]
    subprocess.run(told, cwd=ROOT / "fuzz", env=environment, check=True)
    return folder / "release" / "lidar_core_fuzz"


def run_all(
    driver: Path, wanted: list[str], seconds: float, folder: Path, seed: int
) -> Iterator[tuple[str, Told]]:
    """Run all these targets for `seconds`, one on every core; each result when it is there."""
    cores = len(os.sched_getaffinity(0))
    with ThreadPoolExecutor(min(cores, len(wanted))) as pool:
        slowest_first = sorted(shares(wanted).items(), key=lambda item: -item[1])
        works = {}
        for name, part in slowest_first:
            own = min(seconds, seconds * part * min(cores, len(wanted)))
            works[pool.submit(run, driver, name, own, folder, seed)] = name
        for done in as_completed(works):
            yield works[done], done.result()


def run(driver: Path, target: str, seconds: float, folder: Path, seed: int) -> Told:
    """Run `target` for `seconds`; its corpus in `folder` grows from run to run."""
    grown, found = folder / "corpus" / target, folder / "findings" / target
    for place in (grown, found):
        place.mkdir(parents=True, exist_ok=True)
    known, told, until = set(found.iterdir()), Told(), time.monotonic() + seconds
    while (left := round(until - time.monotonic())) >= 1 and len(told.findings) < MOST_FINDINGS:
        options = {
            "max_total_time": left,
            "max_len": LONGEST.get(target, USUAL),
            "timeout": 10,
            "rss_limit_mb": 1024,
            "seed": seed + len(told.findings),
            "print_final_stats": 1,
            "use_value_profile": 1,
            "len_control": 0,
            "artifact_prefix": f"{found}/",
        }
        done = subprocess.run(
            [
                *LIMITED,
                driver,
                grown,
                CORPUS / target,
                *(f"-{key}={value}" for key, value in options.items()),
            ],
            env=os.environ | {"LIDAR_CORE_TARGET": target, "RUST_BACKTRACE": "1"},
            capture_output=True,
            text=True,
            errors="replace",
            check=False,
        )
        said = done.stderr
        told.executions += sum(map(int, re.findall(r"number_of_executed_units: (\d+)", said)))
        told.edges = max([told.edges, *map(int, re.findall(r" cov: (\d+)", said))])
        told.canaries |= set(map(int, re.findall(r"^met canary (\d+)", said, re.MULTILINE)))
        new = set(found.iterdir()) - known
        known |= new
        told.findings += sorted(new)
        for path in new:
            path.with_suffix(".txt").write_text(said[-20_000:])
            known.add(path.with_suffix(".txt"))
        if done.returncode and not new:  # what an earlier run found, or the driver itself broke
            again = found / "again.txt"
            again.write_text(said[-20_000:])
            told.findings.append(again)
            break
    return told


def minimised(driver: Path, target: str, folder: Path, most: int) -> int:
    """Write the smallest inputs that reach all of the corpus to git's folder; their number."""
    grown, small = folder / "corpus" / target, folder / "merged" / target
    shutil.rmtree(small, ignore_errors=True)
    small.mkdir(parents=True)
    subprocess.run(
        [
            driver,
            "-merge=1",
            f"-max_len={LONGEST.get(target, USUAL)}",
            small,
            CORPUS / target,
            grown,
        ],
        env=os.environ | {"LIDAR_CORE_TARGET": target},
        capture_output=True,
        check=True,
    )
    kept = CORPUS / target
    kept.mkdir(parents=True, exist_ok=True)
    # Of the largest number of features first: libFuzzer writes them in this order of size.
    for path in sorted(small.iterdir(), key=lambda path: path.stat().st_size)[-most:]:
        shutil.copy(path, kept / path.name[:12])
    return len(list(kept.iterdir()))
