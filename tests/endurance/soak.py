"""`python -m endurance.soak`: the same loop for hours; memory and time per scan must not grow.

A LiDAR goes round a yard with houses, again and again, while a ball flies before it. An hour at
10 Hz are 36,000 scans. Time is that of the processor, so that other work beside it does not count.
"""

import argparse
import sys
import time

import numpy as np

from endurance.flight import BALL, resident

ROUND = 60
"""Scans of one round; their surroundings are made once."""
RADIUS, HEIGHT = 8.0, 2.0
YARD = (30.0, 25.0, 12.0)
"""Half edges of the walls around all, and the height of the sky above that counts as a wall [m]."""
HOUSES = 8


def sights(points: int) -> np.ndarray:
    """Unit directions of `points` rays in 64 rows, row by row."""
    azimuth = np.linspace(-np.pi, np.pi, points // 64, endpoint=False)
    elevation = np.radians(np.linspace(20, -25, 64))[:, None]
    level = np.cos(elevation)
    rows = level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation) + 0 * azimuth
    return np.stack(rows, axis=-1).reshape(-1, 3)


def ranges_at(place: np.ndarray, rays: np.ndarray) -> np.ndarray:
    """Ranges to ground, walls and houses around a sensor at `place`."""
    rng = np.random.default_rng(24)
    with np.errstate(divide="ignore", invalid="ignore"):
        walls = (np.array([YARD, (-YARD[0], -YARD[1], 0.0)])[:, None] - place) / rays
        ranges = np.where(walls > 0, walls, np.inf).min(axis=(0, 2))
        for angle in 2 * np.pi * np.arange(HOUSES) / HOUSES:
            middle = np.array([18 * np.cos(angle), 18 * np.sin(angle), 0.0])
            half = np.append(1 + 2 * rng.random(2), 0.0)
            lower, upper = middle - half, middle + half + [0, 0, 2 + 5 * rng.random()]
            one, other = (lower - place) / rays, (upper - place) / rays
            near, far = np.minimum(one, other).max(axis=1), np.maximum(one, other).min(axis=1)
            ranges = np.where((near < far) & (near > 0), np.minimum(ranges, near), ranges)
    return ranges


def surroundings(points: int) -> tuple[np.ndarray, list[np.ndarray], list[np.ndarray]]:
    """Rays, and poses and ranges of one round."""
    rays, poses, ranges = sights(points), [], []
    for angle in 2 * np.pi * np.arange(ROUND) / ROUND:
        pose = np.eye(4)
        pose[:3, 3] = RADIUS * np.cos(angle), RADIUS * np.sin(angle), HEIGHT
        poses.append(pose)
        ranges.append(ranges_at(pose[:3, 3], rays))
    return rays, poses, ranges


def with_ball(ranges: np.ndarray, rays: np.ndarray, ball: np.ndarray) -> np.ndarray:
    """Ranges where a ball at `ball`, seen from the sensor, is before the rest."""
    along = rays @ ball
    inside = BALL**2 - (ball @ ball - along**2)
    hit = (inside > 0) & (along > 0)
    return np.where(hit, np.minimum(ranges, along - np.sqrt(np.maximum(inside, 0))), ranges)


def main() -> int:
    """Print a line for every tenth; 1 if memory or time grew, or scans were lost."""
    from lidar_core.flying import FlyingObjectDetector

    parser = argparse.ArgumentParser(prog="python -m endurance.soak", description=__doc__)
    parser.add_argument("--scans", type=int, default=36_000)
    parser.add_argument("--points", type=int, default=131_072)
    parser.add_argument("--growth", type=float, default=16.0, help="of the process [MiB]")
    parser.add_argument("--slower", type=float, default=1.05, help="last tenth over the second")
    chosen = parser.parse_args()
    rays, poses, still = surroundings(chosen.points)
    noise = np.random.default_rng(0)
    detector, times, held = FlyingObjectDetector(), [], []
    for number in range(chosen.scans):
        pose, phase = poses[number % ROUND], number / 30
        ball = np.array([5 + np.sin(phase), 2 * np.sin(0.7 * phase), 1 + np.cos(phase)])
        ranges = with_ball(still[number % ROUND], rays, ball)
        ranges = ranges + 0.01 * noise.standard_normal(len(ranges))
        points = (rays * ranges[:, None]).astype(np.float32)
        begin = time.process_time()
        detector.process(points, pose, number * 10**8)
        times.append(time.process_time() - begin)
        held.append(resident())
        if (number + 1) % max(1, chosen.scans // 10) == 0:
            pace = 1e3 * np.median(times[-max(1, chosen.scans // 10) :])
            print(f"{number + 1} scans: {held[-1]:.1f} MiB, {pace:.1f} ms of CPU", flush=True)
    tenth = chosen.scans // 10
    growth = max(held[chosen.scans // 2 :]) - max(held[tenth : 2 * tenth])
    # The first tenth has the burn-in and an empty map: the second one is compared.
    slower = np.median(times[-tenth:]) / np.median(times[tenth : 2 * tenth])
    health = detector.health()
    lost = chosen.scans - health.processed - health.held - health.rejected
    print(
        f"{chosen.scans} scans of {chosen.points} points: growth {growth:.1f} MiB, last tenth"
        f" {slower:.3f} of the second, {health.processed} processed, {health.held} held,"
        f" {health.rejected} rejected, {lost} lost"
    )
    return int(growth > chosen.growth or slower > chosen.slower or lost != 0)


if __name__ == "__main__":
    sys.exit(main())
