"""Rays that pass saturated space: detections, tracks, states and saved maps stay the same."""

import dataclasses

import numpy as np
import pytest
from helpers.flying_scenes import VLP_16, lidar, record_rounds

from golden.digest import Record
from golden.flying_replay import play_deskewed, yard
from lidar_core import IntegrateStats, PointClass, VoxelMap, VoxelMapConfig
from lidar_core.flying import FlyingConfig, FlyingObjectDetector, PoseConfig
from lidar_core.sim import Circle, Hover, simulate

ROUND = Circle(center=(0.0, 0.0, 3.0), radius=2.0, speed=3.0)
STILL = Hover(position=(0.0, 0.0, 3.0))


def config(skip, **changes):
    return FlyingConfig(voxel_map=VoxelMapConfig(skip=skip), **changes)


def results(play, skip, threads):
    record = Record()
    play(record, threads, config(skip))
    return record.entries()


def play(model, sensor, scans, *, sensors=("lidar",), rounds=1, known=None, **changes):
    """A run over a simulated flight; several rounds fly it again, into the same map.

    `known` holds points [m, world] of a map that is known beforehand."""

    def run(record, threads, one):
        detector = FlyingObjectDetector(one.model_copy(update=changes), threads=threads)
        if known is not None:
            detector.set_occupied(known)
        made = list(simulate(yard(model, sensor, scans=scans), seed=1019))
        record_rounds(record, detector, made, rounds, sensors)

    return run


RUNS = {
    "moving sensor, moving targets": play(lidar(), STILL, 30),
    "two sensors": play(lidar(), STILL, 24, sensors=("left", "right")),
    "forgotten maps": play(lidar(), ROUND, 20, forget_distance=6.0),
    "sparse sensor": play(VLP_16, ROUND, 20),
    "deskewed": play_deskewed,
}


@pytest.mark.ci_cases("moving sensor, moving targets", "two sensors")
@pytest.mark.parametrize("name", RUNS)
def test_detections_and_tracks_are_the_same(name):
    assert results(RUNS[name], "saturated", 2) == results(RUNS[name], "none", 1)


WALL = np.stack(np.meshgrid([12.0], np.arange(-6, 6, 0.2), np.arange(0, 4, 0.2)), axis=-1)
UNCERTAIN = {"position_std": (0.03, 0.03, 0.03), "angle_std": (0.002, 0.002, 0.002)}
LONG_RUNS = {
    "dense": {"model": lidar()},
    "sparse": {"model": VLP_16},
    "several sensors": {"model": lidar(), "sensors": ("left", "right", "rear")},
    "rolling map": {"model": lidar(), "forget_distance": 6.0},
    "known map": {"model": lidar(), "known": WALL.reshape(-1, 3)},
    "ends weighted": {"model": lidar(), "pose": PoseConfig(weighting="ends", **UNCERTAIN)},
    "points weighted": {"model": lidar(), "pose": PoseConfig(weighting="spread", **UNCERTAIN)},
}


@pytest.mark.nightly
@pytest.mark.parametrize("name", LONG_RUNS)
def test_detections_and_tracks_are_the_same_over_a_thousand_scans(name):
    run = play(sensor=ROUND, scans=50, rounds=20, **LONG_RUNS[name])
    passing = results(run, "saturated", 2)
    assert passing == results(run, "saturated", 1)
    assert passing == results(run, "none", 1)


def room_scan(step):
    """Rays from the middle of a room to its walls, turned a little with every scan."""
    turn, height = np.arange(6000) * 2.399963 + 0.3 * step, np.linspace(-0.99, 0.99, 6000)
    flat = np.sqrt(1 - height**2)
    ways = np.stack([flat * np.cos(turn), flat * np.sin(turn), height], axis=1)
    return (ways * (3.0 / np.abs(ways).max(axis=1))[:, None]).astype(np.float32)


def test_counts_tell_what_was_passed():
    maps = {skip: VoxelMap(VoxelMapConfig(skip=skip)) for skip in ("none", "saturated")}
    for step in range(40):
        points = room_scan(step)
        classes = np.full(len(points), PointClass.BACKGROUND)
        stats = {skip: one.integrate(points, classes, [0, 0, 0]) for skip, one in maps.items()}
        same = [dataclasses.replace(one, n_visits_skipped=0, n_voxels=0) for one in stats.values()]
        assert same[0] == same[1]
    last = stats["saturated"]
    assert isinstance(last, IntegrateStats)
    assert stats["none"].n_visits_skipped == 0
    assert 0.5 * last.n_visits < last.n_visits_skipped < last.n_visits
    assert last.n_voxels < stats["none"].n_voxels
    assert 0 < last.n_voxels_changed < last.n_voxels
