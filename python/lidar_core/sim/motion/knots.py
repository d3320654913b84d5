"""Knots of a motion: poses at given times."""

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Knots: TypeAlias = tuple[NDArray[np.float64], NDArray[np.float64]]
"""Seconds after the start (K,), and poses (K, 4, 4) there; straight lines between them."""

STEP = 0.01
"""Time between the knots of a curve [s]: at 10 m/s2, lines deviate from it by 0.13 mm at most."""


def poses(positions: NDArray[np.float64], quaternions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Matrices (K, 4, 4) from positions (K, 3) and unit quaternions (K, 4) in order x, y, z, w."""
    x, y, z, w = quaternions.T
    matrices = np.zeros((len(positions), 4, 4))
    matrices[:, :3, 3] = positions
    matrices[:, 3, 3] = 1
    matrices[:, 0, :3] = np.stack(
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)], axis=-1
    )
    matrices[:, 1, :3] = np.stack(
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)], axis=-1
    )
    matrices[:, 2, :3] = np.stack(
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)], axis=-1
    )
    return matrices


def times_of(seconds: float) -> NDArray[np.float64]:
    """Times of the knots of a curve that lasts `seconds`."""
    return np.arange(int(np.ceil(seconds / STEP)) + 1, dtype=np.float64) * STEP


def upright(yaw: NDArray[np.float64]) -> NDArray[np.float64]:
    """Quaternions (K, 4) of Rz(yaw) from yaw angles [rad]."""
    return np.stack([0 * yaw, 0 * yaw, np.sin(yaw / 2), np.cos(yaw / 2)], axis=-1)


def from_angles(sine: NDArray[np.float64], cosine: NDArray[np.float64]) -> NDArray[np.float64]:
    """Quaternions of Rz(yaw) Ry(pitch) Rx(roll), from sines and cosines of the half angles."""
    (sr, sp, sy), (cr, cp, cy) = sine, cosine
    return np.stack(
        [
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
            cr * cp * cy + sr * sp * sy,
        ],
        axis=-1,
    )
