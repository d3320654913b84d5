"""Scores of maps without moving objects, compared with a labelled cloud."""

from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lidar_core.arrays import as_finite_rows, as_mask
from lidar_core.errors import FormatError, InputError
from lidar_core.io import ReadOptions, open_recording, read_cloud
from lidar_core.messages import Scan
from lidar_core.run_folder import RUN_FILE

TRUTH_FILE = "gt_cloud.pcd"
"""The labelled cloud in a folder of the benchmark."""
LARGEST = 2**32
"""Largest file of a map [bytes]."""
SAME = 0.05
"""A point this near to one of the map is in the map [m]: `min_dis` of the benchmark."""
FARTHEST = 2.0**20
"""Cells along an axis, from the middle: three of them fit into an integer of 64 bits."""


@dataclass(frozen=True, slots=True)
class StaticScores:
    """Share of the static scene in a map, and share of the moving objects that are not in it.

    Attributes
    ----------
    n_static, n_dynamic : int
        Points of the truth.
    n_kept, n_removed : int
        Static points that are in the map, and dynamic ones that are not.
    """

    n_static: int
    n_dynamic: int
    n_kept: int
    n_removed: int

    @property
    def static_accuracy(self) -> float | None:
        """SA: share of the static points that are in the map [%]; None without any."""
        return 100 * self.n_kept / self.n_static if self.n_static else None

    @property
    def dynamic_accuracy(self) -> float | None:
        """DA: share of the dynamic points that are not in the map [%]; None without any."""
        return 100 * self.n_removed / self.n_dynamic if self.n_dynamic else None

    @property
    def associated_accuracy(self) -> float | None:
        """AA: geometric mean of both [%]."""
        both = self.static_accuracy, self.dynamic_accuracy
        return None if both[0] is None or both[1] is None else float(np.sqrt(both[0] * both[1]))

    def to_dict(self) -> dict[str, float | int | None]:
        """Return all numbers by name."""
        return {
            "static_accuracy": self.static_accuracy,
            "dynamic_accuracy": self.dynamic_accuracy,
            "associated_accuracy": self.associated_accuracy,
            "n_static": self.n_static,
            "n_dynamic": self.n_dynamic,
            "n_kept": self.n_kept,
            "n_removed": self.n_removed,
        }


def score_static_map(
    points: ArrayLike,
    truth_points: ArrayLike,
    is_dynamic: ArrayLike,
    *,
    resolution: float | None = None,
) -> StaticScores:
    """Score a cleaned map against a labelled cloud, point by point of the cloud.

    Parameters
    ----------
    points : array_like, shape (N, 3)
        Points of the map [m]; with `resolution` the centres of its voxels.
    truth_points : array_like, shape (M, 3)
        Points of the labelled cloud [m], in the same frame.
    is_dynamic : array_like, shape (M,)
        True for points of moving objects.
    resolution : float, optional
        Edge of the voxels of the map [m]. A point of the cloud is in the map if it is within
        0.05 m of one of its points, or of one of its voxels.

    Returns
    -------
    StaticScores

    Raises
    ------
    InputError
        Wrong shapes, coordinates that are not finite, or coordinates that are too large.

    Notes
    -----
    Definitions of Zhang et al., "A Dynamic Points Removal Benchmark in Point Cloud Maps",
    ITSC 2023, and of its program.

    Examples
    --------
    >>> wall, passer = [[0, 0, 0], [1, 0, 0]], [[0.5, 1, 0]]
    >>> scores = score_static_map([[0, 0, 0.01]], wall + passer, [False, False, True])
    >>> scores.static_accuracy, scores.dynamic_accuracy
    (50.0, 100.0)
    """
    known = as_finite_rows(points, name="points", rows=None, shape=(3,))
    truth = as_finite_rows(truth_points, name="truth_points", rows=None, shape=(3,))
    moved = as_mask(is_dynamic, name="is_dynamic", rows=len(truth))
    if resolution is not None and not 0 < resolution < np.inf:
        raise InputError(f"resolution: expected a finite number > 0, got {resolution}")
    kept = (
        _is_near(truth, known, SAME) if resolution is None else _in_voxels(truth, known, resolution)
    )
    return StaticScores(
        n_static=int((~moved).sum()),
        n_dynamic=int(moved.sum()),
        n_kept=int((kept & ~moved).sum()),
        n_removed=int((~kept & moved).sum()),
    )


def read_labelled_cloud(path: str | Path) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Read points [m], shape (M, 3), and whether each is dynamic, shape (M,).

    Parameters
    ----------
    path : str or Path
        PCD file with intensity 1 for points of moving objects and 0 for all others, or a folder of
        the benchmark that contains it as gt_cloud.pcd.

    Raises
    ------
    FormatError
        The file has no intensity, or one that is neither 0 nor 1.
    """
    place = Path(path)
    place = place / TRUTH_FILE if place.is_dir() else place
    with open_recording(place, no_return="none") as recording:
        scan = next(message for message in recording if isinstance(message, Scan))
    if scan.intensity is None:
        raise FormatError(f"{place}: expected the field intensity: 0 static, 1 dynamic")
    points, label = scan.points.reshape(-1, 3), scan.intensity.reshape(-1)
    is_point = np.isfinite(points).all(axis=1)
    if not np.isin(label[is_point], (0, 1)).all():
        raise FormatError(f"{place}: intensity: expected 0 static or 1 dynamic, got other numbers")
    return points[is_point].astype(np.float64), label[is_point] == 1


def read_static_map(path: str | Path) -> tuple[NDArray[np.float64], float | None]:
    """Read the points of a map, shape (N, 3) [m], and the edge of its voxels, if it has them.

    Parameters
    ----------
    path : str or Path
        File that `lidar_core.io.read_cloud` reads, or a run folder of `detect` with its map.lcvm.
    """
    place = Path(path)
    if (place / RUN_FILE).is_file():
        place = place / "map.lcvm"
    # A map of a whole street is larger than a message of a recording may be.
    cloud = read_cloud(place, options=ReadOptions(max_record_bytes=LARGEST))
    return cloud.points, cloud.resolution


def _keys(cells: NDArray[np.int64]) -> NDArray[np.int64]:
    """One number per cell, (N,), of cells (N, 3) within `FARTHEST`."""
    shifted = cells + int(FARTHEST)
    return np.asarray((shifted[:, 0] << 42) | (shifted[:, 1] << 21) | shifted[:, 2], np.int64)


def _cells(
    points: NDArray[np.float64], origin: NDArray[np.float64], edge: float
) -> NDArray[np.int64]:
    cells = np.floor((points - origin) / edge)
    if np.abs(cells).max(initial=0.0) >= FARTHEST - 1:
        raise InputError(f"points: expected all within {FARTHEST * edge:.0f} m of one another")
    return cells.astype(np.int64)


def _is_near(
    truth: NDArray[np.float64], known: NDArray[np.float64], distance: float
) -> NDArray[np.bool_]:
    """Return for each point of the truth whether a known point is within `distance` [m]."""
    found = np.zeros(len(truth), np.bool_)
    if not len(truth) or not len(known):
        return found
    origin = truth[0]
    keys = _keys(_cells(known, origin, distance))
    order = np.argsort(keys, kind="stable")
    keys, known = keys[order], known[order]
    cells = _cells(truth, origin, distance)
    for offset in product((-1, 0, 1), repeat=3):
        rows = np.flatnonzero(~found)
        wanted = _keys(cells[rows] + np.array(offset))
        at, end = np.searchsorted(keys, wanted), np.searchsorted(keys, wanted, side="right")
        while len(rows):
            has_more = at < end
            rows, at, end = rows[has_more], at[has_more], end[has_more]
            is_near = np.linalg.norm(truth[rows] - known[at], axis=1) <= distance
            found[rows[is_near]] = True
            rows, at, end = rows[~is_near], at[~is_near] + 1, end[~is_near]
    return found


def _in_voxels(
    truth: NDArray[np.float64], centers: NDArray[np.float64], edge: float
) -> NDArray[np.bool_]:
    """Return for each point whether it is in a voxel around a centre, or within `SAME` of one."""
    found = np.zeros(len(truth), np.bool_)
    if not len(truth) or not len(centers):
        return found
    corner = centers[0] - edge / 2
    keys = np.unique(_keys(_cells(centers, corner, edge)))
    for offset in product((-SAME, 0.0, SAME), repeat=3):
        wanted = _keys(_cells(truth + np.array(offset), corner, edge))
        at = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
        found |= keys[at] == wanted
    return found
