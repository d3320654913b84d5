"""Estimate of the centre of a target, of which a scan shows only the near side."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lidar_core import _core
from lidar_core.arrays import as_real, as_rows, as_vector
from lidar_core.errors import InputError


@dataclass(frozen=True, slots=True)
class TargetCenter:
    """Centre of the sphere around a target.

    Attributes
    ----------
    position : ndarray, shape (3,), float64
        Position of the centre [m], frame of the points.
    covariance : ndarray, shape (3, 3), float64
        Covariance of the position [m^2].
    radius : float
        Radius of the sphere [m].
    """

    position: NDArray[np.float64]
    covariance: NDArray[np.float64]
    radius: float


def target_center(
    points_world: ArrayLike,
    sensor_origin: ArrayLike,
    *,
    passing_directions: ArrayLike = (),
    range_std: float,
) -> TargetCenter:
    """Estimate the centre of one target from the rays that hit it and those that passed it.

    The detector does this for every detection and every cluster of a track (`FlyingConfig.position`
    and `TrackerConfig.measurement`, value "center"). The centroid of the points, eq. 19, lies
    nearer to the sensor than the centre by up to the target's radius.

    Parameters
    ----------
    points_world : array_like, shape (N, 3), N >= 1
        Points on the target [m], any one frame whose z axis points up.
    sensor_origin : array_like, shape (3,)
        Position of the sensor [m], same frame.
    passing_directions : array_like, shape (R, 3)
        Directions of rays that went past the target and ended behind it or nowhere, the same
        axes; those more than 0.4 m beside the points do not count. Without them the target is
        taken for solid.
    range_std : float
        Standard deviation of a range [m], >= 0.

    Returns
    -------
    TargetCenter

    Raises
    ------
    InputError
        Wrong shape or dtype, no point, an entry that is not finite, a direction without length.
    ConfigError
        `range_std` is negative or not finite.

    Notes
    -----
    Two models are weighed by how well they agree with the rays: a ball, fitted to the points and
    kept out of the passing rays, and an open frame, whose centre lies behind the centroid by a
    share of its width. Addresses the bias that Vrba et al. describe in sec. V-A. Deterministic;
    releases the GIL.

    Examples
    --------
    >>> up, aside = np.meshgrid(np.linspace(-0.1, 0.1, 41), np.linspace(-0.1, 0.1, 41))
    >>> rays = np.stack([np.ones_like(up), aside, up], axis=-1).reshape(-1, 3)
    >>> rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    >>> along = 6.0 * rays[:, 0]  # a ball of 0.3 m at (6, 0, 0)
    >>> inside = 0.3**2 - (6.0**2 - along**2)
    >>> hit = inside >= 0
    >>> points = rays[hit] * (along[hit] - np.sqrt(inside[hit]))[:, None]
    >>> center = target_center(
    ...     points, (0, 0, 0), passing_directions=rays[~hit], range_std=0.03
    ... )
    >>> center.position.round(2) + 0.0, round(center.radius, 2)
    (array([6., 0., 0.]), 0.3)
    """
    points = as_rows(points_world, name="points_world", rows=None, shape=(3,), dtype=np.float64)
    if len(points) == 0:
        raise InputError("points_world: expected shape (N, 3) with N >= 1, got (0, 3)")
    passing = as_real(passing_directions, name="passing_directions")
    passing = passing.reshape(-1, 3) if passing.size == 0 else passing
    found = _core.target_center(
        points,
        as_vector(sensor_origin, name="sensor_origin", size=3),
        passing=as_rows(
            passing, name="passing_directions", rows=None, shape=(3,), dtype=np.float64
        ),
        range_std=range_std,
    )
    return TargetCenter(*found)
