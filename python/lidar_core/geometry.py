"""Ray walk and clustering."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lidar_core import _core
from lidar_core.arrays import as_points, as_vector

__all__ = ["cluster_points", "traverse"]


def traverse(
    start: ArrayLike,
    end: ArrayLike,
    *,
    voxel_size: float,
    origin: Sequence[float] = (0.0, 0.0, 0.0),
) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
    """Voxels crossed by the segment from `start` to `end`, in order, with the length in each.

    Consecutive voxels share a face. At an edge or corner the lowest axis goes first.

    Parameters
    ----------
    start, end : array_like, shape (3,), float64
        Ends of the segment [m].
    voxel_size : float
        Edge of a voxel [m], > 0.
    origin : array_like, shape (3,)
        Corner of voxel (0, 0, 0) [m].

    Returns
    -------
    voxels : ndarray, shape (K, 3), int32
        Indices; a point on a face belongs to the voxel above it.
    lengths : ndarray, shape (K,), float64
        Length of the segment inside each voxel [m]; their sum is the segment's length.

    Raises
    ------
    InputError
        An end is not finite, of the wrong shape, or beyond 2^31 voxels.
    ConfigError
        `voxel_size` <= 0.
    LimitError
        The segment crosses more than 100,000 voxels.

    Notes
    -----
    Source: Amanatides & Woo, "A Fast Voxel Traversal Algorithm for Ray Tracing", Eurographics
    1987. Computed in float64; releases the GIL.

    Examples
    --------
    >>> traverse([0.5, 0.5, 0.5], [2.5, 0.5, 0.5], voxel_size=1.0)
    (array([[0, 0, 0],
           [1, 0, 0],
           [2, 0, 0]], dtype=int32), array([0.5, 1. , 0.5]))
    """
    return _core.traverse(
        as_vector(start, name="start", size=3),
        as_vector(end, name="end", size=3),
        voxel_size=voxel_size,
        origin=as_vector(origin, name="origin", size=3),
    )


def cluster_points(
    points: ArrayLike,
    *,
    max_distance: float,
    min_points: int,
    max_points: int | None = None,
    max_angle: float = 0.0,
    origin: Sequence[float] = (0.0, 0.0, 0.0),
) -> NDArray[np.int32]:
    """Group points that are linked by steps of at most `max_distance`, or more where they are far.

    Parameters
    ----------
    points : array_like, shape (N, 3), float32
        Coordinates [m], any one frame. C-contiguous float32 is read in place; anything else is
        copied once. Must not be written to during the call.
    max_distance : float
        Largest gap inside a cluster [m], > 0. Exactly this distance still links.
    min_points : int
        Smaller clusters are labelled as noise, >= 1.
    max_points : int, optional
        Larger clusters are labelled as noise.
    max_angle : float
        A step of at most this angle times the range of the nearer point links too [rad], 0 to
        0.5: far away, the gaps between the rays of a LiDAR are wide.
    origin : array_like, shape (3,)
        The sensor, from which ranges are taken [m].

    Returns
    -------
    labels : ndarray, shape (N,), int32
        Clusters numbered by first appearance; -1 is noise or a point that is not finite.

    Raises
    ------
    InputError
        Wrong shape or dtype, or a cloud more than 2^31 steps wide.
    ConfigError
        `max_distance` <= 0, `min_points` < 1 or `max_angle` not in 0 to 0.5.
    LimitError
        More than 4 million points.

    Notes
    -----
    Source: Vrba et al., eqs 13-15. Deterministic; releases the GIL.

    Examples
    --------
    >>> cluster_points([[0, 0, 0], [0.1, 0, 0], [5, 0, 0]], max_distance=0.5, min_points=1)
    array([0, 0, 1], dtype=int32)
    """
    return _core.cluster_points(
        as_points(points),
        max_distance=max_distance,
        min_points=min_points,
        max_points=max_points,
        max_angle=max_angle,
        origin=as_vector(origin, name="origin", size=3),
    )


def __dir__() -> list[str]:
    return __all__
