"""What the way through Python costs: whole scans, timed around the call and around the core's.

While a scan is worked on, another Python thread counts as fast as it can.
"""

import statistics
import threading
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from rays import read_scans
from turns import Part

import lidar_core as lc

PERIOD_NS = 100_000_000
GOAL = 0.05
"""Largest share of the core's time that Python may add."""


class Timed:
    """Stands for an object of the core and keeps the CPU time of the last call [s]."""

    def __init__(self, core: object) -> None:
        self._core, self.seconds = core, 0.0

    def __getattr__(self, name: str) -> Callable[..., object]:
        """The call, timed."""

        def call(*args: object, **options: object) -> object:
            start = time.process_time()
            found = getattr(self._core, name)(*args, **options)
            self.seconds = time.process_time() - start
            return found

        return call


def flights(folder: Path) -> tuple[Callable[[int], None], Timed]:
    """Work on a scan of the folder, whatever its number; and the core's time of it."""
    detector = lc.flying.FlyingObjectDetector(lc.flying.FlyingConfig(), threads=1)
    detector._detector = timed = Timed(detector._detector)
    scans = []
    for origin, rays in read_scans(folder):
        pose = np.eye(4)
        pose[:3, 3] = origin
        points = np.ascontiguousarray(rays[:, 3:] - origin, np.float32)
        scans.append((points, pose, np.isnan(rays[:, 3]), np.ascontiguousarray(rays[:, :3])))

    def work(number: int) -> None:
        points, pose, missed, directions = scans[number % len(scans)]
        stamp = number * PERIOD_NS
        detector.process(points, pose, stamp, no_return=missed, directions=directions)

    return work, timed


def counted(during: Callable[[], None]) -> float:
    """How far another thread counts per second of `during`."""
    count, stop = 0, threading.Event()

    def run() -> None:
        nonlocal count
        while not stop.is_set():
            count += 1

    other = threading.Thread(target=run)
    start = time.perf_counter()
    other.start()
    during()
    stop.set()
    other.join()
    return count / (time.perf_counter() - start)


def measure(folder: Path, rounds: int) -> Part:
    """A sentence on the overhead, one on the other thread."""
    work, timed = flights(folder)
    work(0)
    shares = []
    for number in range(1, rounds + 1):
        start = time.process_time()
        work(number)
        shares.append((time.process_time() - start - timed.seconds) / timed.seconds)
    share = statistics.median(shares)

    def again() -> None:
        for number in range(rounds + 1, 2 * rounds + 1):
            work(number)

    beside = counted(again)
    alone = counted(lambda: time.sleep(0.5))
    verdict = "below" if share < GOAL else "**not below**"
    cost = f"Python adds {share:.2%} to the core's time of a whole scan: {verdict} {GOAL:.0%}."
    text = f"{cost} Meanwhile another Python thread counts at {beside / alone:.2f} of its speed."
    return text, {"border": {"share": share}}
