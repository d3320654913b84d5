"""What earlier scans met where something is now, in plain numpy: every ray, one after the other."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

AGES = (0.4, 0.8, 1.2, 1.6)  # [s]
YOUNGER, OLDER, APART = 0.1, 0.6, 0.1  # share of the age, [s], [s]
MARGIN, USUAL = (0.02, 0.12), 4.0  # [m], medians
FEWEST, MOST, KNOWN = 20, 100, 0.3  # samples, samples, [m]
RECEDED, JOINED = 0.3, 0.3  # [m]
MOST_POINTS, LEAST_KNOWN = 40, 0.5


@dataclass
class Scan:
    """A scan in its level frame, with its pose in the plane and its time [ns]."""

    stamp_ns: int
    place: np.ndarray
    yaw: float
    bearings: np.ndarray
    ranges: np.ndarray
    range_max: float

    def __post_init__(self):
        self.step = (self.bearings[-1] - self.bearings[0]) / (len(self.bearings) - 1)
        directions = np.stack([np.cos(self.bearings), np.sin(self.bearings)], axis=1)
        hit = np.isfinite(self.ranges)
        self.ends = np.where(hit, self.ranges, np.nan)[:, None] * directions
        # Surfaces on both sides of every end: straight to a neighbour, else half a gap.
        reach = 0.5 * self.step * np.stack([-self.ends[:, 1], self.ends[:, 0]], axis=1)
        self.others = []
        for side in (-1, 1):
            beside = np.roll(self.ends, -side, axis=0)
            beside[0 if side < 0 else -1] = np.nan
            joined = np.linalg.norm(beside - self.ends, axis=1) < JOINED
            self.others.append(np.where(joined[:, None], beside, self.ends + side * reach))

    def since(self, other):
        """Time from another scan to this one [s]."""
        return (self.stamp_ns - other.stamp_ns) * 1e-9

    def level(self, point):
        c, s = np.cos(self.yaw), np.sin(self.yaw)
        return np.array([[c, s], [-s, c]]) @ (point - self.place)

    def world(self, point):
        c, s = np.cos(self.yaw), np.sin(self.yaw)
        return np.array([[c, -s], [s, c]]) @ point + self.place

    def around(self, bearing, half):
        off = (self.bearings - bearing + np.pi) % (2 * np.pi) - np.pi
        return np.flatnonzero(np.abs(off) <= half)

    def off(self, point, rays):
        """Distance from the surfaces of some rays."""
        rays = np.asarray(rays)[np.isfinite(self.ranges[rays])]
        if not len(rays):
            return np.inf
        found = []
        for others in self.others:
            way, from_end = others[rays] - self.ends[rays], point - self.ends[rays]
            length = np.maximum((way * way).sum(axis=1), 1e-300)
            share = np.clip((from_end * way).sum(axis=1) / length, 0, 1)
            found.append(np.linalg.norm(from_end - share[:, None] * way, axis=1).min())
        return min(found)

    def met(self, point, margin):
        """'surface', 'free' or None for a point of this scan's frame."""
        distance, bearing = np.hypot(*point), np.arctan2(point[1], point[0])
        rays = self.around(bearing, max(margin / max(distance, margin), self.step))
        if not len(rays):
            return None
        wider = np.arange(max(rays[0] - 1, 0), min(rays[-1] + 2, len(self.ranges)))
        if self.off(point, wider) < margin:
            return "surface"
        if (self.ranges[rays] < distance).any():
            return None
        known = ~np.isnan(self.ranges[rays])
        return "free" if known.any() and distance < self.range_max else None


class Earlier:
    """Recent scans."""

    def __init__(self):
        self.kept = []

    def keep(self, scan):
        if self.kept and scan.since(self.kept[-1]) < APART:
            return
        longest = AGES[-1] + OLDER
        self.kept = [one for one in [*self.kept, scan] if scan.since(one) <= longest]

    def trace(self, now, points):
        """Share of points where earlier scans met a surface; None if they tell too little."""
        asked = []
        for age in AGES:
            old = [one for one in self.kept if age * (1 - YOUNGER) <= now.since(one) < age + OLDER]
            if old and not any(one is old[-1] for one in asked):
                asked.append(old[-1])
        chosen = points[:: max(1, -(-len(points) // MOST_POINTS))]
        there = free = 0
        for old in asked:
            margin = usual(now, old)
            for point in chosen:
                answer = old.met(old.level(point), margin)
                there += answer == "surface"
                free += answer == "free" or (
                    answer is None and has_receded(now, old, point, margin)
                )
        known = there + free
        if not known or known < LEAST_KNOWN * len(asked) * len(chosen):
            return None
        return there / known


def usual(now, then):
    """Margin from the median distance of this scan's ends from the surfaces of an earlier one."""
    apart = []
    for end in now.ends[:: max(1, -(-len(now.ends) // MOST))]:
        if not np.isfinite(end).all():
            continue
        place = then.level(now.world(end))
        rays = then.around(np.arctan2(place[1], place[0]), 2 * then.step)
        if len(rays):
            apart.append(then.off(place, rays))
    apart = sorted(value for value in apart if value < KNOWN)
    if len(apart) < FEWEST:
        return MARGIN[1]
    return float(np.clip(USUAL * apart[len(apart) // 2], *MARGIN))


def has_receded(now, then, point, margin):
    """Whether a surface was just before a point, where rays pass now."""
    place = then.level(point)
    rays = then.around(np.arctan2(place[1], place[0]), 0.51 * then.step)
    if not len(rays) or not then.ranges[rays[0]] < np.hypot(*place):
        return False
    old = then.world(then.ends[rays[0]])
    return np.hypot(*(point - old)) < RECEDED and now.met(now.level(old), margin) == "free"
