"""Simulated scans, and the truth about them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lidar_core.messages import LaserScan, PosedScan, Scan


@dataclass(frozen=True, slots=True)
class TargetTruth:
    """Where the targets are at the start of a scan, world frame, one row per target.

    Attributes
    ----------
    id : ndarray, shape (T,), int32
        As in `SimulatedScan.label`.
    position, velocity : ndarray, shape (T, 3), float64
        Of the centre [m], [m/s].
    radius : ndarray, shape (T,), float64
        Of the sphere around the target [m].
    hits : ndarray, shape (T,), int64
        Points on the target in this scan.
    rays : ndarray, shape (T,), int64
        Rays that would meet it within range if nothing else were there: 0 out of the field of
        view or out of range; far more than `hits` if it is hidden.
    visible : ndarray, shape (T,), bool
        At least one point.
    """

    id: NDArray[np.int32]
    position: NDArray[np.float64]
    velocity: NDArray[np.float64]
    radius: NDArray[np.float64]
    hits: NDArray[np.int64]
    rays: NDArray[np.int64]
    visible: NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class SimulatedScan:
    """A scan, where it was made, and the truth about it.

    Attributes
    ----------
    scan : Scan
        Points in the LiDAR's frame at the time of each ray.
    world_from_lidar : ndarray, shape (4, 4), float64
        At the start of the scan.
    pose_stamps_ns, poses : ndarray, shapes (K,), int64, and (K, 4, 4), float64
        The same over the whole scan, ends included.
    truth : TargetTruth
        The targets.
    label : ndarray, shape (N,), int32
        What every row met: number of the body or target, -1 where there is no point, -2 for rain,
        dust and fog, -3 for what was seen in a mirror, -4 for what carries the sensor.
    """

    scan: Scan
    world_from_lidar: NDArray[np.float64]
    pose_stamps_ns: NDArray[np.int64]
    poses: NDArray[np.float64]
    truth: TargetTruth
    label: NDArray[np.int32]

    @property
    def posed(self) -> PosedScan[Scan]:
        """The scan with its poses, as readers give it and detectors take it."""
        return PosedScan(self.scan, self.poses, self.pose_stamps_ns)


@dataclass(frozen=True, slots=True)
class ObjectTruth:
    """What a 2D LiDAR could see at the start of a scan, world frame, one row per target.

    Attributes
    ----------
    id : ndarray, shape (T,), int32
        As in `SimulatedSweep.label`.
    kind : tuple of str
        Kinds of shape.
    center, velocity : ndarray, shape (T, 2), float64
        Of the shape's frame [m], [m/s].
    radius : ndarray, shape (T,), float64
        Of a cylinder or barrel [m]; NaN for what is not round.
    hits : ndarray, shape (T,), int64
        Rays of this scan that ended on it.
    rays : ndarray, shape (T,), int64
        Rays that would meet it within range if nothing else were there.
    """

    id: NDArray[np.int32]
    kind: tuple[str, ...]
    center: NDArray[np.float64]
    velocity: NDArray[np.float64]
    radius: NDArray[np.float64]
    hits: NDArray[np.int64]
    rays: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.id)

    @property
    def visible_share(self) -> NDArray[np.float64]:
        """Hits per ray that could meet it, shape (T,); 0 where there is none."""
        return self.hits / np.maximum(self.rays, 1)


@dataclass(frozen=True, slots=True)
class SimulatedSweep:
    """A scan of a 2D LiDAR, where it was made, and the truth about it.

    Attributes
    ----------
    scan : LaserScan
        Ranges; each ray has its own time.
    world_from_lidar : ndarray, shape (4, 4), float64
        At the first ray.
    pose_stamps_ns, poses : ndarray, shapes (K,), int64, and (K, 4, 4), float64
        The same over the whole period of the scan, ends included.
    truth : ObjectTruth
        The targets.
    label : ndarray, shape (B,), int32
        What every ray met: number of the body or target, -1 where there is no range, -2 for rain
        and dust.
    """

    scan: LaserScan
    world_from_lidar: NDArray[np.float64]
    pose_stamps_ns: NDArray[np.int64]
    poses: NDArray[np.float64]
    truth: ObjectTruth
    label: NDArray[np.int32]

    @property
    def posed(self) -> PosedScan[LaserScan]:
        """The scan with its poses, as readers give it and pipelines take it."""
        return PosedScan(self.scan, self.poses, self.pose_stamps_ns)
