"""Estimate of a circle from a group of points by the rule of popular ROS packages."""

import numpy as np
from numpy.typing import NDArray


def chord_circles(
    ranges: NDArray[np.floating], bearings: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the circle (x, y, radius) [m] around the hits of each scan, shape (N, 3).

    A line is fitted to the hits and cut off at the first and the last of them. On this chord an
    equilateral triangle is built, away from the scanner; the circle is its circumscribed circle.
    For one hit the result is a point.
    """
    is_hit = np.isfinite(ranges)
    near = np.where(is_hit, ranges, 0.0).astype(np.float64)
    points = near[:, :, None] * np.stack([np.cos(bearings), np.sin(bearings)], axis=1)
    count = is_hit.sum(axis=1)
    middle = points.sum(axis=1) / count[:, None]
    apart = np.where(is_hit[:, :, None], points - middle[:, None], 0.0)
    (xx, xy), (_, yy) = np.einsum("nbi,nbj->ijn", apart, apart)
    angle = 0.5 * np.arctan2(2 * xy, xx - yy)
    along = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    last = is_hit.shape[1] - 1 - is_hit[:, ::-1].argmax(axis=1)
    ends = np.stack([is_hit.argmax(axis=1), last], axis=1)
    places = np.einsum("nei,ni->ne", apart[np.arange(len(ends))[:, None], ends], along)
    foot = middle + places.mean(axis=1)[:, None] * along
    radius = np.abs(places[:, 1] - places[:, 0]) / np.sqrt(3)
    away = np.stack([-along[:, 1], along[:, 0]], axis=1)
    away *= np.sign(np.einsum("ni,ni->n", away, foot))[:, None]
    return np.column_stack([foot + 0.5 * radius[:, None] * away, radius])
