"""Slow oracle of droplets in the air: near returns that chance explains.

Written from the decision in `docs/adr/0008-sky.md`, one return after the other.
"""

from itertools import accumulate
from math import exp

import numpy as np

BIN, FARTHEST = 0.25, 10.0


def least_count(mean, chance):
    """Least count that is met with less than a chance where `mean` are expected (Poisson)."""
    terms = accumulate(range(1, 10_000), lambda term, k: term * mean / k, initial=exp(-mean))
    below = 0.0
    for count, term in enumerate(terms, start=1):
        below += term
        if 1.0 - below <= chance:
            return count
    raise AssertionError("no such count")


def droplets(points, cells, beside, sectors, ground, free_at):
    """Which returns are of droplets, (N,) bool: none in clear air.

    `cells` are their cells of direction, `beside` the neighbours of every cell, `sectors` the
    sector of azimuth of every cell; what is lower than `ground` is none. `free_at` tells of
    places, seen from the sensor, whether the map had seen free space there before the scan.
    """
    length = np.linalg.norm(points, axis=1)
    near = np.flatnonzero(length < FARTHEST)
    bins = (length[near] / BIN).astype(int)
    of_cell = {}
    for at, cell in zip(bins, cells[near], strict=True):
        of_cell.setdefault(cell, []).append(at)
    level = np.full(len(points), 2)  # 0 droplet, 1 either, 2 surface
    for row, at in zip(near, bins, strict=True):
        if points[row, 2] < ground:
            continue
        around = np.concatenate([of_cell.get(cell, []) for cell in beside[cells[row]]])
        others = (np.abs(around - at) <= 1).sum() - 1
        depth = min(at - 1, 7)
        if depth <= 0:
            level[row] = 0
            continue
        before = int(((around <= at - 2) & (around >= at - 8)).sum() * 7 / depth)
        level[row] = sum(
            others >= max(least_count(before * 3 / 7, chance), 2) for chance in (0.05, 1e-3)
        )
    step = max(len(near) // 1024, 1)
    judged = near[::step]
    judged = judged[(level[judged] == 0)]
    far = judged[(length[judged] / BIN).astype(int) * BIN >= 2.0]
    share = len(judged) * step / len(points)
    filled = len(np.unique(sectors[cells[judged]])) / len(np.unique(sectors[cells]))
    passes = len(far) > 0 and free_at(points[far]).sum() >= 0.5 * len(far)
    is_full = len(judged) >= 20 and share >= 0.03 and filled >= 0.75 and passes
    solid = {(cells[row], int(length[row] / BIN)) for row in near if level[row] == 2}
    found = level == 0
    for row, at in zip(near, bins, strict=True):
        if level[row] == 1:
            depths = range(max(at - 1, 0), at + 2)
            found[row] = not any((c, d) in solid for c in beside[cells[row]] for d in depths)
    return found & is_full
