"""Run folders whose values are kept: what commands write is read back."""

import csv
import json
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
from typer.testing import CliRunner

from golden.digest import Record
from golden.flying_replay import lidar, sorted_rows, yard
from golden.fusion_replay import measured, way
from lidar_core import VoxelMap
from lidar_core.cli import app
from lidar_core.io import open_recording, read_columns, write_npz
from lidar_core.messages import LaserScan, Pose, Scan
from lidar_core.sim import Waypoints, circle_scenes, simulate, sweeps

SEED = 18
SKIPPED = frozenset(
    {"command", "recording", "files", "ms_per_scan", "us_per_measurement", "memory_bytes"}
    | {"notes", "reason", "ended_early", "format", "poses"}
)
"""Times, paths, sizes of memory and sentences of a summary."""
BY_NUMPY = frozenset({"vx", "vy"})
"""Columns of `fuse` that sines and cosines of numpy go into, whose last bits differ among CPUs."""


def _recorded(made, frame_id):
    """Scans and poses of a simulation, in line."""
    last = -1
    for one in made:
        for stamp, pose in zip(one.pose_stamps_ns.tolist(), np.round(one.poses, 10), strict=True):
            if stamp > last:
                yield Pose(stamp, "world", frame_id, pose, topic="tf")
                last = stamp
        yield one.scan


def _run(record, name, *arguments):
    """Run a command into a folder and take in what is there."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place) / "run"
        words = [name, *map(str, arguments), "-o", str(folder), "--no-picture", "--mcap"]
        done = CliRunner().invoke(app, words)
        if done.exit_code:
            raise RuntimeError(f"lidar-core {' '.join(words)}: {done.output}")
        for path in sorted(folder.rglob("*")):
            if path.is_file():
                _add_file(record, path, near=BY_NUMPY if name == "fuse" else frozenset())


def _add_file(record, path, near):
    match path.suffix:
        case ".parquet" | ".csv" if path.stem != "timing":
            for column, values in read_columns(path).items():
                record.add(f"{path.name}/{column}", values, near=column in near)
        case ".json":
            text = path.read_text(encoding="utf-8")
            record.add(path.name, json.loads(text), near=True, skip=SKIPPED)
        case ".txt":
            record.add("trajectories/name", path.name)
            record.add("trajectories/rows", np.loadtxt(path, ndmin=2), near=bool(near))
        case ".lcvm":
            made = VoxelMap.load(path)
            places = sorted_rows(made.occupied_points())
            record.add(f"{path.name}/occupied", places)
            record.add(f"{path.name}/values", made.values_at(places))
        case ".mcap":
            with open_recording(path) as recording:
                for message in recording:
                    _add_message(record, path.name, message)


def _add_message(record, name, message):
    match message:
        case Scan():
            content = {"points": message.points, "intensity": message.intensity}
        case LaserScan():
            content = {"ranges": message.ranges}
        case Pose():
            content = {"matrix": message.matrix}
        case _:
            content = {}
    record.add(f"{name}/{type(message).__name__}", content | {"stamp_ns": message.stamp_ns})


def _detect(record, threads, mode):
    scene = yard(lidar(), Waypoints(times=(0, 1.8), positions=((-1, 0, 3), (1, 0.5, 3.2))))
    with tempfile.TemporaryDirectory() as place:
        path = Path(place) / "yard.npz"
        write_npz(path, _recorded(simulate(scene, seed=SEED), "lidar"))
        _run(record, "detect", path, "--threads", threads, "--mode", mode)


def _circles(record, _threads, *options):
    scene = circle_scenes.several(SEED, walls=True, sensor="hovering", scans=40)
    with tempfile.TemporaryDirectory() as place:
        path = Path(place) / "room.npz"
        write_npz(path, _recorded(sweeps(scene, seed=SEED), "laser"))
        _run(record, "circles", path, *options)


def _fuse(record, _threads, *options):
    with tempfile.TemporaryDirectory() as place:
        path = Path(place) / "table.csv"
        _write_table(path)
        _run(record, "fuse", path, *options)


def _write_table(path):
    places, velocities = way(80)
    names = ("t_ns", "sensor", "x", "y", "range", "bearing", "range_rate")
    with path.open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        table.writerow([*names, "true_x", "true_y", "true_vx", "true_vy"])
        for k, one in enumerate(measured()[:80]):
            values = [repr(value) for value in one.values.tolist()]
            row = [*values, "", "", ""] if one.sensor == "lidar" else ["", "", *values]
            table.writerow([one.stamp_ns, one.sensor, *row, *places[k], *velocities[k]])


SCENES: dict[str, Callable[[Record, int], None]] = {
    "detect, best": partial(_detect, mode="best"),
    "detect, paper": partial(_detect, mode="paper"),
    "circles, best": _circles,
    "circles, paper": lambda record, threads: _circles(
        record, threads, "--mode", "paper", "--set", "detector=taubin"
    ),
    "fuse, best": _fuse,
    "fuse, paper": lambda record, threads: _fuse(record, threads, "--mode", "paper"),
    "fuse, smoothed": lambda record, threads: _fuse(
        record, threads, "--lag", "0.5", "--model", "cv", "--method", "kf"
    ),
}
