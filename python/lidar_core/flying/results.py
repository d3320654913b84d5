"""What the flying-object detector and the tracker return: arrays, one row per object."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from lidar_core.messages import PointClass


@dataclass(frozen=True, slots=True)
class Tracks:
    """Tracks at one time, by ascending number, in the world frame.

    Attributes
    ----------
    id : ndarray, shape (T,), int64
        Number of the track, never reused.
    position, velocity, acceleration : ndarray, shape (T, 3), float64
        [m], [m/s], [m/s^2].
    covariance : ndarray, shape (T, 9, 9), float64
        Of position, velocity and acceleration, in this order.
    extent : ndarray, shape (T, 3), float64
        Sides of the bounding box of the last cluster or detection [m].
    n_detections : ndarray, shape (T,), int64
        Detections that held the track.
    age : ndarray, shape (T,), float64
        Time since its first detection [s].
    stamp_ns : int
        Time of the states [ns].
    """

    id: NDArray[np.int64]
    position: NDArray[np.float64]
    velocity: NDArray[np.float64]
    acceleration: NDArray[np.float64]
    covariance: NDArray[np.float64]
    extent: NDArray[np.float64]
    n_detections: NDArray[np.int64]
    age: NDArray[np.float64]
    stamp_ns: int

    def __len__(self) -> int:
        return len(self.id)


@dataclass(frozen=True, slots=True)
class TrackEvents:
    """What one call did to the tracks, unconfirmed ones included, by their numbers.

    Attributes
    ----------
    is_late : bool
        The cloud was older than the newest one: kept for late detections, tracks untouched.
    corrected, born, confirmed, removed : ndarray, shape (K,), int64
        Tracks corrected by a cluster; new ones; reported from now on; removed.
    merged : ndarray, shape (K, 2), int64
        The track that stays and the one that went into it.
    n_rejected : int
        Measurements not used because a covariance was not positive definite.
    """

    is_late: bool
    corrected: NDArray[np.int64]
    born: NDArray[np.int64]
    confirmed: NDArray[np.int64]
    removed: NDArray[np.int64]
    merged: NDArray[np.int64]
    n_rejected: int


@dataclass(frozen=True, slots=True)
class FlyingDetections:
    """Flying objects in one scan, world frame.

    Attributes
    ----------
    position : ndarray, shape (M, 3), float64
        Their centres [m]; with `FlyingConfig.position` "paper" the centroids of their points.
    covariance : ndarray, shape (M, 3, 3), float64
        Of the position of the object's centre [m^2].
    radius : ndarray, shape (M,), float64
        Of the sphere around each object [m].
    extent : ndarray, shape (M, 3), float64
        Sides of the boxes around their points [m].
    n_points : ndarray, shape (M,), int64
        Points in the scan.
    confidence : ndarray, shape (M,), float64
        0 to 1: share of free voxels around the object, less for few points; 0 if only
        a track tells that it flies.
    time_ns : ndarray, shape (M,), int64
        When each was measured [ns]: the mean time of its points; the stamp of the scan where
        times of points are not given.
    """

    position: NDArray[np.float64]
    covariance: NDArray[np.float64]
    radius: NDArray[np.float64]
    extent: NDArray[np.float64]
    n_points: NDArray[np.int64]
    confidence: NDArray[np.float64]
    time_ns: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.position)


@dataclass(frozen=True, slots=True)
class FlyingStatus:
    """Whether detections are reported, and if not, why.

    Attributes
    ----------
    gate_open : bool
        Detections are reported.
    reason : str
        Why not: burn-in, no background, or a pose that contradicts the map.
    map_pose_mismatch : bool
        The scan was held: `reanchor` or `reset` go on from here.
    sky : str
        How rays without return are known: "given" by the caller or the recording, found by the
        "pattern" of a sensor with rows or by the "density" of the returns, or "unknown". While it
        is unknown, open sky is never cleared, and objects in front of it are unknown, not flying.
    sky_share : float
        Share of the sensor's rays that go into the sky.
    n_sky_rays : int
        Rays into the sky that were found, not given.
    own_body : float
        Share of the sensor's rays that end on the robot itself. Rays without return count,
        too: rows of the cloud without one, and where drivers leave rows out, the rays that the
        search for the sky expects. Of several returns of a ray one is enough.
    own_body_is_decided : bool
        The sensor has turned by 30 degrees: what was found is the robot, and nothing that goes
        along with it.
    """

    gate_open: bool
    reason: str
    map_pose_mismatch: bool = False
    sky: str = "unknown"
    sky_share: float = 0.0
    n_sky_rays: int = 0
    own_body: float = 0.0
    own_body_is_decided: bool = False


@dataclass(frozen=True, slots=True)
class FlyingFrame:
    """Result of one scan.

    Attributes
    ----------
    stamp_ns : int
        Time of the scan [ns].
    point_class : ndarray, shape (N,), uint8
        A `lidar_core.PointClass` each, row-major order of the input.
    detections : FlyingDetections
        Flying objects in this scan.
    tracks : Tracks
        Confirmed tracks at `stamp_ns`.
    teammate_id : ndarray, shape (K,), int64
        Known teammates seen in this scan.
    teammates : FlyingDetections
        Where they were seen, in the order of `teammate_id`.
    status : FlyingStatus
        Background gate open or closed, and why.
    timing_ms : dict
        Time per stage [ms]. With two threads or more, rays are cast while clusters are sought and
        judged: what of that takes longer is added to ``integrate``.
    rejected : str or None
        Why the scan could not be used (`on_bad_scan="count"`); the state is unchanged then.
    n_rays, n_visits : int
        Rays cast, and voxels they crossed.
    own_rows : ndarray, shape (K,), int64
        Rows of the points on the robot itself, ascending; their class is 3.
    """

    stamp_ns: int
    point_class: NDArray[np.uint8]
    detections: FlyingDetections
    tracks: Tracks
    teammate_id: NDArray[np.int64]
    teammates: FlyingDetections
    status: FlyingStatus
    timing_ms: dict[str, float]
    rejected: str | None = None
    n_rays: int = 0
    n_visits: int = 0
    own_rows: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, np.int64))

    @property
    def shown_class(self) -> NDArray[np.uint8]:
        """`point_class` with OWN_BODY for points on the robot itself, as pictures show it."""
        shown = self.point_class.copy()
        shown[self.own_rows] = PointClass.OWN_BODY
        return shown


@dataclass(frozen=True, slots=True)
class Health:
    """Scans counted: received = processed + held + rejected; what the last one told of the sensor.

    Attributes
    ----------
    received, processed, held, rejected : int
        All scans; those used; those held for a pose that contradicts the map; those refused.
    sky, sky_share, own_body : str, float, float
        Of the last scan used, as in `FlyingStatus`.
    """

    received: int = 0
    processed: int = 0
    held: int = 0
    rejected: int = 0
    sky: str = "unknown"
    sky_share: float = 0.0
    own_body: float = 0.0
