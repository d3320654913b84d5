"""The border: a call lets other Python threads run, and uses the threads that it was given."""

import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest

import lidar_core as lc
from lidar_core import _core

SCANS = 6
"""Of which one at least must be long enough for the system to wake another thread."""


class Watched:
    """Stands for an object of the core and notes for every call whether another thread ran."""

    def __init__(self, core):
        self._core, self.ran = core, []

    def __getattr__(self, name):
        def call(*args, **options):
            gate, seen = threading.Lock(), []
            gate.acquire()
            other = threading.Thread(target=lambda: (gate.acquire(), seen.append(True)))
            other.start()
            gate.release()
            found = getattr(self._core, name)(*args, **options)
            self.ran.append(bool(seen))
            other.join()
            return found

        return call


@pytest.fixture
def _no_switching():
    """Python changes threads only where the one that runs lets go of the GIL."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(3600)
    yield
    sys.setswitchinterval(before)


@pytest.fixture(scope="module")
def flight():
    return list(lc.sim.simulate(lc.sim.scenes.demo(seed=71), seed=71, scans=2))


def _detector(flight):
    detector = lc.flying.FlyingObjectDetector(lc.flying.FlyingConfig())
    detector._detector = watched = Watched(detector._detector)
    first = flight[0]
    for number in range(SCANS):
        detector.process(
            first.scan.points,
            first.world_from_lidar,
            number * 10**8,
            no_return=first.scan.no_return,
            directions=first.scan.directions,
        )
    return watched


def _map(flight):
    voxel_map = lc.VoxelMap(lc.VoxelMapConfig())
    voxel_map._map = watched = Watched(voxel_map._map)
    scan = flight[0].scan
    points = scan.points.reshape(-1, 3)
    for _ in range(SCANS):
        voxel_map.integrate(
            points,
            (~scan.no_return).astype(np.uint8),
            (0.0, 0.0, 3.0),
            ray_directions=scan.directions,
            no_return=scan.no_return,
        )
    return watched


def _clusters(flight):
    watched = Watched(_core)
    points = flight[0].scan.points.reshape(-1, 3)
    for _ in range(SCANS):
        watched.cluster_points(
            points,
            max_distance=0.25,
            min_points=1,
            max_points=None,
            max_angle=0.0,
            origin=np.zeros(3),
        )
    return watched


def _circles(flight):
    scanner = lc.circles.Scanner(-np.pi, 2 * np.pi / 20_000, 20_000, 0.05, 30.0)
    pipeline = lc.circles.CirclePipeline(lc.circles.CirclesConfig(scanner=scanner))
    pipeline._pipeline = watched = Watched(pipeline._pipeline)
    bearings = scanner.angle_min + scanner.angle_increment * np.arange(20_000)
    ranges = np.full(20_000, np.inf, np.float32)
    for turn in np.linspace(-3, 3, 40):
        ranges[np.abs(bearings - turn) < 0.05] = 4.0
    for number in range(SCANS):
        pipeline.process(ranges, np.eye(4), number * 10**8)
    return watched


def printed(program):
    """Words of a process of its own, in which no threads but its own run or come to their end."""
    done = subprocess.run(
        [sys.executable, "-c", program],
        capture_output=True,
        text=True,
        check=False,
        cwd=Path(__file__).parent,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.split()


@pytest.mark.usefixtures("_no_switching")
@pytest.mark.parametrize("calls", [_detector, _map, _clusters, _circles])
def test_another_thread_runs_during_a_call(calls, flight):
    assert any(calls(flight).ran)


def test_the_watch_tells_when_no_thread_runs():
    program = """
import sys
from test_border import Watched
sys.setswitchinterval(3600)
watched = Watched([])  # numpy's functions let go of the GIL now and then
for _ in range(300):
    watched.append(3)
print(any(watched.ran))
"""
    assert printed(program) == ["False"]


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="only Linux lists threads")
@pytest.mark.parametrize(("threads", "started"), [(1, 0), (3, 3)])  # one: that of the caller
def test_a_map_has_the_threads_it_was_given(threads, started):
    program = f"""
import os
import lidar_core as lc
before = set(os.listdir("/proc/self/task"))  # one of them may end meanwhile
voxel_map = lc.VoxelMap(lc.VoxelMapConfig(), threads={threads})
print(len(set(os.listdir("/proc/self/task")) - before))
"""
    assert printed(program) == [str(started)]
