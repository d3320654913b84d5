"""Radar measurements from a track of a radar that reports positions and velocities."""

import numpy as np
from numpy.typing import NDArray

from lidar_core.fusion.measurement import Measurement


def radar_of_track(
    stamp_ns: int,
    position: NDArray[np.float64],
    velocity: NDArray[np.float64],
    position_covariance: NDArray[np.float64],
    velocity_covariance: NDArray[np.float64],
) -> Measurement | None:
    """Range, bearing and range rate of a position and a velocity relative to the radar.

    Parameters
    ----------
    stamp_ns : int
        Time of the track [ns].
    position, velocity : ndarray, shape (2,)
        Position [m] and velocity [m/s] in the frame of the radar.
    position_covariance, velocity_covariance : ndarray, shape (2, 2)
        Covariances [m^2], [m^2/s^2]; with an unusable one, such as zeros, the measurement has no
        covariance.

    Returns
    -------
    measurement : Measurement or None
        None at the radar itself, because there is no bearing.

    Examples
    --------
    >>> radar_of_track(0, np.array([3.0, 4.0]), np.array([1.0, 0.0]), np.eye(2), np.eye(2))
    Measurement(0, 'radar', [5.0, 0.9272952180016122, 0.6])
    """
    p, v = position, velocity
    far = float(np.hypot(*p))
    if not far > 0:
        return None
    rate = float(p @ v) / far
    by_place = np.stack([p / far, np.array([-p[1], p[0]]) / far**2, v / far - rate * p / far**2])
    by_speed = np.stack([np.zeros(2), np.zeros(2), p / far])
    spread = by_place @ position_covariance @ by_place.T
    spread += by_speed @ velocity_covariance @ by_speed.T
    values = [far, float(np.arctan2(p[1], p[0])), rate]
    return Measurement(stamp_ns, "radar", values, definite(spread))


def definite(covariance: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """Return a usable covariance; None for zeros, which mean unknown, and for invalid ones.

    Examples
    --------
    >>> definite(np.zeros((2, 2))) is None
    True
    """
    covariance = (covariance + covariance.T) / 2
    scale = np.sqrt(np.abs(np.diag(covariance)))
    if not (np.isfinite(covariance).all() and (scale > 0).all()):
        return None
    least = np.linalg.eigvalsh(covariance / np.outer(scale, scale))[0]
    return covariance if least > 1e-9 else None
