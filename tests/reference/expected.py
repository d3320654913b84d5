"""Targets that tracks predict near structure: they fly, although rule A makes them background.

Written from ADR 0008 and the text of `rust/lidar_core/src/flying/classify/expected.rs`.
"""

import itertools
import math

import numpy as np

from reference.classify import diagonal
from reference.voxel_map import BACKGROUND, FLYING

MARGIN = 0.25  # points so far outside the box of a target may be its own [m]
SMALLEST, LARGEST = 0.3, 1.6  # least size [m]; a cluster is at most so many times as large
SEEN, STDS, FARTHEST = 0.5, 2.5, 0.5  # [s]; standard deviations around the prediction, at most [m]
FLYING_KIND = 1
ROUNDING = 1e-3


def targets(tracker, vmap, close_distance, stamp):
    """Position, velocity, half of the box of places, size: what is expected near structure."""
    for track in tracker.tracks:
        is_recent = (stamp - track.seen) * 1e-9 <= SEEN
        if not (track.confirmed and is_recent and track.kind == FLYING_KIND):
            continue
        x, P = tracker.at(track, stamp)
        std = np.sqrt(np.maximum(np.diag(P)[:3], 0))
        half = track.size / 2 + np.minimum(STDS * std, FARTHEST)
        centers = (np.array(vmap.occupied(), float).reshape(-1, 3) + 0.5) * vmap.config.voxel_size
        reach = close_distance + np.linalg.norm(half) + vmap.config.voxel_size
        if (np.linalg.norm(centers - x[:3], axis=1) <= reach).any():
            yield x[:3], x[3:6], half, track.size


def is_near(target, place, delay):
    position, velocity, half, _ = target
    return bool((np.abs(place - position - delay * velocity) <= half + MARGIN).all())


def is_clear(vmap, point):
    """The voxel of a place was observed, and nothing stands in it."""
    voxel = vmap.voxel_at(point)
    return voxel in vmap.values and not vmap.is_tentative(voxel)


def steps_in_reach(size, close_distance):
    """Voxels, at most 1, in which an occupied one is always close; None if not even the own is."""
    fits = [step for step in (0, 1) if (step + 0.5) * math.sqrt(3) + 1e-3 < close_distance / size]
    return max(fits, default=None)


def is_explained(vmap, point, close_distance):
    steps = steps_in_reach(vmap.config.voxel_size, close_distance)
    if steps is None:
        return False
    x, y, z = vmap.voxel_at(point)
    around = list(itertools.product(range(-steps, steps + 1), repeat=3))
    return any(vmap.is_tentative((x + dx, y + dy, z + dz)) for dx, dy, dz in around)


def claimed(expected, vmap, cloud, labels, verdicts, origin, delays, rules):
    """Numbers of the clusters that fly since a track predicts them, in ascending order."""
    points = cloud.astype(float)
    own_rows = {
        row
        for row in np.flatnonzero(np.isfinite(points).all(axis=1))
        if any(is_near(target, points[row], delays[row]) for target in expected)
        and is_clear(vmap, points[row])
    }
    found = set()
    for target in expected:
        largest = LARGEST * max(SMALLEST, target[3].max())
        best = None
        for label in range(len(verdicts)):
            rows = np.flatnonzero(labels == label)
            own = points[rows]
            width, depth, height = np.ptp(own, axis=0)
            is_upright = rules.upright_height is not None and (
                height >= rules.upright_height and math.hypot(width, depth) <= 0.4 * height
            )
            may_be = (
                is_near(target, own.mean(axis=0), delays[rows[0]])
                and max(width, depth, height) <= largest
                and 2 * sum(is_clear(vmap, point) for point in own) > len(own)
                and len(own) >= rules.min_points
                and not is_upright
                and (rules.max_extent is None or diagonal(own) <= rules.max_extent)
                and np.linalg.norm(own.mean(axis=0) - origin) <= rules.max_distance
                and all(
                    row in own_rows or not is_explained(vmap, points[row], rules.close_distance)
                    for row in rows
                )
            )
            if may_be and (best is None or len(own) > best[0]):
                best = len(own), label
        if best is not None and verdicts[best[1]] != FLYING:
            found.add(best[1])
    return sorted(found)


class Boxes:
    """Boxes around clusters."""

    def __init__(self, cloud, labels, numbers) -> None:
        clusters = [cloud[labels == number].astype(float) for number in numbers]
        self.bounds = [(own.min(axis=0), own.max(axis=0)) for own in clusters]

    def holds(self, place, distance=ROUNDING):
        """Whether a place is so near to a box."""
        away = [np.maximum(np.maximum(low - place, place - high), 0) for low, high in self.bounds]
        return any(np.linalg.norm(way) <= distance for way in away)

    def without_structure(self, cloud, point_class, distance):
        """The cloud without the background beside a box, which is no part of the target."""
        cut = cloud.copy()
        for row in np.flatnonzero(point_class == BACKGROUND):
            if self.holds(cloud[row].astype(float), distance):
                cut[row] = np.nan
        return cut
