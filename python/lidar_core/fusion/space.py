"""Positions in space from a track in the plane, by the elevation of sensors that swivel."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lidar_core.arrays import as_finite_rows
from lidar_core.errors import InputError


@dataclass(frozen=True, slots=True)
class LevelSight:
    """Measurements of sensors that swivel, in the level frame at the sensors.

    Attributes
    ----------
    values : ndarray, shape (K, 3)
        Horizontal range [m], bearing [rad], horizontal range rate [m/s].
    covariances : ndarray, shape (K, 3, 3)
        Covariances of the measurements.
    elevation, elevation_variance : ndarray, shape (K,)
        Elevation of the target above the horizon [rad], and its variance [rad^2].
    """

    values: NDArray[np.float64]
    covariances: NDArray[np.float64]
    elevation: NDArray[np.float64]
    elevation_variance: NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class SpaceTrack:
    """A target in three dimensions, with covariances.

    Attributes
    ----------
    position, covariance : ndarray, shapes (K, 3) and (K, 3, 3)
        x, y, z, world [m].
    cylindrical, cylindrical_covariance : ndarray, shapes (K, 3) and (K, 3, 3)
        About the sensor: horizontal distance [m], direction in the world [rad], height [m].
    """

    position: NDArray[np.float64]
    covariance: NDArray[np.float64]
    cylindrical: NDArray[np.float64]
    cylindrical_covariance: NDArray[np.float64]


def level_sight(
    values: ArrayLike,
    swivel: ArrayLike,
    pitch: ArrayLike,
    *,
    std: ArrayLike,
    swivel_std: float,
    pitch_std: float,
) -> LevelSight:
    """Convert measurements in a swivelled plane to the horizontal plane.

    Parameters
    ----------
    values : array_like, shape (K, 3)
        Range [m], bearing in the body's axes [rad], range rate [m/s].
    swivel : array_like, shape (K,)
        Elevation of the sight above the plane of the body [rad].
    pitch : array_like, shape (K,)
        Pitch of the body, positive with the nose down [rad].
    std : array_like, shape (K, 3)
        Standard deviations of `values`.
    swivel_std, pitch_std : float
        Standard deviations of both angles [rad].

    Returns
    -------
    LevelSight

    Raises
    ------
    InputError
        Wrong shapes, values that are not finite.

    Notes
    -----
    Range rates hold for a target and a sensor that keep their heights. Source: Remote Sens. 2023,
    15, 3396, Figs 3 and 4, for the geometry.
    """
    polar = as_finite_rows(values, name="values", rows=None, shape=(3,))
    rows = len(polar)
    deviations = as_finite_rows(std, name="std", rows=rows, shape=(3,))
    up = as_finite_rows(swivel, name="swivel", rows=rows, shape=())
    down = as_finite_rows(pitch, name="pitch", rows=rows, shape=())
    far, _, rate = polar.T
    azimuth, elevation, by_angle = _directions(polar[:, 1], up, down)
    c, slope = np.cos(elevation), np.tan(elevation)
    by_elevation = np.stack([-far * np.sin(elevation), 0 * far, rate / c * slope], axis=1)
    J = by_elevation[:, :, None] * by_angle[:, 1:2]  # by bearing, swivel, pitch
    J[:, 1] = by_angle[:, 0]
    angles = np.stack([deviations[:, 1], 0 * far + swivel_std, 0 * far + pitch_std], axis=1)
    J *= angles[:, None]
    own = np.stack([c * deviations[:, 0], 0 * far, deviations[:, 2] / c], axis=1)
    return LevelSight(
        np.stack([far * c, azimuth, rate / c], axis=1),
        J @ np.swapaxes(J, 1, 2) + own[:, :, None] ** 2 * np.eye(3),
        elevation,
        np.square(by_angle[:, 1] * angles).sum(axis=1),
    )


def _directions(
    bearing: NDArray[np.float64], up: NDArray[np.float64], down: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Level azimuth and elevation [rad], and their Jacobian by all three angles, (K, 2, 3)."""
    (ca, sa), (cu, su) = (np.cos(bearing), np.sin(bearing)), (np.cos(up), np.sin(up))
    cd, sd = np.cos(down), np.sin(down)
    x, y, z = cd * cu * ca + sd * su, cu * sa, cd * su - sd * cu * ca
    dx = np.stack([-cd * cu * sa, -cd * su * ca + sd * cu, z], axis=1)
    dy = np.stack([cu * ca, -su * sa, 0 * y], axis=1)
    dz = np.stack([sd * cu * sa, cd * cu + sd * su * ca, -x], axis=1)
    flat = np.hypot(x, y)[:, None]
    turned = (x[:, None] * dy - y[:, None] * dx) / flat**2
    return np.arctan2(y, x), np.arctan2(z, flat[:, 0]), np.stack([turned, dz / flat], axis=1)


def in_space(
    position: ArrayLike,
    covariance: ArrayLike,
    elevation: ArrayLike,
    elevation_variance: ArrayLike,
    sensor: ArrayLike,
    *,
    drift: ArrayLike | None = None,
) -> SpaceTrack:
    """Add the height to a track in the plane.

    Parameters
    ----------
    position, covariance : array_like, shapes (K, 2) and (K, 2, 2)
        Position [m] and covariance [m^2] of the track, world frame.
    elevation, elevation_variance : array_like, shape (K,)
        Elevation of the target above the horizon of the sensor [rad], and its variance [rad^2].
    sensor : array_like, shape (K, 3)
        Position of the sensor [m], world frame.
    drift : array_like, shape (K,), optional
        Variance of the change of the target's height since the row before [m^2]: heights are then
        filtered. Without it every row is independent.

    Returns
    -------
    SpaceTrack

    Raises
    ------
    InputError
        Wrong shapes, values that are not finite, a target straight above or below.

    Notes
    -----
    The error of the elevation is taken to be independent of that of the track.
    """
    place = as_finite_rows(position, name="position", rows=None, shape=(2,))
    rows = len(place)
    P = as_finite_rows(covariance, name="covariance", rows=rows, shape=(2, 2))
    angle = as_finite_rows(elevation, name="elevation", rows=rows, shape=())
    variance = as_finite_rows(elevation_variance, name="elevation_variance", rows=rows, shape=())
    origin = as_finite_rows(sensor, name="sensor", rows=rows, shape=(3,))
    flat = place - origin[:, :2]
    rho = np.hypot(flat[:, 0], flat[:, 1])
    if not (rho > 0).all() or not (np.abs(angle) < np.pi / 2).all():
        raise InputError("elevation: expected no target exactly above or below the sensor, got one")
    along, slope = flat / rho[:, None], np.tan(angle)
    J = np.concatenate([np.tile(np.eye(2), (rows, 1, 1)), (slope[:, None] * along)[:, None]], 1)
    cov = J @ P @ np.swapaxes(J, 1, 2)
    cov[:, 2, 2] += (rho * (1 + slope**2)) ** 2 * variance
    height = origin[:, 2] + rho * slope
    if drift is not None:
        steps = as_finite_rows(drift, name="drift", rows=rows, shape=())
        height, cov = _filtered(height, cov, steps)
    about = np.zeros((rows, 3, 3))
    about[:, 0, :2], about[:, 2, 2] = along, 1.0
    about[:, 1, 0], about[:, 1, 1] = -along[:, 1] / rho, along[:, 0] / rho
    direction = np.arctan2(flat[:, 1], flat[:, 0])
    return SpaceTrack(
        np.column_stack([place, height]),
        cov,
        np.column_stack([rho, direction, height - origin[:, 2]]),
        about @ cov @ np.swapaxes(about, 1, 2),
    )


def _filtered(
    height: NDArray[np.float64], covariance: NDArray[np.float64], drift: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Filter the heights with a filter of one state; return heights and covariances.

    The covariances then have the filtered variance of the height, without correlation to x and y.
    """
    found, cov = height.copy(), covariance.copy()
    variance = covariance[:, 2, 2].copy()
    for row in range(1, len(height)):
        prior = variance[row - 1] + drift[row]
        gain = prior / (prior + covariance[row, 2, 2])
        found[row] = found[row - 1] + gain * (height[row] - found[row - 1])
        variance[row] = (1 - gain) * prior
    cov[:, 2, :2] = cov[:, :2, 2] = 0.0
    cov[:, 2, 2] = variance
    return found, cov
