"""The expected circle of an arc by brute force: every circle of a grid against every ray."""

import math

import numpy as np

NODES = 90  # per tangent
DISTANCES = 13
RARITY = 8  # power with which circles of more than the usual radius become rare
REACH = 4.0  # of the grid of distances, in standard deviations


def above(z):
    """Probability that a standard normal variable is above z, (...)."""
    chance = np.where(z > 0, 0.0, 1.0)
    near = abs(z) < 8.0  # the rest is certain
    chance[near] = [0.5 * math.erfc(one / math.sqrt(2)) for one in z[near].tolist()]
    return chance


def ranges_of(circles, bearings):
    """Range of every ray to every circle, (..., rays); +inf where it passes."""
    x, y, r = (np.asarray(entry)[..., None] for entry in circles)
    along = x * np.cos(bearings) + y * np.sin(bearings)
    across = x * np.sin(bearings) - y * np.cos(bearings)
    square = r**2 - across**2
    with np.errstate(invalid="ignore"):
        return np.where((square >= 0) & (along > 0), along - np.sqrt(square), np.inf)


def posterior(ranges, bearings, lows, highs, *, std, radius, usual, missed=(), limits=(0.1, 10)):
    """Mean and covariance of (x, y, r).

    `lows` and `highs` bound the bearings of the two tangents; rays `missed` returned nothing, so
    a circle that they cross has to lie outside `limits` there.
    """

    def places(bounds, hit):
        # Denser towards the outermost hit, where the ranges change fastest.
        root = np.sqrt(abs(bounds[0] - bounds[1])) * (np.arange(NODES) + 0.5) / NODES
        return hit + np.sign(bounds[0] + bounds[1] - 2 * hit) * root**2, 2 * root

    hits = bearings[[0, -1]]
    (u1, w1), (u2, w2) = places(lows, hits[0]), places(highs, hits[1])
    u1, u2 = (grid[..., None] for grid in np.meshgrid(u1, u2, indexing="ij"))
    beta, alpha = (u1 + u2) / 2, (u2 - u1) / 2
    # Where the distances lie that agree with the ranges: any scale would do, if it were wide.
    unit = ranges_of((np.cos(beta), np.sin(beta), np.sin(alpha) * (1 + 1e-12)), bearings)
    best = (unit * ranges).sum(axis=-1) / (unit**2).sum(axis=-1)
    spread = std / np.sqrt((unit**2).sum(axis=-1))
    d = best + REACH * spread * np.linspace(-1, 1, DISTANCES)
    x, y, r = d * np.cos(beta), d * np.sin(beta), d * np.sin(alpha) * (1 + 1e-12)
    misfit = ((ranges - ranges_of((x, y, r), bearings)) / std) ** 2
    log = -0.5 * misfit.sum(axis=-1)
    for ray in missed:
        there = ranges_of((x, y, r), np.array([ray]))[..., 0]
        crossed = np.isfinite(there)
        chance = above((limits[1] - there) / std) + above((there - limits[0]) / std)
        log = log + np.where(crossed, np.log(np.maximum(chance, 1e-300)), 0.0)
    log = np.where((r >= radius[0]) & (r <= radius[1]), log, -np.inf)
    weight = np.exp(log - log.max()) * d**2 * np.cos(alpha) * np.minimum(usual / r, 1) ** RARITY
    weight = weight * (w1[:, None] * w2 * spread[..., 0])[..., None]
    weight /= weight.sum()
    circles = np.stack([x, y, r], axis=-1)
    mean = (weight[..., None] * circles).sum(axis=(0, 1, 2))
    apart = circles - mean
    return mean, np.einsum("abc,abci,abcj->ij", weight, apart, apart)


def kasa(x, y):
    """Least squares of x^2 + y^2 = 2 a x + 2 b y + c, as (a, b, radius)."""
    matrix = np.stack([2 * x, 2 * y, np.ones_like(x)], axis=1)
    a, b, c = np.linalg.lstsq(matrix, x**2 + y**2, rcond=None)[0]
    return np.array([a, b, np.sqrt(c + a**2 + b**2)])
