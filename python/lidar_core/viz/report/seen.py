"""When a run first measured the places that its map holds at the end.

A run keeps its map once, as it is at the end. A place of it is shown from the first scan on that
has a point there, so that the view grows with the run as the map did.
"""

from collections.abc import Iterable
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

UNSEEN: Final = np.iinfo(np.uint16).max
COARSE = 4
"""Voxels per side of the cells that stand in for voxels whose own scans were thinned away."""
_SPAN = 1 << 20
"""Cells per axis that have a number of their own, around the first voxel: 200 km of 0.2 m."""


def first_seen(
    centers: NDArray[np.float64], voxel_size: float, clouds: Iterable[NDArray[Any]]
) -> NDArray[np.uint16]:
    """Index of the first cloud with a point in each voxel.

    Voxels that no cloud hits take that of their surroundings, `COARSE` voxels wide; 0 where
    there is none either, as for a map that the run began with.

    Parameters
    ----------
    centers : ndarray, shape (V, 3), float64
        Of the voxels [m].
    voxel_size : float
        Side of a voxel [m], > 0.
    clouds : iterable of ndarray, shape (N, 3)
        Points of the scans in order of time, in the frame of the centres [m].

    Returns
    -------
    first : ndarray, shape (V,), uint16
    """
    if not len(centers):
        return np.empty(0, np.uint16)
    corner = centers[0] - voxel_size / 2
    fine = _Cells(centers, corner, voxel_size)
    coarse = _Cells(centers, corner, COARSE * voxel_size)
    for index, points in enumerate(clouds):
        for cells in (fine, coarse):
            cells.mark(points, index)
    first = np.where(fine.first == UNSEEN, coarse.first, fine.first)
    return np.where(first == UNSEEN, 0, first).astype(np.uint16)


class _Cells:
    """Cells of a lattice that hold the voxels, and the first cloud with a point in each."""

    def __init__(
        self, centers: NDArray[np.float64], corner: NDArray[np.float64], size: float
    ) -> None:
        self._corner, self._size = corner, size
        self._keys, self._cell_of = np.unique(self._keys_of(centers), return_inverse=True)
        self._first = np.full(len(self._keys), UNSEEN, np.uint16)

    @property
    def first(self) -> NDArray[np.uint16]:
        """Index of the first cloud in the cell of each voxel, or UNSEEN."""
        return self._first[self._cell_of]

    def mark(self, points: NDArray[Any], index: int) -> None:
        """Note that a cloud has points there."""
        points = points[np.isfinite(points).all(axis=1)]
        keys = self._keys_of(points.astype(np.float64))
        places = np.minimum(np.searchsorted(self._keys, keys), len(self._keys) - 1)
        hit = places[self._keys[places] == keys]
        self._first[hit] = np.minimum(self._first[hit], index)

    def _keys_of(self, points: NDArray[np.float64]) -> NDArray[np.int64]:
        cells = np.floor((points - self._corner) / self._size)
        inside = np.clip(cells, -_SPAN // 2, _SPAN // 2 - 1).astype(np.int64) + _SPAN // 2
        x, y, z = inside.T
        return np.asarray((x * _SPAN + y) * _SPAN + z)
