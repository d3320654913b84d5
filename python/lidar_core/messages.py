"""Messages between readers, simulator and pipelines: 3D scans, 2D scans, poses."""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from enum import IntEnum
from typing import Any, Generic, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from lidar_core.arrays import as_stamp
from lidar_core.errors import InputError

__all__ = [
    "LaserScan",
    "Message",
    "PointClass",
    "Pose",
    "PosedScan",
    "Scan",
    "ScanT",
    "ShapeKind",
    "ShortRepr",
    "ShownClass",
    "TrackKind",
    "posed_of",
    "stated_stamp",
]


class PointClass(IntEnum):
    """Class of a point of a 3D scan; arrays of classes hold its numbers as uint8.

    Attributes
    ----------
    INVALID
        No information: NaN, masked, or no return.
    BACKGROUND
        Part of the environment.
    FLYING
        Part of an object with free space around it.
    UNKNOWN
        Cannot be classified.
    MOVING
        Part of an object that moves on the ground; `VoxelMap.integrate` takes it as UNKNOWN.
    """

    INVALID = 0
    BACKGROUND = 1
    FLYING = 2
    UNKNOWN = 3
    MOVING = 4


class TrackKind(IntEnum):
    """Kind of the target of a track; arrays of kinds hold its numbers as uint8.

    Attributes
    ----------
    UNKNOWN
        None of the others, or not decided.
    FLYING
        It flies.
    GROUND
        It moves on the ground.
    STATIC
        It is at rest.
    CLUTTER
        It moves, but is no target: insects, leaves, dust, rain.
    """

    UNKNOWN = 0
    FLYING = 1
    GROUND = 2
    STATIC = 3
    CLUTTER = 4


class ShownClass(IntEnum):
    """Class of a point in pictures and written clouds: a `PointClass`, or OWN_BODY.

    OWN_BODY marks points on the robot itself; results call them UNKNOWN.
    """

    INVALID = 0
    BACKGROUND = 1
    FLYING = 2
    UNKNOWN = 3
    MOVING = 4
    OWN_BODY = 5


class ShapeKind(IntEnum):
    """Shape of a segment; it determines the meaning of the segment's parameters."""

    CIRCLE = 0
    """Centre x, y, radius [m]."""
    ELLIPSE = 1
    """Centre x, y, longer and shorter semi-axis [m], bearing of the longer one [rad]."""
    RECTANGLE = 2
    """Centre x, y, longer and shorter side [m], bearing of the longer one [rad]. Two sides were
    seen; of one alone nothing tells whether there is a box behind it: it is a line."""
    LINE = 3
    """Bearing of the normal [rad], distance from the origin [m], both ends as positions along the
    line, counted counter-clockwise from the foot of the normal [m]."""


class ShortRepr:
    """Base of dataclasses with large arrays: their text has types and shapes, and no None."""

    __slots__ = ()

    def __repr__(self) -> str:
        values = ((one.name, getattr(self, one.name)) for one in fields(self))  # type: ignore[arg-type]
        shown = (f"{name}={_short(value)}" for name, value in values if value is not None)
        return f"{type(self).__name__}({', '.join(shown)})"


def _short(value: Any) -> str:
    if not isinstance(value, np.ndarray):
        return repr(value)
    if value.size <= 4:  # such as the numbers of a few tracks
        return repr(value.tolist())
    return f"{value.dtype} {value.shape}"


@dataclass(frozen=True, slots=True, repr=False)
class Scan(ShortRepr):
    """One revolution (or frame) of a 3D LiDAR, in its own frame.

    Attributes
    ----------
    stamp_ns : int
        Start of the scan [ns].
    points : ndarray, shape (N, 3) or (H, W, 3), float32
        Coordinates [m]; NaN means no information, or no return where `no_return` is true.
    frame_id : str
        Name of the LiDAR's frame.
    no_return : ndarray, shape (N,), bool, optional
        True for rays that met nothing within range. None: the recording does not state it.
    directions : ndarray, shape (N, 3), float32, optional
        Unit direction of every ray.
    point_time_ns : ndarray, shape (N,), int64, optional
        Absolute time of every point [ns].
    intensity, ring : ndarray, shape (N,), optional
        Values of the recording.
    topic : str
        Topic of the recording.
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


@dataclass(frozen=True, slots=True, repr=False)
class LaserScan(ShortRepr):
    """One sweep of a 2D LiDAR, in its own frame: rays in the plane z = 0, counter-clockwise.

    Attributes
    ----------
    stamp_ns : int
        Time of the first ray [ns].
    ranges : ndarray, shape (B,), float32
        Distance of every ray [m]; +inf is no return, NaN no information (REP-117).
    angle_min, angle_increment : float
        Bearing of the first ray, and from one ray to the next [rad]; the increment is negative
        for a scanner that turns clockwise.
    range_min, range_max : float
        Limits of the scanner [m].
    frame_id : str
        Name of the LiDAR's frame.
    intensity : ndarray, shape (B,), float32, optional
        Values of the recording.
    time_increment_ns : int
        Time from one ray to the next [ns]; 0: all rays at `stamp_ns`, or unknown.
    topic : str
        Topic of the recording.
    """

    stamp_ns: int
    ranges: NDArray[np.float32]
    angle_min: float
    angle_increment: float
    range_min: float
    range_max: float
    frame_id: str = "laser"
    intensity: NDArray[np.float32] | None = None
    time_increment_ns: int = 0
    topic: str = ""


@dataclass(frozen=True, slots=True, repr=False)
class Pose(ShortRepr):
    """Pose of the frame `child_frame_id` in the frame `frame_id` at one time.

    Attributes
    ----------
    stamp_ns : int
        Time [ns].
    frame_id, child_frame_id : str
        `matrix` takes coordinates of `child_frame_id` to `frame_id`.
    matrix : ndarray, shape (4, 4), float64
        Rotation and translation [m].
    covariance : ndarray, shape (6, 6), float64, optional
        Covariance of translation and rotation, in the order x, y, z, roll, pitch, yaw.
    is_static : bool
        True for a mounting that never changes.
    topic : str
        Topic of the recording.
    """

    stamp_ns: int
    frame_id: str
    child_frame_id: str
    matrix: NDArray[np.float64]
    covariance: NDArray[np.float64] | None = None
    is_static: bool = False
    topic: str = ""


Message: TypeAlias = Scan | LaserScan | Pose
ScanT = TypeVar("ScanT", Scan, LaserScan)


@dataclass(frozen=True, slots=True, repr=False)
class PosedScan(ShortRepr, Generic[ScanT]):
    """A scan and where the sensor was.

    Attributes
    ----------
    scan : Scan or LaserScan
        Scan of the recording.
    world_from_lidar : ndarray, shape (4, 4) or (K, 4, 4), float64
        One pose, or poses over the scan.
    pose_stamps_ns : ndarray, shape (K,), int64, optional
        Times of the poses [ns].
    pose_covariance : ndarray, shape (6, 6), float64, optional
        Covariance of translation [m^2] and of angles about x, y, z [rad^2], if the source of the
        poses states it.
    """

    scan: ScanT
    world_from_lidar: NDArray[np.float64]
    pose_stamps_ns: NDArray[np.int64] | None = None
    pose_covariance: NDArray[np.float64] | None = None

    @property
    def sensor(self) -> str:
        """Name of the LiDAR: the topic of the scan, or its frame if it has no topic."""
        return self.scan.topic or self.scan.frame_id

    @property
    def posed(self) -> "PosedScan[ScanT]":
        """The posed scan itself, for a common interface with simulated scans."""
        return self


def posed_of(given: object, *, name: str) -> PosedScan[Any] | None:
    """Return the posed scan of an argument: a posed or simulated scan; None for arrays.

    Raises
    ------
    InputError
        A scan without its pose, or a message of another library.
    """
    if isinstance(given, Scan | LaserScan):
        raise InputError(
            f"{name}: expected a posed scan or an array, got a {type(given).__name__} without a"
            " pose: PosedScan(scan, world_from_lidar) holds both"
        )
    posed = getattr(given, "posed", None)
    if isinstance(posed, PosedScan):
        return posed
    if cure := _cure_of_message(given):
        kind = type(given)
        named = (
            kind.__name__ if kind.__module__ == "builtins" else f"{kind.__module__}.{kind.__name__}"
        )
        raise InputError(f"{name}: expected an array or a posed scan, got a {named}; {cure}")
    return None


def _cure_of_message(given: object) -> str | None:
    """Return what to pass in place of a message or dictionary with a scan; None for others."""
    is_mapping = isinstance(given, Mapping)
    if not is_mapping and any(hasattr(given, one) for one in ("__array__", "__len__")):
        return None  # an array, of any library, or a list

    def has(name: str) -> bool:
        return name in given if isinstance(given, Mapping) else hasattr(given, name)

    def field(name: str) -> str:
        return f'msg["{name}"]' if is_mapping else f"msg.{name}"

    if has("ranges"):
        names = ("ranges", "angle_min", "angle_increment", "range_min", "range_max")
        values = ", ".join(map(field, names))
        return (
            f"CirclePipeline takes the array, {field('ranges')}, or lc.io.PosedScan("
            f"lc.io.LaserScan(stamp_ns, {values}), world_from_lidar)"
        )
    if has("points"):
        return f"FlyingObjectDetector takes the array of shape (N, 3), {field('points')}"
    if has("data"):
        return (
            "FlyingObjectDetector takes points of shape (N, 3), for a PointCloud2 those of"
            ' sensor_msgs_py.point_cloud2.read_points_numpy(msg, ["x", "y", "z"])'
        )
    return None


def stated_stamp(given: object, stamp_ns: object) -> int:
    """Time of a rejected scan [ns]; 0 if it is unknown."""
    scan = getattr(getattr(given, "posed", None), "scan", given)
    stamp: Any = getattr(scan, "stamp_ns", stamp_ns)
    try:
        return as_stamp(stamp)
    except InputError:
        return 0


def __dir__() -> list[str]:
    return __all__
