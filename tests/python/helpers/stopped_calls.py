"""Long calls that get SIGINT on their way: a program, since it must own its signals.

Prints, as JSON, for every call what each attempt cost from the signal on [s, of CPU and of the
clock], whether it was stopped, and what became of the object.
"""

import json
import os
import signal
import sys
import threading
import time
from itertools import count

import numpy as np

from lidar_core import VoxelMap, cluster_points
from lidar_core.circles import CircleDetector
from lidar_core.evaluation.matching.assignment import cheapest
from lidar_core.flying import FlyingConfig, FlyingObjectDetector
from lidar_core.fusion import Measurement, Measurements, run_batch
from lidar_core.fusion.config import FusionConfig

SHARES = [0.0, 0.05, 0.3, 0.6]
"""Of the time of a whole call after which the signal comes."""


def room(points, seed):
    """Returns of a LiDAR with 64 rows in a room with some things in it."""
    noise = np.random.default_rng(seed)
    azimuth = np.tile(np.linspace(-np.pi, np.pi, points // 64, endpoint=False), 64)
    elevation = np.repeat(np.linspace(-0.4, 0.4, 64), points // 64)
    level = np.cos(elevation)
    sight = np.stack([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)], -1)
    ranges = np.min(np.array([30.0, 20.0, 6.0]) / np.maximum(np.abs(sight), 1e-9), 1)
    is_thing = (np.sin(40.0 * azimuth) > 0.9) & (np.abs(elevation) < 0.2)
    ranges = np.where(is_thing, 10.0, ranges) + 0.02 * noise.standard_normal(ranges.size)
    return (sight * ranges[:, None]).astype(np.float32)


class Attempt:
    """One call, and a signal some time after its beginning."""

    def __init__(self, call, delay):
        killer = threading.Thread(target=self._kill, args=(delay,))
        end, self.is_stopped = None, False
        try:
            killer.start()
            call()
            end = now()
            killer.join()  # the call was faster: the signal comes here
            time.sleep(0.01)
        except KeyboardInterrupt:
            self.is_stopped = end is None
            end = end or now()
        killer.join()
        self.cpu, self.wall = (late - early for late, early in zip(end, self.sent, strict=True))

    def _kill(self, delay):
        time.sleep(delay)
        self.sent = now()
        os.kill(os.getpid(), signal.SIGINT)


def now():
    """Time of the processor and of the clock."""
    return time.process_time(), time.perf_counter()


def attempts(call, item=None):
    """Rows of a call that is stopped after different times, and of one that is not."""
    start = time.perf_counter()
    call()
    whole = time.perf_counter() - start
    rows = []
    for share in SHARES:
        before = None if item is None else item.to_bytes()
        one = Attempt(call, share * whole)
        row = {"cpu": one.cpu, "wall": one.wall, "stopped": one.is_stopped}
        if item is not None:
            row["state"] = state_of(item, before)
        rows.append(row)
    return {"rows": rows}


def state_of(item, before):
    """Whether an object is as before the call, as after one that ended, or neither."""
    twin = type(item).from_bytes(before)
    if core_of(item) == core_of(twin):
        return "before"
    CALL[type(item)](twin)
    return "after" if core_of(item) == core_of(twin) else "neither"


def core_of(item):
    """The state without the counters of calls."""
    return item._state()[0]


CALL = {}
"""The call that was stopped, for another object of the same class."""


def main(points):
    """Stop every long call at several times."""
    signal.signal(signal.SIGINT, signal.default_int_handler)
    cloud, found = room(points, 0), {}
    detector = FlyingObjectDetector(FlyingConfig(), threads=2)
    stamps = count(0, 10**8)
    latest = [0]

    def process():
        latest[0] = next(stamps)
        detector.process(cloud, np.eye(4), latest[0])

    CALL[FlyingObjectDetector] = lambda item: item.process(cloud, np.eye(4), latest[0])
    found["process"] = attempts(process, detector)
    grid = VoxelMap(threads=1)
    classes = np.full(len(cloud), 2, np.uint8)
    CALL[VoxelMap] = lambda item: item.integrate(cloud, classes, np.zeros(3))
    found["integrate"] = attempts(lambda: CALL[VoxelMap](grid), grid)
    found["cluster"] = attempts(lambda: cluster_points(cloud, max_distance=0.3, min_points=1))
    labels = cluster_points(cloud, max_distance=0.02, min_points=1)
    found["classify"] = attempts(lambda: grid.classify(cloud, labels, np.zeros(3)))
    ranges = np.full((points // 10, 90), 3.0, np.float32)
    circles = CircleDetector()
    bearings = np.linspace(-0.2, 0.2, 90)
    found["circles"] = attempts(lambda: circles.detect(ranges, bearings))
    targets = [flight(seed, points // 400) for seed in range(20)]
    found["fusion"] = attempts(lambda: run_batch(targets, FusionConfig(), threads=2))
    size = int(points**0.5)
    costs = np.random.default_rng(0).random((size, size))
    found["assign"] = attempts(lambda: cheapest(costs, gate=2.0, alone=1e9))
    found["handled"] = handled(cloud)
    sys.stdout.write(json.dumps(found))


def flight(seed, fixes):
    """Fixes of a target that moves evenly."""
    noise = np.random.default_rng(seed)
    places = np.arange(fixes)[:, None] * [1.0, 0.5] + 0.1 * noise.standard_normal((fixes, 2))
    return Measurements(
        [Measurement(row * 10**8, "lidar", place) for row, place in enumerate(places)]
    )


def handled(cloud):
    """A handler that does not raise is called on the way, and the call goes on to the same bits."""
    calls = []
    fresh = [FlyingObjectDetector(FlyingConfig(), threads=2) for _ in range(2)]
    fresh[0].process(cloud, np.eye(4), 0)
    signal.signal(signal.SIGINT, lambda *_: calls.append(now()))
    one = Attempt(lambda: fresh[1].process(cloud, np.eye(4), 0), 0.0)
    same = fresh[0].to_bytes() == fresh[1].to_bytes()
    return {"wait": calls[0][0] - one.sent[0], "n_calls": len(calls), "same": same}


if __name__ == "__main__":
    if len(sys.argv) > 2:
        SHARES[:] = np.linspace(0.0, 0.9, int(sys.argv[2]))
    main(int(sys.argv[1]))
