"""The scan in which a run first measured each voxel of its final map.

A run stores its map only once, at the end. The view shows a voxel from the first scan on that has
a point in it. So the displayed map grows with the run as the map did.
"""

from collections.abc import Iterable
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

UNSEEN: Final = np.iinfo(np.uint16).max
COARSE = 4
"""Voxels per side of the cells that stand in for voxels whose own scans were thinned away."""
_SPAN = 1 << 20
"""Cells per axis that have a key of their own, around the first voxel: 200 km of 0.2 m."""


def first_seen(
    centers: NDArray[np.float64], voxel_size: float, clouds: Iterable[NDArray[Any]]
) -> NDArray[np.uint16]:
    """Return the index of the first cloud with a point in each voxel.

    A voxel that no cloud hits gets the index of its coarse cell, which is `COARSE` voxels wide. If
    no cloud hits this cell either, as in a map that the run began with, the index is 0.

    Parameters
    ----------
    centers : ndarray, shape (V, 3), float64
        Centres of the voxels [m].
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
    """Grid cells that contain the voxels, and the first cloud with a point in each cell."""

    def __init__(
        self, centers: NDArray[np.float64], corner: NDArray[np.float64], size: float
    ) -> None:
        self._corner, self._size = corner, size
        self._keys, self._cell_of = np.unique(self._keys_of(centers), return_inverse=True)
        self._first = np.full(len(self._keys), UNSEEN, np.uint16)

    @property
    def first(self) -> NDArray[np.uint16]:
        """Index of the first cloud with a point in the cell of each voxel; UNSEEN for none."""
        return self._first[self._cell_of]

    def mark(self, points: NDArray[Any], index: int) -> None:
        """Mark the cells that contain `points` [m] as hit by cloud `index`."""
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
