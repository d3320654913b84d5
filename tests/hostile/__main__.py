"""`python -m hostile`: break files, read each in a limited child, and say which ended badly."""

import argparse
import os
import sys
import tempfile
import time
from collections import Counter
from functools import partial
from pathlib import Path

import numpy as np

from hostile import entries, evidence
from hostile.child import Outcome, run_limited
from hostile.mutators import mutated
from hostile.seeds import Seed, data_folder, seeds_of

LIBRARIES = (
    *("laspy", "mcap.reader", "pyarrow.parquet", "pypcd4", "rosbags.rosbag1", "rosbags.rosbag2"),
    *("trimesh", "velodyne_decoder", "zstandard", "lz4.frame", "google.protobuf", "onnxruntime"),
    *("lidar_core.flying", "lidar_core.circles", "lidar_core.fusion", "lidar_core.io"),
    *("lidar_core.evaluation", "lidar_core.viz.report", "lidar_core.batch", "lidar_core.sim"),
    *("lidar_core.io.ouster.osf", "lidar_core.io.readers", "lidar_core.runs.settings"),
)


VIA_CHILD = 20
"""Every such file is read as users read it, by a child of the reader's own; the others by the same
code in one process, which is faster, and again by a child if that ends badly."""


ORDINARY = 64 * 1024
"""Size up to which all files of a format are drawn equally often [bytes]."""


def warm_up() -> None:
    """Load what readers load, once: a fork of this process then costs milliseconds."""
    for name in LIBRARIES:
        try:
            __import__(name)
        except ImportError:
            continue
    from lidar_core.io.readers import known_formats

    known_formats()


def _drawn(sizes: list[int], rng: np.random.Generator) -> int:
    """Which file is broken. Large ones are drawn less often: they hold more of the same, and a
    read of one takes as long as a hundred of small ones."""
    weights = np.minimum(1.0, ORDINARY / np.maximum(sizes, 1))
    return int(rng.choice(len(sizes), p=weights / weights.sum()))


def _laid_out(seed: Seed, rng: np.random.Generator, folder: Path) -> tuple[Path, str]:
    """The broken file, the good ones beside it."""
    for name, data in seed.beside.items():
        (folder / name).write_bytes(data)
    path = folder / seed.name
    path.unlink(missing_ok=True)
    kind = rng.integers(400)
    if kind == 0:
        path.mkdir()
        return path, "a folder"
    if kind == 1:
        os.mkfifo(path)
        return path, "a pipe"
    if kind == 2:
        path.symlink_to(path)
        return path, "a link to itself"
    if kind == 3:
        path.symlink_to("/dev/zero")
        return path, "a link to a device"
    how, data = mutated(seed.data, rng)
    path.write_bytes(data)
    return path, how


def run(
    count: int,
    seed: int,
    *,
    formats: list[str],
    first: int = 0,
    keep: Path | None = None,
    generated_only: bool = False,
    quiet: bool = False,
    minutes: float = float("inf"),
    **limits: int,
) -> tuple[Counter[str], Counter[str], list[str], Outcome | None]:
    """Attack `count` files, every format in turn, as long as there is time.

    Returns outcomes, outcomes by format, and what was bad.
    """
    until = time.monotonic() + 60 * minutes
    warm_up()
    totals, by_format, bad = Counter[str](), Counter[str](), list[str]()
    slowest = None
    with tempfile.TemporaryDirectory(prefix="hostile-") as place:
        root = Path(place)
        found = seeds_of(root / "seeds", None if generated_only else data_folder())
        groups = {name: seeds for name, seeds in found.items() if not formats or name in formats}
        readers = {name: _Readers(root) for name in groups}
        for name in [name for name, seeds in groups.items() if not readers[name].can_read(seeds)]:
            print(f"{name}: left out, no reader is installed that reads a good one", flush=True)
            del groups[name]
        start = time.monotonic()
        for number in range(first, first + count):
            if time.monotonic() > until:
                break
            rng = np.random.default_rng([seed, number])
            name = list(groups)[number % len(groups)]
            chosen = groups[name][_drawn([len(one.data) for one in groups[name]], rng)]
            folder = root / f"{number}"
            folder.mkdir()
            path, how = _laid_out(chosen, rng, folder)
            entry = readers[name].of(chosen, rng)
            outcome = run_limited(partial(_trusted, entry, path), **limits)
            if not outcome.is_good:
                totals["saved"] += 1
                told = f"{chosen.name} ({how}) by {entry.__name__}: {outcome.kind}"
                print(f"{number}: in one process: {told}: {outcome.text.strip()}", flush=True)
            if not outcome.is_good or number % VIA_CHILD == 0:
                outcome = run_limited(partial(entry, path), **limits)
            totals[outcome.kind] += 1
            by_format[f"{name} {outcome.kind}"] += 1
            if slowest is None or outcome.seconds > slowest.seconds:
                slowest = outcome
            if not outcome.is_good:
                read = f"{chosen.name} ({how}) by {entry.__name__}"
                line = f"{number}: {read}: {outcome.kind}: {outcome.text}"
                bad.append(line)
                if not quiet:
                    print(line, flush=True)
                if keep is not None and path.is_file():
                    keep.mkdir(parents=True, exist_ok=True)
                    (keep / f"{number}-{entry.__name__}-{path.name}").write_bytes(path.read_bytes())
            _removed(folder)
            if not quiet and (number - first + 1) % 1000 == 0:
                told = ", ".join(f"{many} {kind}" for kind, many in sorted(totals.items()))
                print(f"{number - first + 1} files, {time.monotonic() - start:.0f} s: {told}")
    return totals, by_format, bad, slowest


def _trusted(entry: entries.Entry, path: Path) -> None:
    from lidar_core.io import trusted_files

    with trusted_files():
        entry(path)


class _Readers:
    """What can read the good files: else a refusal says nothing about how one was broken."""

    def __init__(self, root: Path) -> None:
        self._folder = root / "good"
        self._known: dict[str, list[entries.Entry]] = {}

    def of(self, seed: Seed, rng: np.random.Generator) -> entries.Entry:
        """One that reads the good file, or now and then any that is meant for its ending."""
        chosen = self._that_read(seed) if rng.random() < 0.9 else []
        chosen = chosen or list(seed.entries)
        return chosen[rng.integers(len(chosen))]

    def can_read(self, seeds: list[Seed]) -> bool:
        return any(self._that_read(seed) for seed in seeds)

    def _that_read(self, seed: Seed) -> list[entries.Entry]:
        key = f"{seed.name} {len(seed.data)}"
        if key not in self._known:
            self._folder.mkdir()
            for name, data in {**seed.beside, seed.name: seed.data}.items():
                (self._folder / name).write_bytes(data)
            place = self._folder / seed.name
            ended = {
                one: run_limited(partial(_trusted, one, place)).kind for one in set(seed.entries)
            }
            self._known[key] = [one for one in seed.entries if ended[one] == "ok"]
            _removed(self._folder)
        return self._known[key]


def _removed(folder: Path) -> None:
    for path in folder.iterdir():
        path.rmdir() if path.is_dir() and not path.is_symlink() else path.unlink()
    folder.rmdir()


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m hostile", description=__doc__)
    parser.add_argument("--count", type=int, default=20_000, help="broken files")
    parser.add_argument("--seed", type=int, default=1, help="of the ways they are broken")
    parser.add_argument("--first", type=int, default=0, help="number of the first, to repeat one")
    parser.add_argument("--format", action="append", default=[], help="only these endings")
    parser.add_argument("--keep", type=Path, help="folder for the files that ended badly")
    parser.add_argument("--minutes", type=float, default=float("inf"), help="stop after this time")
    parser.add_argument("--generated-only", action="store_true", help="without LIDAR_CORE_DATA")
    parser.add_argument("--evidence", action="store_true", help="add the counts to docs/evidence")
    chosen = parser.parse_args()
    start = time.monotonic()
    totals, by_format, bad, slowest = run(
        chosen.count,
        chosen.seed,
        formats=chosen.format,
        first=chosen.first,
        keep=chosen.keep,
        generated_only=chosen.generated_only,
        minutes=chosen.minutes,
    )
    for line in sorted(by_format.items()):
        print(*line)
    if chosen.evidence:
        counts: dict[str, dict[str, int]] = {}
        for told, count in by_format.items():
            counts.setdefault(told.split()[0], {})[told.split()[1]] = count
        evidence.add("broken files", counts)
    told = ", ".join(
        f"{totals[kind]} {kind}" for kind in ("ok", "typed", "untyped", "abort", "hang", "memory")
    )
    if totals["saved"]:
        print(f"{totals['saved']} would have ended badly in one process; their children ended so")
    longest = f"; longest {slowest.seconds:.1f} s of CPU" if slowest else ""
    took = f"{time.monotonic() - start:.0f} s"
    print(f"{sum(by_format.values())} files, seed {chosen.seed}, {took}: {told}{longest}")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
