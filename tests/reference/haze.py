"""Slow oracle of droplets in the air: near returns that chance explains.

Written from the decision in `docs/adr/0008-sky.md`, one return after the other.
"""

from itertools import accumulate
from math import exp

import numpy as np

BIN, FARTHEST = 0.25, 10.0
WINDOW, WINDOW_NS = 5, 500_000_000


def least_count(mean, chance):
    """Least count that is met with less than a chance where `mean` are expected (Poisson)."""
    terms = accumulate(range(1, 10_000), lambda term, k: term * mean / k, initial=exp(-mean))
    below = 0.0
    for count, term in enumerate(terms, start=1):
        below += term
        if 1.0 - below <= chance:
            return count
    raise AssertionError("no such count")


class Haze:
    """Near returns of the last scans, while the air was full of droplets."""

    def __init__(self):
        self.recent = []

    def droplets(self, points, cells, beside, sectors, ground, free_at, stamp_ns):
        """As `droplets`, given the scans before; keeps this one."""
        window = [scan for at, scan in self.recent if stamp_ns - at <= WINDOW_NS]
        found, is_full = droplets(points, cells, beside, sectors, ground, free_at, window)
        near = np.linalg.norm(points, axis=1) < FARTHEST
        bins = (np.linalg.norm(points[near], axis=1) / BIN).astype(int)
        scan = list(zip(cells[near].tolist(), bins.tolist(), strict=True))
        self.recent = [*self.recent, (stamp_ns, scan)][-WINDOW + 1 :] if is_full else []
        return found


def counted(places):
    """Bins of range of the returns of every cell."""
    of_cell = {}
    for cell, at in places:
        of_cell.setdefault(cell, []).append(at)
    return of_cell


def looked_at(of_cell, around, at, first):
    """Other returns within a bin, and those on the seven bins before that the sensor sees.

    The second one is for the whole depth, and None if the sensor is blind there.
    """
    bins = np.concatenate([of_cell.get(cell, []) for cell in around])
    others = int((np.abs(bins - at) <= 1).sum()) - 1
    nearest = max(at - 8, first)
    depth = max(at - 1, 0) - nearest
    before = int(((bins <= at - 2) & (bins >= nearest)).sum()) * 7
    return others, before // depth if depth > 0 else None


def surface_levels(others, before):
    """2 where returns beside one are of a surface, 1 if they may be, 0 if chance gives them."""
    return sum(others >= max(least_count(before * 3 / 7, chance), 2) for chance in (0.05, 1e-3))


def droplets(points, cells, beside, sectors, ground, free_at, window=()):
    """Which returns are of droplets, (N,) bool: none in clear air. And whether the air is full.

    `cells` are their cells of direction, `beside` the neighbours of every cell, `sectors` the
    sector of azimuth of every cell; what is lower than `ground` is none. `free_at` tells of
    places, seen from the sensor, whether the map had seen free space there before the scan.
    `window` holds cells and bins of the near returns of the scans before.
    """
    length = np.linalg.norm(points, axis=1)
    near = np.flatnonzero(length < FARTHEST)
    bins = (length[near] / BIN).astype(int)
    here = list(zip(cells[near].tolist(), bins.tolist(), strict=True))
    now, last = counted(here), counted([*here, *(place for scan in window for place in scan)])
    first = next((at for at in range(40) if 100 * (bins <= at).sum() >= len(bins)), 0)
    level = np.full(len(points), 2)  # 0 droplet, 1 either, 2 surface
    stays = np.zeros(len(points), bool)
    for row, (cell, at) in zip(near, here, strict=True):
        if points[row, 2] < ground:
            continue
        others, before = looked_at(now, beside[cell], at, first)
        if before is None:  # what is usual so near
            usual = (np.abs(bins - at) <= 1).sum() * len(beside[cell]) * 7
            before = int(usual) // (len(np.unique(cells)) * (3 if at > 0 else 2))
        level[row] = surface_levels(others, before)
        others, before = looked_at(last, beside[cell], at, first)
        stays[row] = bool(window) and before is not None and surface_levels(others, before + 1) == 2
    step = max(len(near) // 1024, 1)
    judged = near[::step]
    judged = judged[(level[judged] == 0)]
    far = judged[(length[judged] / BIN).astype(int) * BIN >= 2.0]
    share = len(judged) * step / len(points)
    filled = len(np.unique(sectors[cells[judged]])) / len(np.unique(sectors[cells]))
    passes = len(far) > 0 and free_at(points[far]).sum() >= 0.5 * len(far)
    is_full = len(np.unique(cells[judged])) >= 20 and share >= 0.03 and filled >= 0.75 and passes
    level[stays] = 2
    solid = {(cells[row], int(length[row] / BIN)) for row in near if level[row] == 2}
    found = level == 0
    for row, at in zip(near, bins, strict=True):
        if level[row] == 1:
            depths = range(max(at - 1, 0), at + 2)
            found[row] = not any((c, d) in solid for c in beside[cells[row]] for d in depths)
    return found & is_full, is_full
