"""`python -m hostile.kills`: commands that write are killed at any time, and told again.

A kill may leave a temporary file, which the next command of that output removes, but no torn one:
every file under its own name can be read. What the next command leaves is the same to the bit as
without a kill, but for the times that the computer took: `--resume` goes on from a checkpoint,
other commands begin anew with `--overwrite`.
"""

import argparse
import json
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import tomllib
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

PROGRAM = "import sys; sys.argv[0] = 'lidar-core'; from lidar_core.cli import main; main()"
OF_TIME = ("timing.parquet", "timing.csv", "run.toml", "summary.json", "batch.toml", "job.json")
"""Files that hold times of the computer, or how often a command was told."""
OF_TIME_TOO = (
    "results.parquet",
    "results.csv",
    "report.html",
    "run.mcap",
    "log.txt",
    "1-fuse.json",
)
PATIENCE_S = 300


@dataclass(frozen=True)
class Work:
    """A command that writes `output` and a file `beside` it, and its options after a kill."""

    arguments: tuple[str, ...]
    output: str
    again: tuple[str, ...] = ("--overwrite",)
    beside: str = ""
    is_same: bool = True


def works(size: int) -> dict[str, Work]:
    """Commands by name; their inputs are made by `prepared`."""
    quiet = ("--no-picture", "--threads", "1")
    beat = ("--checkpoint", "0.05")
    return {
        "simulate": Work(
            ("simulate", "demo", "-o", "made.npz", "--scans", str(size)), "made.npz", ()
        ),
        "convert": Work(("convert", "flight.npz", "flight.mcap"), "flight.mcap", ()),
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


def run(folder: Path, arguments: tuple[str, ...], *, wait: float | None = None) -> int:
    """Do a command in `folder`; after `wait` seconds it is killed. Its exit status."""
    with subprocess.Popen(
        [sys.executable, "-c", PROGRAM, *arguments],
        cwd=folder,
        stdout=subprocess.DEVNULL,
        stderr=(folder / "stderr").open("wb"),
    ) as process:
        try:
            return process.wait(PATIENCE_S if wait is None else wait)
        except subprocess.TimeoutExpired:
            process.send_signal(signal.SIGKILL)
            return process.wait()


def prepared(folder: Path, size: int) -> None:
    """Recordings, a run and jobs for the commands."""
    for arguments in (
        ("simulate", "demo", "-o", "flight.npz", "--scans", str(size)),
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
        if path.name not in (*OF_TIME, *OF_TIME_TOO)
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


def attempt(folder: Path, work: Work, whole: dict[str, bytes], wait: float) -> str:
    """Kill a command after `wait` seconds and tell it again: how that ended."""
    place, places = folder / work.output, [folder / work.output]
    places += [folder / work.beside] if work.beside else []
    status = run(folder, work.arguments, wait=wait)
    if status not in (0, -signal.SIGKILL):
        return f"status {status}: {(folder / 'stderr').read_text()[-300:]}"
    was_killed = status != 0
    if bad := [one for path in places for one in torn(path)]:
        return f"torn {bad}"
    status = run(folder, (*work.arguments, *work.again))
    told = (folder / "stderr").read_text()
    was_complete = status == 2 and "there is nothing to resume" in told
    if status != 0 and not was_complete:
        return f"again: status {status}: {(folder / 'stderr').read_text()[-300:]}"
    if bad := [one for path in places for one in torn(path)]:
        return f"torn after the next command {bad}"
    if found := left_over(place):
        return f"left over {found}"
    if work.is_same and (now := contents(place)) != whole:
        names = sorted(n for n in {*now, *whole} if now.get(n) != whole.get(n))
        return f"not the same {names}"
    return "killed" if was_killed else "was faster"


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m hostile.kills", description=__doc__)
    parser.add_argument("--count", type=int, default=300, help="kills in all")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--size", type=int, default=20, help="scans of the recordings")
    parser.add_argument("--work", action="append", default=[], help="only this")
    chosen = parser.parse_args()
    draw, bad, ended = random.Random(chosen.seed), 0, dict[str, Counter[str]]()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        prepared(folder, chosen.size)
        every = works(chosen.size)
        names = chosen.work or list(every)
        whole: dict[str, tuple[float, dict[str, bytes]]] = {}
        for number in range(10 * chosen.count):
            if sum(one["killed"] for one in ended.values()) >= chosen.count:
                break
            work = every[name := names[number % len(names)]]
            clear(folder, work)
            if name not in whole:
                began = time.monotonic()
                assert run(folder, work.arguments) == 0, (folder / "stderr").read_text()
                whole[name] = time.monotonic() - began, contents(folder / work.output)
                again = ("--overwrite",) if work.again else ()
                assert run(folder, (*work.arguments, *again)) == 0, (folder / "stderr").read_text()
                if work.is_same and contents(folder / work.output) != whole[name][1]:
                    raise AssertionError(f"{name}: two runs without a kill differ")
                clear(folder, work)
            how = attempt(folder, work, whole[name][1], draw.uniform(0.2, 1.0) * whole[name][0])
            ended.setdefault(name, Counter())[how.split(":")[0].split(" [")[0]] += 1
            if how not in ("killed", "was faster"):
                bad += 1
                print(f"{name}: {how}", flush=True)
    for name, counts in ended.items():
        print(f"{name}: {dict(counts)}")
    killed = sum(one["killed"] for one in ended.values())
    print(f"{killed} kills that ended well, {bad} that did not")
    return 1 if bad or killed < chosen.count else 0


if __name__ == "__main__":
    sys.exit(main())
