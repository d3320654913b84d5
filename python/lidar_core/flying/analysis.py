"""Limits of what a LiDAR shows: uncertain points, voxels that rays hit, targets that rays hit."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lidar_core import _core
from lidar_core.arrays import as_points, as_pose, as_real, as_rows, as_vector
from lidar_core.errors import InputError

_LARGEST_POSE_VARIANCE = 1e4
"""A pose less certain than 100 m or 100 rad says nothing [m^2, rad^2]."""
_ROUNDING = 1e-6
"""Asymmetry and negative eigenvalues that pass as rounding, relative to the largest entry."""
_WHOLE_SPHERE = (-math.pi / 2, math.pi / 2)


def point_covariance(
    points_lidar: ArrayLike,
    world_from_lidar: ArrayLike,
    *,
    pose_covariance: ArrayLike,
    range_std: float,
) -> NDArray[np.float64]:
    """Return covariances of measured points in the world, from those of pose and range.

    Parameters
    ----------
    points_lidar : array_like, shape (N, 3) or (H, W, 3), float32
        Measured points [m], lidar frame.
    world_from_lidar : array_like, shape (4, 4), float64
        Measured pose of the LiDAR.
    pose_covariance : array_like, shape (6, 6), float64
        Covariance of the translation [m^2] and of the angles alpha, beta, gamma [rad^2] of
        R = Rz(gamma) Ry(beta) Rx(alpha), in this order (eq. 38).
    range_std : float
        Standard deviation of a range [m], 0 to 100; independent of the pose.

    Returns
    -------
    covariance : ndarray, shape (N, 3, 3), float64
        Covariance of every point, world frame [m^2]; NaN where the point is not finite. A point
        in the LiDAR itself has no range error, because it has no direction.

    Raises
    ------
    InputError
        Wrong shape or dtype, a matrix that is not a pose, or one that is not a covariance.
    ConfigError
        `range_std` out of range.
    LimitError
        More than 4 million points.

    Notes
    -----
    Linearised: the angles' errors have to be small. Source: Vrba et al., eqs 34-44. Deterministic;
    releases the GIL.

    Examples
    --------
    >>> point_covariance(
    ...     [[10, 0, 0]], np.eye(4), pose_covariance=np.diag([0, 0, 0, 0, 0, 1e-4]), range_std=0.05
    ... ).round(6)
    array([[[0.0025, 0.    , 0.    ],
            [0.    , 0.01  , 0.    ],
            [0.    , 0.    , 0.    ]]])
    """
    return _core.point_covariance(
        as_points(points_lidar, name="points_lidar"),
        as_pose(world_from_lidar),
        pose_covariance=as_pose_covariance(pose_covariance),
        range_std=range_std,
    )


def hit_probability(
    points_world: ArrayLike,
    covariance: ArrayLike,
    *,
    voxel_size: float,
    origin: Sequence[float] = (0.0, 0.0, 0.0),
    threads: int = 1,
) -> NDArray[np.float64]:
    """Return the probability that the measured surface lies in the voxel of the measured point.

    Parameters
    ----------
    points_world : array_like, shape (N, 3) or (H, W, 3), float64
        Measured points [m], in the frame that the voxels are aligned with; N = H * W.
    covariance : array_like, shape (N, 3, 3) or (3, 3), float64
        Covariance of every point, or of all of them [m^2], as `point_covariance` gives it. It may
        be singular; that of a point that is not finite is ignored.
    voxel_size : float
        Edge of a voxel [m], > 0.
    origin : array_like, shape (3,)
        Corner of voxel (0, 0, 0) [m].
    threads : int
        Threads used, 1 to 256. The result does not depend on it.

    Returns
    -------
    probability : ndarray, shape (N,), float64
        0 to 1, with an absolute error below 1e-8; NaN where the point is not finite.

    Raises
    ------
    InputError
        Wrong shape or dtype, a point beyond 2^31 voxels, or a matrix that is no covariance: not
        finite, not symmetric, or with a negative eigenvalue; the text names its row.
    ConfigError
        `voxel_size` <= 0, or `threads` out of 1 to 256.
    LimitError
        More than 4 million points.

    Notes
    -----
    Integral of a trivariate normal density over the voxel. Source: Vrba et al., eqs 45-46; nested
    as in Genz, "Numerical computation of rectangular bivariate and trivariate normal and t
    probabilities", 2004. Deterministic; releases the GIL.

    Examples
    --------
    >>> hit_probability(
    ...     [[0.5, 0.5, 0.5], [1.0, 0.5, 0.5]], 0.01 * np.eye(3), voxel_size=1.0
    ... ).round(4)
    array([1. , 0.5])
    """
    points = as_real(points_world, name="points_world")
    if points.ndim == 3:  # an organised cloud
        points = points.reshape(-1, points.shape[2])
    points = as_rows(points, name="points_world", rows=None, shape=(3,), dtype=np.float64)
    matrices = as_real(covariance, name="covariance")
    if matrices.shape not in ((3, 3), (len(points), 3, 3)):
        raise InputError(
            f"covariance: expected shape (3, 3) or ({len(points)}, 3, 3), got {matrices.shape}"
        )
    return _core.hit_probability(
        points,
        np.ascontiguousarray(matrices, dtype=np.float64).reshape(-1, 3, 3),
        voxel_size=voxel_size,
        origin=as_vector(origin, name="origin", size=3),
        threads=threads,
    )


def detection_probability(
    directions: ArrayLike,
    *,
    radius: float,
    distance: ArrayLike,
    field_of_view: tuple[float, float] | None = None,
    threads: int = 1,
) -> NDArray[np.float64]:
    """Return the probability that at least one ray hits a ball at a given distance.

    The centre lies anywhere on the sphere of that distance around the LiDAR, or on the part of it
    that `field_of_view` names, with equal probability. A ray hits the ball if the angle between the
    ray and the centre is at most asin(radius / distance).

    Parameters
    ----------
    directions : array_like, shape (N, 3), float64
        Directions of the rays, lidar frame, of any length; equal ones count once.
    radius : float
        Radius of the ball [m], > 0.
    distance : array_like, scalar or shape (D,)
        Distances of its centre [m], >= 0.
    field_of_view : tuple of two floats, optional
        Least and largest elevation [rad] of the centre above the LiDAR's x-y plane. None is the
        whole sphere, as in the paper.
    threads : int
        Threads used, 1 to 256. The result does not depend on it.

    Returns
    -------
    probability : ndarray, shape (D,), float64
        0 to 1; a LiDAR inside the ball hits it.

    Raises
    ------
    InputError
        Wrong shape or dtype, a direction without length, or an invalid distance.
    ConfigError
        `radius` <= 0, `threads` out of 1 to 256, or elevations out of order or range.
    LimitError
        More than 4 million directions.

    Notes
    -----
    The area of the union of caps around the rays, by their uncovered borders: exact, with a
    rounding error below 1e-9. 131,072 rays take about half a second per distance and thread.
    Source: Vrba et al., eqs 47-49. Deterministic; releases the GIL.

    Examples
    --------
    >>> detection_probability([[1, 0, 0]], radius=3.0, distance=[5.0]).round(6)
    array([0.1])
    """
    rows = as_rows(directions, name="directions", rows=None, shape=(3,), dtype=np.float64)
    distances = np.atleast_1d(as_real(distance, name="distance"))
    view = _WHOLE_SPHERE if field_of_view is None else field_of_view
    low, high = as_vector(view, name="field_of_view", size=2).tolist()
    return _core.detection_probability(
        rows,
        radius=radius,
        distances=as_rows(distances, name="distance", rows=None, shape=(), dtype=np.float64),
        field_of_view=(low, high),
        threads=threads,
    )


def as_pose_covariance(values: ArrayLike) -> NDArray[np.float64]:
    """Check a covariance of translation [m^2] and angles [rad^2]; return it as (6, 6) float64.

    Raises
    ------
    InputError
        Wrong shape, not finite, not symmetric, a negative eigenvalue, or absurdly large.
    """
    matrix = as_rows(values, name="pose_covariance", rows=6, shape=(6,), dtype=np.float64)
    largest = np.abs(matrix).max()
    if not np.isfinite(largest) or np.abs(matrix - matrix.T).max() > _ROUNDING * largest:
        raise InputError("pose_covariance: expected a finite symmetric matrix")
    if largest > _LARGEST_POSE_VARIANCE:
        raise InputError(
            f"pose_covariance: expected values up to {_LARGEST_POSE_VARIANCE:g} m^2 and rad^2,"
            f" got {largest:g}"
        )
    values, axes = np.linalg.eigh((matrix + matrix.T) / 2)
    if values[0] < -_ROUNDING * largest:
        raise InputError("pose_covariance: expected no negative eigenvalue")
    return np.ascontiguousarray((axes * np.maximum(values, 0)) @ axes.T)  # not even by rounding
