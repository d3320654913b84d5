"""What flows between readers, the simulator and the pipelines: scans and poses."""

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class Scan:
    """One revolution (or frame) of a 3D LiDAR, in its own frame.

    Attributes
    ----------
    stamp_ns : int
        Start of the scan [ns].
    points : ndarray, shape (N, 3) or (H, W, 3), float32
        Coordinates [m]; NaN is no information (or no return, where `no_return` says so).
    frame_id : str
        Name of the LiDAR's frame.
    no_return : ndarray, shape (N,), bool, optional
        Rays that met nothing within range. None: the recording does not tell.
    directions : ndarray, shape (N, 3), float32, optional
        Unit direction of every ray.
    point_time_ns : ndarray, shape (N,), int64, optional
        Absolute time of every point [ns].
    intensity, ring : ndarray, shape (N,), optional
        As recorded.
    topic : str
        Where in the recording it came from.
    """

    stamp_ns: int
    points: NDArray[np.float32]
    frame_id: str = "lidar"
    no_return: NDArray[np.bool_] | None = None
    directions: NDArray[np.float32] | None = None
    point_time_ns: NDArray[np.int64] | None = None
    intensity: NDArray[np.float32] | None = None
    ring: NDArray[np.uint16] | None = None
    topic: str = ""


@dataclass(frozen=True, slots=True)
class Pose:
    """Where the frame `child_frame_id` is in the frame `frame_id` at one time.

    Attributes
    ----------
    stamp_ns : int
        Time [ns].
    frame_id, child_frame_id : str
        `matrix` takes coordinates of `child_frame_id` to `frame_id`.
    matrix : ndarray, shape (4, 4), float64
        Rotation and translation [m].
    covariance : ndarray, shape (6, 6), float64, optional
        Of translation and rotation, in the order x, y, z, roll, pitch, yaw.
    is_static : bool
        True for a mounting that never changes.
    topic : str
        Where in the recording it came from.
    """

    stamp_ns: int
    frame_id: str
    child_frame_id: str
    matrix: NDArray[np.float64]
    covariance: NDArray[np.float64] | None = None
    is_static: bool = False
    topic: str = ""


Message: TypeAlias = Scan | Pose
