"""Oracle: rays in a scene of surfaces that scatter, mirror and pass light, one at a time.

Shares and powers only, no random numbers: what a long run of scans comes to.
"""

import math

import numpy as np

FADING = 0.4
"""Standard deviation of the logarithm of the returned power."""


def mirrored(mirror, cosine):
    """Schlick's share of mirrored light."""
    return mirror + (1 - mirror) * (1 - cosine) ** 5 if mirror > 0 else 0.0


def seen(reflectivity, cosine, distance, range_max, extinction=0.0):
    """Probability that what a surface scatters back is seen."""
    power = reflectivity / 0.1 * cosine * (range_max / distance) ** 2
    power *= math.exp(-2 * extinction * distance)
    # log(power) + FADING * n >= 0
    return 0.5 * (1 + math.erf(math.log(power) / FADING / math.sqrt(2))) if power > 0 else 0.0


def glass_before_a_wall(glass, wall, pane, back, range_max):
    """For a pane met head-on and a wall behind it: share that returns from pane, from wall."""
    first = 1 - mirrored(glass["mirror"], 1.0)
    at_pane = first * (1 - glass["clear"]) * seen(glass["reflectivity"], 1.0, pane, range_max)
    at_wall = first * glass["clear"] * seen(wall, 1.0, back, range_max)
    return at_pane, at_wall


def speckle(rate, start, reach):
    """Share of rays that end on droplets."""
    return 1 - math.exp(-rate * (reach - start))


def reflected(direction, normal):
    """A direction after a mirror, by the matrix of the reflection."""
    normal = np.asarray(normal, float)
    return (np.eye(3) - 2 * np.outer(normal, normal)) @ np.asarray(direction, float)
