"""Posterior Cramer-Rao bound along a true path: no filter is better on average."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

START = (0.5, 0.5, 25.0, 25.0)
"""Variances of the first position [m^2] and velocity [m^2/s^2]."""
SETTLED = 20
"""Rows at the start that count for nothing."""


def position_bound(
    position: NDArray[np.float64],
    velocity: NDArray[np.float64],
    seconds: NDArray[np.float64],
    noise: Sequence[NDArray[np.float64]],
    *,
    acceleration_noise: float,
) -> NDArray[np.float64]:
    """Return the least root mean square errors of x and y [m] that a filter can reach.

    The target moves with constant velocity, disturbed by white acceleration.

    Parameters
    ----------
    position, velocity : ndarray, shape (K, 2)
        The truth, frame of the sensor [m], [m/s].
    seconds : ndarray, shape (K,)
        Increasing times [s].
    noise : sequence of ndarray
        A covariance per row: (2, 2) of x and y, or (3, 3) of range, bearing and range rate.
    acceleration_noise : float
        Standard deviation of the acceleration, constant over a step [m/s^2].

    Notes
    -----
    Source: Tichavsky, Muravchik & Nehorai, "Posterior Cramer-Rao bounds for discrete-time
    nonlinear filtering", 1998.
    """
    covariance, found = np.diag(START), list[NDArray[np.float64]]()
    steps = np.diff(seconds, prepend=seconds[0])
    for place, motion, step, row in zip(position, velocity, steps, noise, strict=True):
        if found:
            covariance = _predicted(covariance, float(step), acceleration_noise)
        H = np.eye(2, 4) if len(row) == 2 else _radar(place, motion)
        K = np.linalg.solve(H @ covariance @ H.T + row, H @ covariance).T
        covariance = covariance - K @ H @ covariance
        covariance = (covariance + covariance.T) / 2
        found.append(np.diag(covariance)[:2])
    return np.asarray(np.sqrt(np.mean(found[SETTLED:], axis=0)))


def _predicted(P: NDArray[np.float64], dt: float, std: float) -> NDArray[np.float64]:
    F = np.eye(4) + dt * np.eye(4, k=2)
    G = np.vstack([dt * dt / 2 * np.eye(2), dt * np.eye(2)]) * std
    return np.asarray(F @ P @ F.T + G @ G.T)


def _radar(place: NDArray[np.float64], motion: NDArray[np.float64]) -> NDArray[np.float64]:
    """Jacobian of range, bearing and range rate by position and velocity."""
    (x, y), (vx, vy) = place.tolist(), motion.tolist()
    rho = float(np.hypot(x, y))
    across = (x * vy - y * vx) / rho**3
    return np.array(
        [
            [x / rho, y / rho, 0, 0],
            [-y / rho**2, x / rho**2, 0, 0],
            [-y * across, x * across, x / rho, y / rho],
        ]
    )
