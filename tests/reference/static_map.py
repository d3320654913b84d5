"""A map of all that stands, in numpy: points of scans, without those that other scans see through.

Written from the text of `rust/lidar_core/src/flying/moving/`: `ray_view.rs`, `static_map.rs`.
"""

import numpy as np

PER_UNIT = (200, 100, 50)  # bins per unit of the measures of angles, finest first
SECTORS = 36  # parts of the azimuth with a start point of rays of their own
LONGEST, FARTHEST, BEHIND, STEP = 60.0, 45.0, 0.2, 0.01  # [m]
CELL, VOXEL = 0.028, 0.1  # [m]
HITS_PER_VIEW = 10
NONE = 65535  # length of the rays of a bin without any


def angles(way):
    """Measures of azimuth, 0 to 4, and elevation, 0 to 2: angles on a diamond, not a circle."""
    x, y, z = way.T
    level, sum_ = np.hypot(x, y), np.abs(x) + np.abs(y)
    with np.errstate(invalid="ignore", divide="ignore"):
        parts = np.where(x >= 0, y, -x) / sum_, np.where(x < 0, -y, x) / sum_
        azimuth = np.where(y >= 0, parts[0] + (x < 0), parts[1] + np.where(x < 0, 2, 3))
        elevation = 1 + z / (np.abs(z) + level)
    return np.where(sum_ > 0, azimuth, 0), np.where(np.abs(z) + level > 0, elevation, 1)


def bins(way, per_unit):
    azimuth, elevation = angles(way)
    row = np.minimum((elevation * per_unit).astype(int), 2 * per_unit - 1)
    return row, np.minimum((azimuth * per_unit).astype(int), 4 * per_unit - 1)


def sectors(way):
    return np.minimum((angles(way)[0] * SECTORS / 4).astype(int), SECTORS - 1)


class View:
    """How far the rays of a scan go: starts, ways, and lengths over which they meet nothing [m]."""

    def __init__(self, starts, ways, lengths, is_return) -> None:
        self.middle = starts.mean(axis=0)
        number = sectors(ways)
        self.starts = np.array(
            [
                starts[number == one].mean(axis=0) if (number == one).any() else self.middle
                for one in range(SECTORS)
            ]
        )
        steps = (np.minimum(lengths, LONGEST) / STEP).astype(int)
        self.levels = [self.level(per_unit, ways, steps, is_return) for per_unit in PER_UNIT]

    @staticmethod
    def level(per_unit, ways, steps, is_return):
        """Least return in a bin and those around it, and on each side the longest ray."""
        shape = 2 * per_unit, 4 * per_unit
        returns, empty = np.full(shape, NONE), np.zeros(shape, int)
        # Coarse bins are made of fine ones.
        row, column = (index // (PER_UNIT[0] // per_unit) for index in bins(ways, PER_UNIT[0]))
        np.minimum.at(returns, (row[is_return], column[is_return]), steps[is_return])
        np.maximum.at(empty, (row[~is_return], column[~is_return]), steps[~is_return])
        around = [(down, aside) for down in (-1, 0, 1) for aside in (-1, 0, 1)]

        def block(of):
            shifted = [
                np.roll(np.roll(of, -down, axis=0), -aside, axis=1) for down, aside in around
            ]
            return np.reshape(shifted, (3, 3, *shape))

        rays = block(np.where(returns < NONE, returns, empty))
        sides = rays[0], rays[2], rays[:, 0], rays[:, 2]
        longest = np.min([side.max(axis=0) for side in sides], axis=0)
        found = np.minimum(block(returns).min(axis=(0, 1)), longest)
        found[[0, -1]] = 0  # nothing is below the lowest row, and above the highest
        return found

    def sees_through(self, places):
        ways = places - self.starts[sectors(places - self.middle)]
        length = np.linalg.norm(ways, axis=1)
        needed = ((length + BEHIND) / STEP).astype(int)
        levels = zip(PER_UNIT, self.levels, strict=True)
        through = [found[bins(ways, per_unit)] > needed for per_unit, found in levels]
        return np.any(through, axis=0) & (length <= FARTHEST)


def cells(points, edge):
    return np.floor(points / edge).astype(int)


def static_points(scans):
    """Points of what stands, by cells; scans are (points, starts, ways of rays without return)."""
    views, kept, hits = [], {}, {}
    for points, starts, misses in scans:
        for cell, point in zip(map(tuple, cells(points, CELL)), points, strict=True):
            kept.setdefault(cell, point)
        for voxel in set(map(tuple, cells(points, VOXEL))):
            hits[voxel] = hits.get(voxel, 0) + 1
        begins = np.concatenate([starts, np.broadcast_to(starts[0], misses.shape)])
        ways = np.concatenate([points - starts, misses])
        lengths = np.r_[np.linalg.norm(points - starts, axis=1), np.full(len(misses), LONGEST)]
        views.append(View(begins, ways, lengths, np.arange(len(ways)) < len(points)))
    points = np.array([point for _, point in sorted(kept.items())])
    count = np.array([hits[voxel] for voxel in map(tuple, cells(points, VOXEL))])
    through = np.sum([view.sees_through(points) for view in views], axis=0)
    return points[through <= count // HITS_PER_VIEW]
