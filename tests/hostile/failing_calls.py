"""Every call of the system that a writer makes fails once; prints what became of the file.

Runs with `failing_calls.c` preloaded.
"""

import json
import os
import sys
from itertools import count
from pathlib import Path

import numpy as np

from hostile.child import _said
from lidar_core import VoxelMap
from lidar_core.flying import FlyingObjectDetector
from lidar_core.io import read_columns, write_recording
from lidar_core.messages import Scan
from lidar_core.run_folder import RunFolder
from lidar_core.runs.checkpoints import Checkpoints
from lidar_core.viz.figure import write_figure


def _map(path, size):
    grid = VoxelMap()
    points = np.random.default_rng(0).normal(0, 5, (size, 3)).astype(np.float32)
    grid.integrate(points, np.full(size, 1, np.uint8), np.zeros(3))
    grid.save(path)


def _detector(path, size):
    detector = FlyingObjectDetector()
    points = np.random.default_rng(0).normal(0, 5, (size, 3)).astype(np.float32)
    detector.process(points, np.eye(4), 0)
    detector.save(path)


def _recording(path, size):
    points = np.random.default_rng(0).normal(0, 5, (size, 3)).astype(np.float32)
    write_recording(path, iter([Scan(stamp_ns=0, points=points, frame_id="lidar")]))


def _text(path, size):
    folder = RunFolder.__new__(RunFolder)
    folder.path = path.parent
    folder.write_text(path.name, "x" * size)


class _Counted:
    KINDS = ()

    def __init__(self, size):
        self.size = size

    def checkpoint_state(self):
        return {"size": self.size}

    def rows(self, since):
        return list(range(since, self.size))

    def restore(self, kept, rows):
        assert rows == list(range(kept["size"]))
        self.size = kept["size"]


def _checkpoint(path, size):
    if size == OLD:
        _RUNS[path] = Checkpoints(path.parent, 0.0, {"a": 1})
    _RUNS[path].take(_Counted(size), size)


def _table(path, size):
    folder = RunFolder.__new__(RunFolder)
    folder.path = path.parent
    folder.write_table(path.stem, {"x": np.arange(size)})


def _picture(path, size):
    write_figure(path, lambda figure: figure.text(0, 0, str(size)), size=(1, 1), dpi=40)


_RUNS = {}
"""What writes the checkpoints of a folder."""


def _resumed(path):
    return Checkpoints(path.parent, None, {"a": 1}).resume(_Counted(0))


WRITERS = {
    "map.lcvm": (_map, lambda path: VoxelMap.load(path).n_observed),
    "state.lcst": (_detector, lambda path: FlyingObjectDetector.load(path).n_observed),
    "scans.npz": (_recording, lambda path: path.stat().st_size),
    "scans.mcap": (_recording, lambda path: path.stat().st_size),
    "table.parquet": (_table, lambda path: len(read_columns(path, trusted=True)["x"])),
    "picture.png": (_picture, lambda path: path.read_bytes()),
    "summary.json": (_text, lambda path: len(path.read_text())),
    "run.checkpoint": (_checkpoint, _resumed),
}
OLD, NEW = 50, 90
"""Sizes of what is written first, and of what is to replace it."""


def attack(name, folder):
    """How the writer ended for every call that failed, and what was there then."""
    write, read = WRITERS[name]
    rows, calls = [], 0
    for number in count():
        if number > calls:
            break
        place = folder / f"{name}-{number}"
        place.mkdir()
        path = place / name
        os.environ["FAIL_AT"] = "0"
        write(path, OLD)
        old = read(path)
        os.environ |= {"FAIL_UNDER": str(place), "FAIL_RUN": f"{name}{number}"}
        os.environ["FAIL_AT"] = str(number)
        said = _said(lambda path=path: write(path, NEW))
        if not number:
            calls = int(os.readlink(place / ".calls"))
        os.environ["FAIL_AT"] = "0"
        litter = [one.name for one in place.iterdir() if one.name.endswith(".tmp")]
        found = read(path)
        rows.append({"failed": number, "said": said, "old": found == old, "litter": litter})
    return rows


if __name__ == "__main__":
    sys.stdout.write(json.dumps({name: attack(name, Path(sys.argv[1])) for name in WRITERS}))
