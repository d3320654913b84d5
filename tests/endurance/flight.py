"""`python -m endurance.flight`: a long straight flight through a street, with a small map.

A LiDAR with 16 rows flies along an endless street of houses; a ball flies in front of it, always.
The map reaches its budget after the first kilometre or two. No scan may be refused after that, the
ball must stay tracked, and the process must not grow.
"""

import argparse
import resource
import sys
import time
from pathlib import Path

import numpy as np

EVERY = 1000
"""Metres between two lines."""
SEEN = 0.85
"""Share of scans in which the ball has to be tracked, in every kilometre after the first."""
BYTES = 4.3
"""Of a stored voxel: text of `voxel_map.max_voxels`."""
HEIGHT, REACH = 5.0, 40.0
BALL = 0.3


def sights(columns: int) -> np.ndarray:
    """Unit directions of the rays, row by row from above."""
    azimuth = np.linspace(-np.pi, np.pi, columns, endpoint=False)
    elevation = np.radians(np.linspace(15, -15, 16))
    level = np.cos(elevation)[:, None]
    rows = (
        level * np.cos(azimuth),
        level * np.sin(azimuth),
        np.sin(elevation)[:, None] + 0 * azimuth,
    )
    return np.stack(rows, axis=-1).reshape(-1, 3)


def houses(x: float) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper corners of the houses around `x`: the same whenever one comes by."""
    lower, upper = [], []
    for cell in range(int((x - REACH) // 10), int((x + REACH) // 10) + 1):
        for side in (-1, 1):
            width, depth, height, gap = np.random.default_rng((cell + 10**6, side + 1)).random(4)
            near = side * (6 + 4 * gap)
            edges = sorted((near, near + side * (4 + 6 * depth)))
            lower.append((10 * cell, edges[0], 0.0))
            upper.append((10 * cell + 4 + 5 * width, edges[1], 3 + 9 * height))
    return np.array(lower), np.array(upper)


def scan(x: float, ball: np.ndarray, rays: np.ndarray, noise: np.random.Generator) -> np.ndarray:
    """Returns around a sensor at (x, 0, HEIGHT), in its frame; NaN without one."""
    origin = np.array([x, 0.0, HEIGHT])
    with np.errstate(divide="ignore", invalid="ignore"):
        ranges = np.where(rays[:, 2] < 0, -HEIGHT / rays[:, 2], np.inf)
        for lower, upper in zip(*houses(x), strict=True):
            one, other = (lower - origin) / rays, (upper - origin) / rays
            near = np.minimum(one, other).max(axis=1)
            far = np.maximum(one, other).min(axis=1)
            ranges = np.where((near < far) & (near > 0), np.minimum(ranges, near), ranges)
    along = rays @ (ball - origin)
    inside = BALL**2 - (np.square(ball - origin).sum() - along**2)
    hit = (inside > 0) & (along > 0)
    ranges = np.where(hit, np.minimum(ranges, along - np.sqrt(np.maximum(inside, 0))), ranges)
    ranges = ranges + 0.01 * noise.standard_normal(len(ranges))
    ranges[ranges > REACH] = np.nan
    return (rays * ranges[:, None]).astype(np.float32)


def resident() -> float:
    """Memory that the process holds now [MiB]."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * resource.getpagesize() / 2**20


def main() -> int:
    """Print a line per kilometre; 1 if a scan was refused, the ball lost, or memory grew."""
    from lidar_core.errors import LidarCoreError
    from lidar_core.flying import FlyingConfig, FlyingObjectDetector

    parser = argparse.ArgumentParser(prog="python -m endurance.flight", description=__doc__)
    parser.add_argument("--km", type=float, default=50.0)
    parser.add_argument("--budget", type=float, default=200.0, help="of the map [MB]")
    parser.add_argument("--step", type=float, default=2.5, help="way between two scans [m]")
    parser.add_argument("--columns", type=int, default=450, help="rays of one row")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--growth", type=float, default=16.0, help="from the budget on [MiB]")
    chosen = parser.parse_args()
    config = FlyingConfig.load({"voxel_map": {"max_voxels": int(chosen.budget * 1e6 / BYTES)}})
    detector = FlyingObjectDetector(config)
    step = chosen.step
    rays, noise = sights(chosen.columns), np.random.default_rng(chosen.seed)
    pose, refused, seen, total = np.eye(4), 0, 0, 0
    full_at, least, peak, lost = None, np.inf, 0.0, 0
    begin = time.process_time()
    for number in range(int(1000 * chosen.km / step)):
        x, phase = step * number, number / 40
        pose[:3, 3] = x, 0.0, HEIGHT
        ball = np.array([x + 7 + np.sin(phase), 2 * np.sin(0.7 * phase), HEIGHT + np.cos(phase)])
        points = scan(x, ball, rays, noise)
        try:
            frame = detector.process(points, pose, number * 10**8)
        except LidarCoreError as error:
            refused += 1
            print(f"refused at {x:.0f} m: {error}", flush=True)
            continue
        total += 1
        flying = frame.tracks.flying.position
        seen += bool(len(flying)) and np.linalg.norm(flying - ball, axis=1).min() < 1.0
        if (number + 1) % int(EVERY / step) == 0:
            held, size = resident(), detector.map_memory_bytes / 1e6
            full = detector.health().n_voxels_forgotten > 0
            if full and full_at is None:
                full_at, least = x, held
            if full:
                peak = max(peak, held)
            pace = 1e3 * (time.process_time() - begin) / total
            print(
                f"{(x + step) / 1000:5.0f} km: ball {seen / EVERY * step:.3f}, map {size:.1f} MB,"
                f" process {held:.1f} MiB, refused {refused}, {pace:.0f} ms of CPU per scan",
                flush=True,
            )
            lost += number > EVERY / step and seen < SEEN * EVERY / step
            seen = 0
    growth = peak - least if full_at is not None else 0.0
    print(
        f"{chosen.km:g} km, budget {chosen.budget:g} MB reached by"
        f" {'nowhere' if full_at is None else f'{full_at / 1000:.0f} km'}: refused {refused},"
        f" growth {growth:.1f} MiB, kilometres with the ball below {SEEN:g}: {lost}"
    )
    return int(full_at is None or refused > 0 or growth > chosen.growth or lost > 0)


if __name__ == "__main__":
    sys.exit(main())
