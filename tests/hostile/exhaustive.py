"""`python -m hostile.exhaustive`: every cut and every damaged byte of one good file per format.

Each file is cut at every offset, and at every offset one byte becomes 0x00, 0xFF, itself with the
lowest bit turned, and with the highest. All must end in a result, a typed error or an error of the
system; what a checksum seals must be refused.
"""

import argparse
import json
import os
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from hostile import entries, evidence
from hostile.__main__ import warm_up
from hostile.child import CPU, MEMORY, _said, run_limited
from hostile.seeds import Seed, seeds_of

CHANGES = (lambda _: 0x00, lambda _: 0xFF, lambda byte: byte ^ 1, lambda byte: byte ^ 0x80)
BATCH = 200
"""Files that one child reads, one after another."""
SEALED = (".lcst", ".lcvm")
"""Endings of files whose every byte is under a checksum."""


def fixtures(root: Path) -> dict[str, tuple[Seed, entries.Entry]]:
    """The smallest good file of every format, and what reads it in one process."""
    found = {}
    for name, seeds in seeds_of(root / "seeds", None).items():
        for seed in sorted(seeds, key=lambda one: len(one.data)):
            entry = next((one for one in seed.entries if _reads(root / "good", seed, one)), None)
            if entry is not None:
                found[name] = (seed, entry)
                break
    return found


def _reads(folder: Path, seed: Seed, entry: entries.Entry) -> bool:
    folder.mkdir(exist_ok=True)
    path = _laid(folder, seed, seed.data)
    return run_limited(lambda: _trusted(entry, path)).kind == "ok"


def _laid(folder: Path, seed: Seed, data: bytes) -> Path:
    for name, content in {**seed.beside, seed.name: data}.items():
        (folder / name).write_bytes(content)
    return folder / seed.name


def _trusted(entry: entries.Entry, path: Path) -> None:
    from lidar_core.io import trusted_files

    with trusted_files():
        entry(path)


def corruptions(data: bytes, step: int, first: int = 0) -> Iterator[tuple[str, bytes]]:
    """What is done to a file, and its bytes then; of every `step`-th offset from `first` on."""
    for at in range(first, len(data), step):
        yield f"cut at {at}", data[:at]
        for change in CHANGES:
            byte = change(data[at])
            if byte != data[at]:
                yield f"byte {at} is {byte:#04x}", data[:at] + bytes([byte]) + data[at + 1 :]


def attack(
    seed: Seed, entry: entries.Entry, step: int, folder: Path, first: int = 0
) -> tuple[Counter[str], list[str]]:
    """Read every corruption of a file; how many ended how, and those that ended badly."""
    totals, bad = Counter[str](), list[str]()
    waiting = list(corruptions(seed.data, step, first))
    while waiting:
        said = _batch(seed, entry, waiting[:BATCH], folder)
        for (how, _), kind in zip(waiting, said, strict=False):
            word = kind.partition(" ")[0]
            if word == "ok" and seed.name.endswith(SEALED):
                word = "accepted though sealed"
            totals[word] += 1
            if word not in ("ok", "typed"):
                bad.append(f"{seed.name}, {how}, by {entry.__name__}: {word}: {kind}")
        waiting = waiting[len(said) :]
    return totals, bad


def _batch(
    seed: Seed, entry: entries.Entry, files: list[tuple[str, bytes]], folder: Path
) -> list[str]:
    """How files were read by one child; the last one may have ended it."""
    told = folder / "told"
    told.write_text("")

    def work() -> None:
        with told.open("a") as lines:
            for _, data in files:
                path = _laid(folder, seed, data)
                text = _said(lambda path=path: _trusted(entry, path))
                lines.write(json.dumps(text[:2000]) + "\n")
                lines.flush()

    outcome = run_limited(work, memory=MEMORY, cpu=CPU + len(files))
    said = [json.loads(line) for line in told.read_text().splitlines()]
    if len(said) < len(files):
        said.append(f"{outcome.kind} {outcome.text}")
    return said


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m hostile.exhaustive", description=__doc__)
    parser.add_argument("--step", type=int, default=1, help="only every n-th offset")
    parser.add_argument("--format", action="append", default=[], help="only these endings")
    parser.add_argument("--json", type=Path, help="file for the counts")
    parser.add_argument("--evidence", action="store_true", help="add to docs/evidence")
    chosen = parser.parse_args()
    warm_up()
    found, failed = {}, 0
    with tempfile.TemporaryDirectory(prefix="exhaustive-") as place:
        root = Path(place)
        for name, (seed, entry) in fixtures(root).items():
            if chosen.format and name not in chosen.format:
                continue
            start = time.monotonic()
            folder = root / f"of-{len(found)}"
            folder.mkdir()
            totals, bad = attack(seed, entry, chosen.step, folder)
            failed += len(bad)
            found[name] = {"bytes": len(seed.data), "step": chosen.step, **totals}
            told = ", ".join(f"{count} {kind}" for kind, count in sorted(totals.items()))
            print(f"{name} ({len(seed.data)} bytes): {told}, {time.monotonic() - start:.0f} s")
            print(*bad[:20], sep="\n", flush=True)
            if chosen.evidence:
                evidence.add("every offset", {name: totals})
            if chosen.json:
                chosen.json.write_text(json.dumps(found, indent=2) + "\n")
    return 1 if failed else 0


if __name__ == "__main__":
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    sys.exit(main())
