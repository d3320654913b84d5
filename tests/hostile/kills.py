"""`python -m hostile.kills`: commands that write are killed at any time, and then run again.

A kill may leave a temporary file, which the next command of that output removes, but no torn one:
every file under its own name can be read. What the next command leaves is the same to the bit as
without a kill, but for the times that the computer took: `--resume` goes on from a checkpoint,
other commands begin anew with `--overwrite`. Every second kill of a command with checkpoints waits
for one; that kills fell on checkpoints is counted, and without any the attack has failed.
"""

import argparse
import json
import random
import shutil
import signal
import sys
import tempfile
import time
import tomllib
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from hostile import evidence
from hostile.commands import run
from lidar_core.run_folder import CHECKPOINT

OF_TIME = (
    *("timing.parquet", "timing.csv", "results.parquet", "results.csv", "report.html"),
    *("run.toml", "batch.toml", "summary.json", "job.json", "1-fuse.json", "run.mcap", "log.txt"),
)
"""Files that hold times of the computer, or how often a command was given."""


@dataclass(frozen=True)
class Work:
    """A command that writes `output` and a file `beside` it, and its options after a kill."""

    arguments: tuple[str, ...]
    output: str
    again: tuple[str, ...] = ("--overwrite",)
    beside: str = ""
    is_same: bool = True

    @property
    def is_resumed(self) -> bool:
        return "--resume" in self.again


def works(size: int) -> dict[str, Work]:
    """Commands by name; their inputs are made by `prepared`."""
    quiet = ("--no-picture", "--threads", "1")
    beat = ("--checkpoint", "0.05")
    return {
        "simulate": Work(
            (
                *("simulate", "demo", "-o", "made.npz", "--scans", str(size)),
                # Also the first time: the files beside made.npz stay from one kill to the next.
                *("--sensor", "vlp-16", "--overwrite"),
            ),
            "made.npz",
            (),
        ),
        "convert": Work(("convert", "flight.npz", "flight.mcap"), "flight.mcap"),
        "demo": Work(("demo", "-o", "demo", "--scans", str(size)), "demo", ()),
        "detect": Work(("detect", "flight.npz", "-o", "flying", *quiet), "flying"),
        "detect, resumed": Work(
            ("detect", "flight.npz", "-o", "flying2", *quiet, *beat), "flying2", ("--resume",)
        ),
        "detect, static map": Work(
            ("detect", "flight.npz", "-o", "flying3", *quiet, "--static-map", "still.ply"),
            "flying3",
            beside="still.ply",
        ),
        "circles": Work(("circles", "sweeps.npz", "-o", "map", "--no-picture"), "map"),
        "circles, resumed": Work(
            ("circles", "sweeps.npz", "-o", "map2", "--no-picture", *beat), "map2", ("--resume",)
        ),
        "fuse": Work(("fuse", "walk.csv", "-o", "target", "--no-picture"), "target"),
        "fuse, many, resumed": Work(
            (
                *("fuse", "walk.csv", "-o", "targets", "--no-picture"),
                *("--association", "integrated", *beat),
            ),
            "targets",
            ("--resume",),
        ),
        "config fit": Work(("config", "fit", "walk.csv", "-o", "noise.toml"), "noise.toml"),
        "report": Work(("report", "known", "-o", "page.html"), "page.html", (), is_same=False),
        "view --png": Work(("view", "known", "--png", "known.png"), "known.png", ()),
        "live": Work(
            ("live", "--replay", "flight.npz", "--rate", "8", "-o", "flown", "--record", "a.mcap"),
            "flown",
            beside="a.mcap",
            is_same=False,
        ),
        "batch": Work(("batch", "jobs.toml", "-o", "jobs", "--workers", "2"), "jobs", ()),
    }


def prepared(folder: Path, size: int) -> None:
    """Recordings, a run and jobs for the commands."""
    for arguments in (
        ("simulate", "demo", "-o", "flight.npz", "--scans", str(size), "--sensor", "vlp-16"),
        ("simulate", "overflight", "-o", "walk.csv", "--scans", str(20 * size)),
        ("simulate", "hall.toml", "-o", "sweeps.npz"),
        ("fuse", "walk.csv", "-o", "known", "--no-picture"),
    ):
        (folder / "hall.toml").write_text(
            f"scans = {10 * size}\nlidar = {{ preset = 'utm-30lx', range_max = 10 }}\n"
            "[[targets]]\nshape = { kind = 'cylinder', radius = 0.3 }\n"
            "motion = { kind = 'hover', position = [4, 0, 1] }\n"
        )
        assert run(folder, arguments) == 0, (folder / "stderr").read_text()
    (folder / "jobs.toml").write_text(
        "[[jobs]]\nname = 'walk'\ngrid.lag = [0.0, 0.1, 0.2, 0.3]\ncommands = ["
        f"'fuse {folder}/walk.csv -o {{output}}/run --no-picture --no-mcap --lag {{lag}}']\n"
    )


def files_of(place: Path) -> Iterator[Path]:
    """Files that a command left under their own names, temporary ones left out."""
    from lidar_core.io.files.atomic import is_temporary

    paths = sorted(place.rglob("*")) if place.is_dir() else [place]
    for path in paths:
        inner = path.relative_to(place.parent).parts
        if path.is_file() and not any(map(is_temporary, inner)):
            yield path


def _image(path: Path) -> object:
    from PIL import Image

    assert path.read_bytes()[-8:-4] == b"IEND", "no end"  # which Image does not miss
    with Image.open(path) as image:
        image.load()
    return image


def _recording(path: Path) -> object:
    from lidar_core.io import open_recording

    with open_recording(path, trusted=True) as recording:
        return sum(1 for _ in recording.records())


def _table(path: Path) -> object:
    from lidar_core.io import read_columns

    return read_columns(path, trusted=True)


def _map(path: Path) -> object:
    from lidar_core.flying.voxel_map import VoxelMap

    return VoxelMap.load(path)


WHOLE: dict[str, Callable[[Path], object]] = {
    ".json": lambda path: json.loads(path.read_text()),
    ".toml": lambda path: tomllib.loads(path.read_text()),
    ".png": _image,
    ".npz": _recording,
    ".ply": _recording,
    ".mcap": _recording,
    ".parquet": _table,
    ".lcvm": _map,
    ".html": lambda path: path.read_text().index("</html>"),
}
"""How files are read; the others are looked at by what the next command makes of them."""


def torn(place: Path) -> list[str]:
    """Files that cannot be read, and why."""
    bad = []
    for path in files_of(place):
        if path.name.endswith(".partial.mcap"):
            continue  # of a live recording; it says so by its name
        try:
            WHOLE.get(path.suffix, Path.read_bytes)(path)
        except Exception as error:
            bad.append(f"{path.name}: {type(error).__name__}: {error}"[:200])
    return bad


def contents(place: Path) -> dict[str, bytes]:
    """What has to be the same, by name."""
    return {
        str(path.relative_to(place.parent)): path.read_bytes()
        for path in files_of(place)
        if path.name not in OF_TIME
    }


def left_over(place: Path) -> list[str]:
    """Temporary files in and beside an output."""
    from lidar_core.io.files.atomic import is_temporary

    beside = [path.name for path in place.parent.iterdir() if is_temporary(path.name)]
    inside = [path.name for path in place.rglob("*") if is_temporary(path.name)]
    return [*beside, *inside]


def clear(folder: Path, work: Work) -> None:
    """Remove what a command wrote."""
    for name in filter(None, (work.output, work.beside)):
        place = folder / name
        if place.is_dir():
            shutil.rmtree(place)
        else:
            place.unlink(missing_ok=True)


@dataclass
class Tally:
    """How the attempts at one command ended.

    Attributes
    ----------
    ended : Counter
        Of every end, how often.
    checkpoints : int
        Kills that left a checkpoint with results, from which the next command went on.
    is_resumed : bool
        Whether the command writes checkpoints.
    """

    ended: Counter[str]
    checkpoints: int = 0
    is_resumed: bool = False

    @property
    def killed(self) -> int:
        return self.ended["killed"]

    @property
    def outcomes(self) -> dict[str, int]:
        """How kills ended, as the page of evidence counts it."""
        wrong = {how: n for how, n in self.ended.items() if how not in ("killed", "was faster")}
        return {"ok": self.killed} | wrong

    def __str__(self) -> str:
        met = f", on a checkpoint {self.checkpoints}" if self.is_resumed else ""
        return ", ".join(f"{how} {count}" for how, count in self.ended.items()) + met


def fault(tallies: Mapping[str, Tally], count: int) -> str | None:
    """Why the whole attack says nothing, or failed; None if it stands."""
    bad = sum(one.ended.total() - one.killed - one.ended["was faster"] for one in tallies.values())
    if bad:
        return f"{bad} ended badly"
    if sum(one.killed for one in tallies.values()) < count:
        return f"fewer than {count} commands could be killed"
    resumed = [one for one in tallies.values() if one.is_resumed and one.killed]
    if resumed and not any(one.checkpoints for one in resumed):
        return "no kill fell on a checkpoint"
    return None


@dataclass
class Attack:
    """Kills commands in a folder; `whole` keeps what each of them writes, and how long it takes."""

    folder: Path
    draw: random.Random
    whole: dict[str, tuple[float, dict[str, bytes]]]
    tallies: dict[str, Tally]

    def measure(self, name: str, work: Work) -> None:
        """Do the command twice without a kill."""
        began = time.monotonic()
        assert run(self.folder, work.arguments) == 0, (self.folder / "stderr").read_text()
        place = self.folder / work.output
        self.whole[name] = time.monotonic() - began, contents(place)
        again = ("--overwrite",) if work.again else ()
        done = run(self.folder, (*work.arguments, *again))
        assert done == 0, (self.folder / "stderr").read_text()
        if work.is_same and contents(place) != self.whole[name][1]:
            raise AssertionError(f"{name}: two runs without a kill differ")
        clear(self.folder, work)

    def kill(self, name: str, work: Work) -> str:
        """Kill a command and give it again: how that ended."""
        clear(self.folder, work)
        if name not in self.whole:
            self.measure(name, work)
        tally = self.tallies.setdefault(name, Tally(Counter(), is_resumed=work.is_resumed))
        seconds, before = self.whole[name]
        checkpoint = self.folder / work.output / CHECKPOINT
        if work.is_resumed and tally.ended.total() % 2:
            wait = self.draw.uniform(0.0, 0.2) * seconds
            status = run(self.folder, work.arguments, wait=wait, after=checkpoint)
        else:
            status = run(self.folder, work.arguments, wait=self.draw.uniform(0.2, 1.0) * seconds)
        has_results = checkpoint.exists() and any(checkpoint.parent.glob(".checkpoint-*"))
        how = self.outcome(work, status, before)
        tally.ended[how.split(":")[0].split(" [")[0]] += 1
        tally.checkpoints += has_results and how == "killed"
        return how

    def outcome(self, work: Work, status: int, before: Mapping[str, bytes]) -> str:
        """What a command that ended with this status left, and the next one made of it."""
        place, errors = self.folder / work.output, self.folder / "stderr"
        places = [self.folder / name for name in (work.output, work.beside) if name]
        if status not in (0, -signal.SIGKILL):
            return f"status {status}: {errors.read_text()[-300:]}"
        was_killed = status != 0
        if bad := [one for path in places for one in torn(path)]:
            return f"torn {bad}"
        status = run(self.folder, (*work.arguments, *work.again))
        said = errors.read_text()
        was_complete = status == 2 and "nothing to resume" in said
        if status != 0 and not was_complete:
            return f"again: status {status}: {said[-300:]}"
        if bad := [one for path in places for one in torn(path)]:
            return f"torn after the next command {bad}"
        if found := left_over(place):
            return f"left over {found}"
        if work.is_same and (now := contents(place)) != before:
            names = sorted(n for n in {*now, *before} if now.get(n) != before.get(n))
            return f"not the same {names}"
        return "killed" if was_killed else "was faster"


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m hostile.kills", description=__doc__)
    parser.add_argument("--count", type=int, default=300, help="kills in all")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--size", type=int, default=6, help="scans of the recordings")
    parser.add_argument("--work", action="append", default=[], help="only this")
    parser.add_argument("--minutes", type=float, default=float("inf"), help="stop after this time")
    parser.add_argument("--evidence", action="store_true", help="add the counts to docs/evidence")
    chosen = parser.parse_args()
    until = time.monotonic() + 60 * chosen.minutes
    with tempfile.TemporaryDirectory() as folder:
        attack = Attack(Path(folder), random.Random(chosen.seed), {}, {})
        prepared(attack.folder, chosen.size)
        every = works(chosen.size)
        names = chosen.work or list(every)
        for number in range(10 * chosen.count):
            killed = sum(one.killed for one in attack.tallies.values())
            if killed >= chosen.count or time.monotonic() > until:
                break
            name = names[number % len(names)]
            how = attack.kill(name, every[name])
            if how not in ("killed", "was faster"):
                print(f"{name}: {how}", flush=True)
    for name, tally in attack.tallies.items():
        print(f"{name}: {tally}")
    if chosen.evidence:
        evidence.add("kills", {name: one.outcomes for name, one in attack.tallies.items()})
    resumed = [one for one in attack.tallies.values() if one.is_resumed]
    print(
        f"{sum(one.killed for one in attack.tallies.values())} kills that ended well, of"
        f" {sum(one.killed for one in resumed)} commands with checkpoints"
        f" {sum(one.checkpoints for one in resumed)} on a checkpoint"
    )
    is_over = time.monotonic() > until
    if wrong := fault(attack.tallies, 1 if is_over else chosen.count):
        print(wrong)
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
