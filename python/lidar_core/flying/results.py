"""Results of the flying-object detector and the tracker: arrays, one row per object."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from lidar_core.messages import ShortRepr, ShownClass
from lidar_core.objects import FlyingDetections, Tracks


@dataclass(frozen=True, slots=True)
class TrackEvents:
    """IDs of the tracks that one call changed, including unconfirmed ones.

    Attributes
    ----------
    is_late : bool
        The cloud was older than the newest one: kept for late detections, tracks untouched.
    corrected, born, confirmed, removed : ndarray, shape (K,), int64
        Tracks corrected by a cluster; new ones; reported from now on; removed.
    merged : ndarray, shape (K, 2), int64
        Pairs of the track that stays and the one that was merged into it.
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
class FlyingStatus:
    """State of the detector: whether it reports detections, and if not, why.

    Attributes
    ----------
    gate_open : bool
        Detections are reported.
    reason : str
        Why not: burn-in, no background, or a pose that contradicts the map.
    map_pose_mismatch : bool
        The scan was held: call `reanchor` or `reset` to continue.
    sky : str
        Source of the rays without return: "given" by the caller or the recording, found by the
        "pattern" of a sensor with rows or by the "density" of the returns, or "unknown". While it
        is unknown, open sky is never cleared, and objects in front of it are unknown, not flying.
    sky_share : float
        Share of the sensor's rays that go into the sky.
    n_sky_rays : int
        Rays into the sky that were found, not given.
    point_times : str
        Source of the times of the points: "given" by the caller or the recording; "estimated" from
        the order of the points in a scan of a spinning sensor that moves; or "none": all points are
        taken to be of the stamp. Points with estimated times are moved to where they were measured.
    own_body : float
        Share of the sensor's rays that end on the robot itself. Rays without return count,
        too: rows of the cloud without one, and where drivers leave rows out, the rays that the
        search for the sky expects. Of several returns of a ray one is enough.
    own_body_is_decided : bool
        The sensor has turned by 30 degrees, which shows that the body is the robot, and not an
        object that moves along with it.
    """

    gate_open: bool
    reason: str
    map_pose_mismatch: bool = False
    sky: str = "unknown"
    sky_share: float = 0.0
    n_sky_rays: int = 0
    point_times: str = "none"
    own_body: float = 0.0
    own_body_is_decided: bool = False

    @property
    def is_burn_in(self) -> bool:
        """True for the scans of the burn-in, in which nothing is reported."""
        return self.reason.startswith("burn-in")


@dataclass(frozen=True, slots=True, repr=False)
class FlyingFrame(ShortRepr):
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
        Confirmed tracks of all kinds at `stamp_ns`; `tracks.flying` are those of kind FLYING.
    teammate_id : ndarray, shape (K,), int64
        Known teammates seen in this scan.
    teammates : FlyingDetections
        Detections of teammates, in the order of `teammate_id`.
    status : FlyingStatus
        Background gate open or closed, and why.
    timing_ms : dict
        Time per stage [ms]. With two threads or more, rays are cast during clustering and
        classification: the part that takes longer is added to ``integrate``.
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
        """Values of `point_class`, with OWN_BODY for points on the robot itself, for pictures."""
        shown = self.point_class.copy()
        shown[self.own_rows] = ShownClass.OWN_BODY
        return shown


@dataclass(frozen=True, slots=True)
class Health:
    """Counts of scans (received = processed + held + rejected), and state of the sensor.

    Attributes
    ----------
    received, processed, held, rejected : int
        Number of all scans; of used ones; of those held because their pose contradicts the map; of
        rejected ones.
    sky, sky_share, own_body, point_times : str, float, float, str
        Values of the last scan used, as in `FlyingStatus`.
    n_voxels_forgotten : int
        Observed voxels that the map forgot to stay within `voxel_map.max_voxels`, farthest first.
    far_scans : int
        Scans of which half of the points are more than 1000 m away, farther than any LiDAR for
        robots measures: points in millimetres, or in coordinates of a map.
    empty_scans : int
        Scans without any finite point.
    """

    received: int = 0
    processed: int = 0
    held: int = 0
    rejected: int = 0
    sky: str = "unknown"
    sky_share: float = 0.0
    own_body: float = 0.0
    point_times: str = "none"
    n_voxels_forgotten: int = 0
    far_scans: int = 0
    empty_scans: int = 0
