"""Which points are drawn if there are more than a picture holds: background is left out first."""

import numpy as np
from numpy.typing import NDArray

from lidar_core.messages import ShownClass

MARKED = (ShownClass.FLYING, ShownClass.MOVING, ShownClass.OWN_BODY)
"""Classes whose points are left out only if they alone are too many."""
CELL = 0.125
"""Least edge of the cells of which each keeps a point [m]."""
MOST_CELLS = 2**20
"""Cells along an axis: three such numbers fit 64 bits."""


def evenly(count: int, most: int) -> NDArray[np.int64]:
    """Indices of at most `most` of `count` rows, evenly spaced, with the first and the last."""
    return np.linspace(0, count - 1, max(0, min(count, most))).round().astype(np.int64)


def spread(points: NDArray[np.floating], most: int) -> NDArray[np.int64]:
    """Rows of at most `most` points, ascending, evenly in space.

    Each cell of a lattice keeps a point. So a person with few points stays visible beside a truck
    with many. The cells are as small as `most` allows; further points are taken evenly.

    Parameters
    ----------
    points : ndarray, shape (N, 3)
        Finite coordinates [m].
    most : int
        Largest number of rows; all rows if there are not more.
    """
    if len(points) <= most or most < 1:
        return evenly(len(points), most)
    low, high = points.min(axis=0), points.max(axis=0)
    size = max(CELL, float((high - low).max()) / (MOST_CELLS - 1))
    cells = np.floor((points - low) / size).astype(np.int64)
    kept = _one_per_cell(cells)
    while len(kept) > most:
        cells >>= 1
        kept = kept[_one_per_cell(cells[kept])]
    is_left = np.ones(len(points), np.bool_)
    is_left[kept] = False
    others = np.flatnonzero(is_left)
    return np.sort(np.concatenate([kept, others[evenly(len(others), most - len(kept))]]))


def thinned(
    points: NDArray[np.floating], point_class: NDArray[np.uint8], most: int
) -> NDArray[np.int64]:
    """Rows of at most `most` points, ascending: first those of the classes `MARKED`.

    Background, unknown points and points without a class get the room that is left, evenly.

    Parameters
    ----------
    points : ndarray, shape (N, 3)
        Finite coordinates [m].
    point_class : ndarray, shape (N,), uint8
        A `ShownClass` each.
    most : int
        Largest number of rows.
    """
    is_marked = np.isin(point_class, MARKED)
    marked, plain = np.flatnonzero(is_marked), np.flatnonzero(~is_marked)
    marked = marked[spread(points[marked], most)]
    plain = plain[evenly(len(plain), most - len(marked))]
    return np.sort(np.concatenate([marked, plain]))


def _one_per_cell(cells: NDArray[np.int64]) -> NDArray[np.int64]:
    """Row of the first point in each cell (N, 3), ascending."""
    names = (cells[:, 0] * MOST_CELLS + cells[:, 1]) * MOST_CELLS + cells[:, 2]
    return np.sort(np.unique(names, return_index=True)[1])
