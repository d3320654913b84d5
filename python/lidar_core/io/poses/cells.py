"""Keys of the cubes that contain points, for fast comparison."""

from itertools import product

import numpy as np
from numpy.typing import NDArray

_OFFSETS = np.array(list(product((-1, 0, 1), repeat=3)), np.int64)
_BITS = 21
_HALF = 1 << (_BITS - 1)


def cell_keys(points: NDArray[np.float64], edge: float) -> NDArray[np.int64]:
    """Key of the cube of side `edge` [m] around each point; distant cubes may share a key."""
    return _pack(np.floor(points / edge).astype(np.int64))


def surrounding_keys(points: NDArray[np.float64], edge: float) -> NDArray[np.int64]:
    """Sorted keys of the cubes that contain points, and of the neighbouring cubes."""
    cells = np.unique(np.floor(points / edge).astype(np.int64), axis=0)
    return np.unique(_pack((cells[:, None] + _OFFSETS).reshape(-1, 3)))


def _pack(cells: NDArray[np.int64]) -> NDArray[np.int64]:
    x, y, z = (np.moveaxis(cells, -1, 0) + _HALF) & (2 * _HALF - 1)
    return np.asarray(x << (2 * _BITS) | y << _BITS | z)
