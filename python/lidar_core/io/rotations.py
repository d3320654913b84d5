"""Rotations as quaternions (x, y, z, w) and matrices, vectorised over the first axis."""

import math

import numpy as np
from numpy.typing import NDArray

from lidar_core.errors import FormatError

UNIT_TOLERANCE = 0.01  # larger errors are no rounding, but another order or an unset field


def unit_quaternion(quaternion: NDArray[np.float64], *, place: str) -> NDArray[np.float64]:
    """Return `quaternion` scaled to length one.

    Raises
    ------
    FormatError
        The length is not one within rounding, so it is not a rotation.
    """
    # Plain sums, not BLAS: its kernels, and so the last bit, differ from CPU to CPU.
    length = math.sqrt(sum(part * part for part in quaternion.tolist()))
    if not abs(length - 1) <= UNIT_TOLERANCE:
        raise FormatError(f"{place}: quaternion {quaternion.tolist()} is not a rotation")
    return quaternion / length


def pose_matrix(
    translation: NDArray[np.float64], quaternion: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Rigid transforms (..., 4, 4) from translations (..., 3) and unit quaternions (..., 4)."""
    matrix = np.zeros((*translation.shape[:-1], 4, 4))
    matrix[..., :3, :3] = matrix_from_quaternion(quaternion)
    matrix[..., :3, 3] = translation
    matrix[..., 3, 3] = 1
    return matrix


def quaternion_from_angles(roll: float, pitch: float, yaw: float) -> NDArray[np.float64]:
    """Quaternion (x, y, z, w) of `roll`, then `pitch`, then `yaw` [rad] about fixed axes."""
    (cr, sr), (cp, sp), (cy, sy) = ((math.cos(a / 2), math.sin(a / 2)) for a in (roll, pitch, yaw))
    return np.array(
        [
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
            cr * cp * cy + sr * sp * sy,
        ]
    )


def angles_from_matrix(rotation: NDArray[np.float64]) -> tuple[float, float, float]:
    """Roll, pitch, yaw [rad], as `quaternion_from_angles` takes them."""
    pitch = math.atan2(-rotation[2, 0], math.hypot(rotation[0, 0], rotation[1, 0]))
    if abs(rotation[2, 0]) > 1 - 1e-12:  # upright: roll and yaw are one angle, given as yaw
        return 0.0, pitch, math.atan2(-rotation[0, 1], rotation[1, 1])
    roll = math.atan2(rotation[2, 1], rotation[2, 2])
    return roll, pitch, math.atan2(rotation[1, 0], rotation[0, 0])


def matrix_from_quaternion(quaternion: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rotation matrices (..., 3, 3) from unit quaternions (..., 4)."""
    single = quaternion.ndim == 1
    # Numbers of Python are the same doubles, and take a tenth of the time of arrays of one.
    x, y, z, w = quaternion.tolist() if single else (quaternion[..., part] for part in range(4))
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    if single:
        return np.array(rows)
    matrices = np.empty((*quaternion.shape[:-1], 3, 3))
    for number, row in enumerate(rows):
        for column, value in enumerate(row):
            matrices[..., number, column] = value
    return matrices


def quaternion_from_matrix(rotation: NDArray[np.float64]) -> NDArray[np.float64]:
    """Unit quaternions (..., 4) with w >= 0 from rotation matrices (..., 3, 3).

    Notes
    -----
    Source: Bar-Itzhack, "New Method for Extracting the Quaternion from a Rotation Matrix",
    Journal of Guidance, 2000: the eigenvector of the largest eigenvalue, well conditioned for
    every angle.
    """
    r = np.moveaxis(rotation, (-2, -1), (0, 1))
    k = np.array(
        [
            [r[0, 0] - r[1, 1] - r[2, 2], r[1, 0] + r[0, 1], r[2, 0] + r[0, 2], r[2, 1] - r[1, 2]],
            [r[1, 0] + r[0, 1], r[1, 1] - r[0, 0] - r[2, 2], r[2, 1] + r[1, 2], r[0, 2] - r[2, 0]],
            [r[2, 0] + r[0, 2], r[2, 1] + r[1, 2], r[2, 2] - r[0, 0] - r[1, 1], r[1, 0] - r[0, 1]],
            [r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1], r[0, 0] + r[1, 1] + r[2, 2]],
        ]
    )
    vectors = np.linalg.eigh(np.moveaxis(k, (0, 1), (-2, -1))).eigenvectors[..., -1]
    return np.where(vectors[..., 3:] < 0, -vectors, vectors)


def slerp(
    start: NDArray[np.float64], end: NDArray[np.float64], fraction: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Unit quaternions (K, 4) on the shorter arc from `start` to `end`, at `fraction` (K,)."""
    cosine = np.sum(start * end, axis=-1, keepdims=True)
    end = np.where(cosine < 0, -end, end)
    angle = np.arccos(np.clip(np.abs(cosine), 0, 1))
    part = fraction[:, None]
    small = angle < 1e-6  # the chord is the arc, to rounding
    sine = np.where(small, 1, np.sin(angle))
    weight_start = np.where(small, 1 - part, np.sin((1 - part) * angle) / sine)
    weight_end = np.where(small, part, np.sin(part * angle) / sine)
    mixed = weight_start * start + weight_end * end
    return np.asarray(mixed / np.linalg.norm(mixed, axis=-1, keepdims=True))
