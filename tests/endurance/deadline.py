"""`python -m endurance.deadline`: scans at a steady rate beside a busy core and a churning cache.

Each scan has to be done before the next one comes. Latency counts from the time at which a scan is
due to the end of its call, so that a late call makes those after it late, too.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time

import numpy as np

from endurance.flight import HEIGHT, scan, sights

MOST_P999_MS, MOST_MS = 100.0, 250.0
"""Source: goal G16 of the reliability notes, for 10 scans per second."""
HOG = "while True: pass"
CHURN = """
import os, sys
block = os.urandom(1 << 20)
while True:
    with open(sys.argv[1], "wb") as file:
        for _ in range(1024):
            file.write(block)
    with open(sys.argv[1], "rb") as file:
        while file.read(1 << 20):
            pass
"""


def disturbances(folder: str) -> list[subprocess.Popen[bytes]]:
    """A process that never waits, and one that writes and reads 1 GiB again and again."""
    programs = ([HOG], [CHURN, os.path.join(folder, "churn")])
    return [subprocess.Popen([sys.executable, "-c", *program]) for program in programs]


def latencies(scans: int, rate: float, columns: int) -> np.ndarray:
    """Of each scan, from the time at which it is due to the end of its call [ms]."""
    from lidar_core.flying import FlyingConfig, FlyingObjectDetector

    detector = FlyingObjectDetector(FlyingConfig())
    rays, noise, pose = sights(columns), np.random.default_rng(0), np.eye(4)
    pose[2, 3] = HEIGHT
    made = []
    for number in range(20):  # made before, so that only the detector is measured
        ball = np.array([7 + np.sin(number * np.pi / 10), 2.0, HEIGHT])
        made.append(scan(0.0, ball, rays, noise))
    late, begin = np.zeros(scans), time.monotonic()
    for number in range(scans):
        due = begin + number / rate
        time.sleep(max(0.0, due - time.monotonic()))
        detector.process(made[number % len(made)], pose, round(number / rate * 1e9))
        late[number] = 1e3 * (time.monotonic() - due)
    return late


def main() -> int:
    """Print the latencies; 1 if a bound is broken."""
    parser = argparse.ArgumentParser(prog="python -m endurance.deadline", description=__doc__)
    parser.add_argument("--seconds", type=float, default=300.0)
    parser.add_argument("--rate", type=float, default=10.0, help="scans per second")
    parser.add_argument("--columns", type=int, default=450, help="rays of one of 16 rows")
    parser.add_argument("--quiet", action="store_true", help="without a hog and churn")
    chosen = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        others = [] if chosen.quiet else disturbances(folder)
        try:
            late = latencies(round(chosen.seconds * chosen.rate), chosen.rate, chosen.columns)
        finally:
            for other in others:
                other.kill()
                other.wait()
    median, p99, p999 = np.quantile(late, [0.5, 0.99, 0.999])
    print(
        f"{len(late)} scans of {16 * chosen.columns} rays at {chosen.rate:g} Hz: median"
        f" {median:.0f} ms, 99 % {p99:.0f} ms, 99.9 % {p999:.0f} ms, longest {late.max():.0f} ms"
    )
    return int(p999 >= MOST_P999_MS or late.max() >= MOST_MS)


if __name__ == "__main__":
    sys.exit(main())
