"""Static objects, found offline in raw returns without the pipeline."""

import numpy as np
from numpy.typing import NDArray

from lidar_core.io import PosedScan
from lidar_core.messages import LaserScan

NEAR = 0.15
"""Distance of returns of one standing thing [m]."""
LONG_S = 3.0
"""Time over which they are there [s]."""
OFTEN = 0.9
"""Share of the scans of that time with a return there: single rays miss edges."""
CELL = 0.1
"""Cells whose neighbours are one thing [m]."""

Points = NDArray[np.float64]


def returns_world(item: PosedScan[LaserScan], far: float) -> Points:
    """Returns (K, 2) of a scan up to a range `far` in the world."""
    scan, pose = item.scan, item.world_from_lidar.reshape(-1, 4, 4)[0]
    ranges = np.asarray(scan.ranges, np.float64)
    hit = np.isfinite(ranges) & (ranges >= max(scan.range_min, 0.05)) & (ranges < far)
    angles = scan.angle_min + scan.angle_increment * np.flatnonzero(hit)
    level = np.stack([np.cos(angles), np.sin(angles)], axis=1) * ranges[hit, None]
    found: Points = level @ pose[:2, :2].T + pose[:2, 3]
    return found


def standing(points: list[Points], seconds: NDArray[np.float64]) -> list[NDArray[np.bool_]]:
    """Return for every return of every scan whether it belongs to a static object.

    It does if within some interval of `LONG_S` [s] that contains its scan, a share of at least
    `OFTEN` of the scans has a return within `NEAR` [m] of it.

    Parameters
    ----------
    points : list of ndarray, shape (K, 2)
        Returns of each scan in the world [m].
    seconds : ndarray, shape (S,)
        Times of the scans [s], ascending.
    """
    found = []
    for number, here in enumerate(points):
        first = int(np.searchsorted(seconds, seconds[number] - LONG_S))
        last = int(np.searchsorted(seconds, seconds[number] + LONG_S, side="right"))
        around = range(first, last)
        near = np.array([_is_near(here, points[other]) for other in around])
        total = np.vstack([np.zeros(len(here)), np.cumsum(near, axis=0)])
        stands = np.zeros(len(here), np.bool_)
        for start in range(first, number + 1):
            end = int(np.searchsorted(seconds, seconds[start] + LONG_S))
            if end >= len(seconds) or end > last or end <= number:
                continue
            share = (total[end - first] - total[start - first]) / (end - start)
            stands |= share >= OFTEN
        found.append(stands)
    return found


def things(points: list[Points], stands: list[NDArray[np.bool_]]) -> list[NDArray[np.int64]]:
    """Return the number of the static object of every return; -1 for none.

    Static returns of all scans belong to one object if their cells of `CELL` touch.
    """
    cells = [np.floor(there / CELL).astype(np.int64) for there in points]
    held = {
        (int(x), int(y))
        for there, stand in zip(cells, stands, strict=True)
        for x, y in there[stand]
    }
    number_of: dict[tuple[int, int], int] = {}
    for number, cell in enumerate(sorted(held)):
        if cell in number_of:
            continue
        number_of[cell] = number
        todo = [cell]
        while todo:
            x, y = todo.pop()
            for there in [(x + i, y + j) for i in (-1, 0, 1) for j in (-1, 0, 1)]:
                if there in held and there not in number_of:
                    number_of[there] = number
                    todo.append(there)
    return [
        np.array(
            [number_of[int(x), int(y)] if yes else -1 for (x, y), yes in zip(c, s, strict=True)],
            np.int64,
        )
        for c, s in zip(cells, stands, strict=True)
    ]


def _is_near(here: Points, there: Points) -> NDArray[np.bool_]:
    if not len(there):
        return np.zeros(len(here), np.bool_)
    apart = here[:, None].astype(np.float32) - there[None].astype(np.float32)
    near: NDArray[np.bool_] = ((apart * apart).sum(axis=2) < NEAR * NEAR).any(axis=1)
    return near
