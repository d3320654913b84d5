"""Simulated scans, and the truth about them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lidar_core.messages import LaserScan, PosedScan, Scan, ShortRepr
from lidar_core.objects import ObjectTruth, TargetTruth


@dataclass(frozen=True, slots=True, repr=False)
class SimulatedScan(ShortRepr):
    """A scan, where it was made, and the truth about it.

    Attributes
    ----------
    scan : Scan
        Points in the LiDAR's frame at the time of each ray.
    world_from_lidar : ndarray, shape (4, 4), float64
        Pose at the start of the scan.
    pose_stamps_ns, poses : ndarray, shapes (K,), int64, and (K, 4, 4), float64
        Times and poses over the whole scan, including both ends.
    truth : TargetTruth
        The targets.
    label : ndarray, shape (N,), int32
        Object that every ray hit: number of the body or target, -1 without a point, -2 for rain,
        dust and fog, -3 for an object in a mirror, -4 for the body that carries the sensor.
    """

    scan: Scan
    world_from_lidar: NDArray[np.float64]
    pose_stamps_ns: NDArray[np.int64]
    poses: NDArray[np.float64]
    truth: TargetTruth
    label: NDArray[np.int32]

    @property
    def posed(self) -> PosedScan[Scan]:
        """The scan with its poses, like scans of readers."""
        return PosedScan(self.scan, self.poses, self.pose_stamps_ns)


@dataclass(frozen=True, slots=True, repr=False)
class SimulatedSweep(ShortRepr):
    """A scan of a 2D LiDAR, where it was made, and the truth about it.

    Attributes
    ----------
    scan : LaserScan
        Ranges; each ray has its own time.
    world_from_lidar : ndarray, shape (4, 4), float64
        Pose at the first ray.
    pose_stamps_ns, poses : ndarray, shapes (K,), int64, and (K, 4, 4), float64
        Times and poses over the whole period of the scan, including both ends.
    truth : ObjectTruth
        The targets.
    label : ndarray, shape (B,), int32
        Object that every ray hit: number of the body or target, -1 without a range, -2 for rain and
        dust.
    """

    scan: LaserScan
    world_from_lidar: NDArray[np.float64]
    pose_stamps_ns: NDArray[np.int64]
    poses: NDArray[np.float64]
    truth: ObjectTruth
    label: NDArray[np.int32]

    @property
    def posed(self) -> PosedScan[LaserScan]:
        """The scan with its poses, like scans of readers."""
        return PosedScan(self.scan, self.poses, self.pose_stamps_ns)
