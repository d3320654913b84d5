"""The circle around an equilateral triangle on the chord of a group of points, slowly."""

import numpy as np


def circle(ranges, bearings):
    """Circle (3,) of the hits of one scan."""
    hit = np.isfinite(ranges)
    points = ranges[hit, None] * np.column_stack([np.cos(bearings), np.sin(bearings)])[hit]
    if len(points) == 1:
        return np.array([*points[0], 0.0])
    middle = points.mean(axis=0)
    direction = np.linalg.svd(points - middle)[2][0]  # the longest axis
    first, last = (
        middle + direction * (point - middle).dot(direction) for point in (points[0], points[-1])
    )
    length = np.linalg.norm(last - first)
    foot = (first + last) / 2
    normal = np.array([-direction[1], direction[0]])
    if normal.dot(foot) < 0:
        normal = -normal
    third = foot + np.sqrt(3) / 2 * length * normal
    center = (first + last + third) / 3
    return np.array([*center, np.linalg.norm(center - first)])
