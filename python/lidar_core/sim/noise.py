"""Noise on the poses that a detector gets; the truth has the exact ones."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from lidar_core.config import Config
from lidar_core.sim.truth import SimulatedScan


class PoseNoise(Config):
    """Error of a self-localisation: of position and of attitude, equal along every axis."""

    position_std: float = Field(
        default=0.05, ge=0, le=100, description="Standard deviation per axis [m]."
    )
    angle_std_deg: float = Field(
        default=0.5, ge=0, le=180, description="Standard deviation per axis [deg]."
    )
    time_constant: float = Field(
        default=0.0,
        ge=0,
        le=1e6,
        description="Time in which the error forgets itself: a first-order Gauss-Markov process;"
        " 0: white, one error per scan [s].",
    )

    @property
    def covariance(self) -> NDArray[np.float64]:
        """Covariance of translation [m^2] and angles about x, y, z [rad^2], shape (6, 6)."""
        return np.diag(self.std**2)

    @property
    def std(self) -> NDArray[np.float64]:
        """Standard deviations of translation [m] and angles about x, y, z [rad], shape (6,)."""
        return np.repeat([self.position_std, np.deg2rad(self.angle_std_deg)], 3)


class NoisyPoses:
    """Source of pose errors of successive scans, drawn from one error process.

    Parameters
    ----------
    noise : PoseNoise
        Size and memory of the error.
    seed : int
        Seed of the error, >= 0.
    """

    def __init__(self, noise: PoseNoise, *, seed: int) -> None:
        self.noise = noise
        self._rng = np.random.default_rng([20240607, seed])
        self._error = np.zeros(6)
        self._stamp_ns: int | None = None

    @property
    def covariance(self) -> NDArray[np.float64]:
        """Covariance of the pose error of any scan, shape (6, 6), see `PoseNoise.covariance`."""
        return self.noise.covariance

    def observed(self, made: SimulatedScan) -> SimulatedScan:
        """Return the scan as the detector gets it; scans in the order of time."""
        errors = np.array([self._error_at(stamp) for stamp in made.pose_stamps_ns.tolist()])
        wrong = made.poses.copy()
        wrong[:, :3, :3] = made.poses[:, :3, :3] @ _rotations(errors[:, 3:])
        wrong[:, :3, 3] += errors[:, :3]
        if self.noise.time_constant == 0:
            self._stamp_ns = None  # the next scan has another error, also at their common time
        return replace(made, world_from_lidar=wrong[0], poses=wrong)

    def _error_at(self, stamp_ns: int) -> NDArray[np.float64]:
        """Return the error (6,) at a time that is not before the last one."""
        keep = 0.0
        if self._stamp_ns is not None:
            memory, elapsed = self.noise.time_constant, (stamp_ns - self._stamp_ns) * 1e-9
            keep = float(np.exp(-elapsed / memory)) if memory > 0 else 1.0
        if keep < 1.0:
            fresh = self._rng.normal(size=6) * self.noise.std
            self._error = keep * self._error + np.sqrt(1 - keep**2) * fresh
        self._stamp_ns = stamp_ns
        return self._error


def _rotations(angles: NDArray[np.float64]) -> NDArray[np.float64]:
    """Matrices (K, 3, 3) of Rz Ry Rx from angles (K, 3) about x, y and z."""
    (sx, sy, sz), (cx, cy, cz) = np.sin(angles).T, np.cos(angles).T
    rows = (
        (cz * cy, cz * sy * sx - sz * cx, cz * sy * cx + sz * sx),
        (sz * cy, sz * sy * sx + cz * cx, sz * sy * cx - cz * sx),
        (-sy, cy * sx, cy * cx),
    )
    return np.moveaxis(np.array(rows), 2, 0)
