"""Objects at one time, one row each: tracks, detections, elements of maps, targets, the truth.

Longer than other files: all tables are one family of classes.
"""

from dataclasses import dataclass, fields
from importlib import import_module
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from lidar_core.errors import MissingExtraError
from lidar_core.extras import require
from lidar_core.messages import TrackKind

__all__ = [
    "Boxes",
    "CircleElements",
    "FlyingDetections",
    "ObjectTable",
    "ObjectTruth",
    "Objects",
    "ShapeElements",
    "TargetTracks",
    "TargetTruth",
    "Tracks",
]

CORNERS = 36  # of the outline of a circle
_AXES = {
    "position": ("x", "y", "z"),
    "center": ("x", "y"),
    "velocity": ("vx", "vy", "vz"),
    "acceleration": ("ax", "ay", "az"),
    "kind_probability": tuple(f"p_{kind.name.lower()}" for kind in TrackKind),
}
"""Names of the columns of vectors; those of others are numbered from 0."""


class ObjectTable:
    """Base of the classes of this module: arrays with one row per object.

    SI units; right-handed frames. `len` counts the rows.

    Attributes
    ----------
    STATE : tuple of str
        Names of the states in `covariance`.
    """

    __slots__ = ()
    STATE: ClassVar[tuple[str, ...]] = ()

    def __len__(self) -> int:
        arrays = (getattr(self, one.name) for one in fields(self))  # type: ignore[arg-type]
        return next(len(value) for value in arrays if isinstance(value, np.ndarray))

    def __repr__(self) -> str:
        more = [f"{name}={getattr(self, name)}" for name in ("stamp_ns",) if hasattr(self, name)]
        if hasattr(self, "id"):
            numbers = np.array2string(self.id, threshold=6, edgeitems=3, separator=", ")
            more.insert(0, f"id={numbers}")
        return f"{type(self).__name__}({', '.join([f'{len(self)} rows', *more])})"

    def where(self, mask: NDArray[np.bool_]) -> Self:
        """Select rows for which `mask` (K,) is true, such as `tracks.kind == TrackKind.FLYING`."""
        chosen: dict[str, Any] = {}
        for one in fields(self):  # type: ignore[arg-type]
            value = getattr(self, one.name)
            if isinstance(value, tuple):
                value = tuple(part for part, is_in in zip(value, mask, strict=True) if is_in)
            chosen[one.name] = value[mask] if isinstance(value, np.ndarray) else value
        return type(self)(**chosen)

    def to_dict(self) -> dict[str, Any]:
        """Return every field by name as plain values: numbers, texts and nested lists."""
        values = {one.name: getattr(self, one.name) for one in fields(self)}  # type: ignore[arg-type]
        return {
            name: value.tolist() if isinstance(value, np.ndarray) else value
            for name, value in values.items()
        }

    def to_columns(self) -> dict[str, NDArray[Any]]:
        """Return one array of shape (K,) per column of a table, one row per object.

        Positions are x, y, z, velocities vx, vy, vz, accelerations ax, ay, az; of covariances
        the upper triangle is cov_A_B, as in the tables of runs; probabilities of kinds are
        p_unknown to p_clutter; the parts of other vectors are
        numbered, such as extent_0; a time of all rows is repeated.
        """
        columns: dict[str, NDArray[Any]] = {}
        for one in fields(self):  # type: ignore[arg-type]
            value = getattr(self, one.name)
            if not isinstance(value, np.ndarray):
                value = np.array([value] * len(self)) if np.isscalar(value) else np.array(value)
            if value.ndim == 1:
                columns[one.name] = value
            elif value.ndim == 3 and value.shape[1] == value.shape[2] and one.name != "ends":
                names = self.STATE or tuple(map(str, range(value.shape[1])))
                pairs = zip(*np.triu_indices(value.shape[1]), strict=True)
                columns |= {f"cov_{names[i]}_{names[j]}": value[:, i, j] for i, j in pairs}
            else:
                parts = value.reshape(len(value), int(np.prod(value.shape[1:])))
                known = _AXES.get(one.name, ())
                for at, column in enumerate(parts.T):
                    columns[known[at] if at < len(known) else f"{one.name}_{at}"] = column
        return columns

    def to_arrow(self) -> Any:
        """Return a table of pyarrow with the columns of `to_columns`.

        Raises
        ------
        MissingExtraError
            The extra `tables` is not installed.
        """
        arrow = require("pyarrow", extra="tables", purpose="to_arrow")
        return arrow.table(self.to_columns())

    def to_pandas(self) -> Any:
        """Return a DataFrame of pandas with the columns of `to_columns`.

        Raises
        ------
        MissingExtraError
            pandas is not installed; no extra installs it.
        """
        try:
            frame = import_module("pandas").DataFrame
        except ImportError as error:
            raise MissingExtraError(
                "to_pandas needs the package 'pandas': pip install pandas"
            ) from error
        return frame(self.to_columns())


@dataclass(frozen=True, slots=True, repr=False)
class Boxes(ObjectTable):
    """Boxes with IDs at one time: as much of tracks as viewers show.

    Attributes
    ----------
    id : ndarray, shape (T,), int64
        IDs of the tracks.
    position, velocity : ndarray, shape (T, 3), float64
        Position [m] and velocity [m/s].
    extent : ndarray, shape (T, 3), float64
        Sides of the bounding boxes [m].
    stamp_ns : int
        Time of the states [ns].
    """

    id: NDArray[np.int64]
    position: NDArray[np.float64]
    velocity: NDArray[np.float64]
    extent: NDArray[np.float64]
    stamp_ns: int


@dataclass(frozen=True, slots=True, repr=False)
class Tracks(Boxes):
    """Tracks at one time, by ascending ID, in the world frame.

    Attributes
    ----------
    id : ndarray, shape (T,), int64
        ID of the track, never reused.
    position, velocity, acceleration : ndarray, shape (T, 3), float64
        Position [m], velocity [m/s] and acceleration [m/s^2].
    covariance : ndarray, shape (T, 9, 9), float64
        Covariance of position, velocity and acceleration, in this order.
    extent : ndarray, shape (T, 3), float64
        Sides of the bounding box of the last cluster or detection [m].
    n_detections : ndarray, shape (T,), int64
        Number of detections that updated the track.
    age : ndarray, shape (T,), float64
        Time since its first detection [s].
    existence : ndarray, shape (T,), float64
        Probability that there is a target; NaN where tracks are confirmed by counts.
    kind : ndarray, shape (T,), uint8
        A `lidar_core.TrackKind` each: the kind that is more probable than all others together, or
        UNKNOWN; FLYING if tracks are confirmed by counts.
    kind_probability : ndarray, shape (T, 5), float64
        Probability of every `TrackKind`, by number, if there is a target; NaN where tracks are
        confirmed by counts.
    stamp_ns : int
        Time of the states [ns].
    """

    STATE: ClassVar[tuple[str, ...]] = ("x", "y", "z", "vx", "vy", "vz", "ax", "ay", "az")

    acceleration: NDArray[np.float64]
    covariance: NDArray[np.float64]
    n_detections: NDArray[np.int64]
    age: NDArray[np.float64]
    existence: NDArray[np.float64]
    kind: NDArray[np.uint8]
    kind_probability: NDArray[np.float64]

    @property
    def flying(self) -> "Tracks":
        """Return the tracks of kind FLYING: pictures, viewers and evaluations show these."""
        return self.where(self.kind == TrackKind.FLYING)


@dataclass(frozen=True, slots=True, repr=False)
class FlyingDetections(ObjectTable):
    """Flying objects in one scan, world frame.

    Attributes
    ----------
    position : ndarray, shape (M, 3), float64
        Centres of the objects [m]; with `FlyingConfig.position` "paper" the centroids of their
        points.
    covariance : ndarray, shape (M, 3, 3), float64
        Covariance of the position [m^2].
    radius : ndarray, shape (M,), float64
        Radius of the sphere around each object [m].
    extent : ndarray, shape (M, 3), float64
        Sides of the boxes around their points [m].
    n_points : ndarray, shape (M,), int64
        Points in the scan.
    confidence : ndarray, shape (M,), float64
        Confidence, 0 to 1: share of free voxels among those around the object that rays can see,
        lower for few points; 0 if only a track indicates that the object flies.
    time_ns : ndarray, shape (M,), int64
        Times of measurement [ns]: the mean time of its points; the stamp of the scan where
        times of points are not given.
    """

    STATE: ClassVar[tuple[str, ...]] = ("x", "y", "z")

    position: NDArray[np.float64]
    covariance: NDArray[np.float64]
    radius: NDArray[np.float64]
    extent: NDArray[np.float64]
    n_points: NDArray[np.int64]
    confidence: NDArray[np.float64]
    time_ns: NDArray[np.int64]


@dataclass(frozen=True, slots=True, repr=False)
class CircleElements(ObjectTable):
    """Elements of the map at one time, by ascending ID, in the world frame.

    Attributes
    ----------
    id : ndarray, shape (M,), int64
        ID of the element, never reused: an element that was removed gets another ID if a late scan
        shows it again.
    center, velocity : ndarray, shape (M, 2), float64
        Centre [m] and velocity [m/s].
    radius : ndarray, shape (M,), float64
        Radius [m].
    covariance : ndarray, shape (M, 5, 5), float64
        Covariance of x, y, vx, vy and r, in this order.
    age : ndarray, shape (M,), float64
        Time since its first measurement [s].
    seen_ns : ndarray, shape (M,), int64
        Time of its last measurement [ns].
    visible : ndarray, shape (M,), bool
        A sensor's newest scan measured it, or should have: it is neither hidden nor out of view.
    person_probability : ndarray, shape (M,), float64
        Probability that the element is a person, 0 to 1: by its walk, its size, and its two legs at
        the height of the scan. 0 with the filter of the paper.
    existence : ndarray, shape (M,), float64
        Probability that there is an object, and not a chance group of rays, 0 to 1; 1 with the
        filter of the paper.
    kind : ndarray, shape (M,), uint8
        A `TrackKind`: STATIC for elements that have not moved, GROUND for elements that move or
        have moved; UNKNOWN if undecided, and with the filter of the paper.
    kind_probability : ndarray, shape (M, 5), float64
        Probability of every `TrackKind`, if there is an object; the sum is 1.
    stamp_ns : int
        Time of the states [ns].
    """

    STATE: ClassVar[tuple[str, ...]] = ("x", "y", "vx", "vy", "radius")

    id: NDArray[np.int64]
    center: NDArray[np.float64]
    velocity: NDArray[np.float64]
    radius: NDArray[np.float64]
    covariance: NDArray[np.float64]
    age: NDArray[np.float64]
    seen_ns: NDArray[np.int64]
    visible: NDArray[np.bool_]
    person_probability: NDArray[np.float64]
    existence: NDArray[np.float64]
    kind: NDArray[np.uint8]
    kind_probability: NDArray[np.float64]
    stamp_ns: int


@dataclass(frozen=True, slots=True, repr=False)
class ShapeElements(ObjectTable):
    """Lines, ellipses and rectangles of the map at one time, by ID, in the world frame.

    Attributes
    ----------
    id : ndarray, shape (K,), int64
        ID of the element, never reused. An ellipse or rectangle that is not large is also a circle
        of the map. It keeps its ID if its shape changes.
    kind : ndarray, shape (K,), uint8
        A `ShapeKind`.
    center, velocity : ndarray, shape (K, 2), float64
        Centre [m] and velocity [m/s]; lines are at rest. The centre of an ellipse or rectangle is
        the centre of this shape, not of the circle.
    heading : ndarray, shape (K,), float64
        Bearing of the longer half length [rad], -pi/2 to pi/2. For a line, direction from its first
        to its second end; the scanner was on the left of it.
    half_size : ndarray, shape (K, 2), float64
        Longer and shorter half length [m]; for a line, half the length of its seen part, and 0.
    ends : ndarray, shape (K, 2, 2), float64
        Ends of the seen part of a line [m].
    covariance : ndarray, shape (K, 7, 7), float64
        Covariance of x, y, vx, vy, heading and the half lengths, in this order. For a line, only
        across it and of its heading: its ends are seen, not estimated.
    age : ndarray, shape (K,), float64
        Time since its first measurement [s].
    seen_ns : ndarray, shape (K,), int64
        Time of its last measurement [ns].
    visible : ndarray, shape (K,), bool
        A sensor's newest scan measured it, or should have: it is neither hidden nor out of view.
    stamp_ns : int
        Time of the states [ns].
    """

    STATE: ClassVar[tuple[str, ...]] = (
        "x",
        "y",
        "vx",
        "vy",
        "heading",
        "half_length",
        "half_width",
    )

    id: NDArray[np.int64]
    kind: NDArray[np.uint8]
    center: NDArray[np.float64]
    velocity: NDArray[np.float64]
    heading: NDArray[np.float64]
    half_size: NDArray[np.float64]
    ends: NDArray[np.float64]
    covariance: NDArray[np.float64]
    age: NDArray[np.float64]
    seen_ns: NDArray[np.int64]
    visible: NDArray[np.bool_]
    stamp_ns: int


@dataclass(frozen=True, slots=True, repr=False)
class TargetTracks(ObjectTable):
    """Tracks at one time, a row per track.

    Attributes
    ----------
    stamp_ns : int
        Time of the states [ns].
    id : ndarray, shape (T,), int64
        IDs of the tracks, never reused.
    states : ndarray, shape (T, n)
        States in the order of the model.
    covariances : ndarray, shape (T, n, n)
    velocity : ndarray, shape (T, 2)
        Velocity [m/s].
    born_ns, seen_ns : ndarray, shape (T,), int64
        Times of the first and the last measurement [ns].
    hits : ndarray, shape (T,), int64
        Measurements.
    confirmed : ndarray, shape (T,), bool
        True if the track is reported.
    existence : ndarray, shape (T,)
        Probability that there is a target; NaN for associations that do not estimate it.
    kind : ndarray, shape (T,), uint8
        A `TrackKind`: the kind that is more probable than all others together, or UNKNOWN. STATIC:
        at rest for some 10 s, or for two minutes after a motion. CLUTTER: false measurements.
        FLYING: in space, climbs more steeply than roads. Other moving targets are UNKNOWN, because
        FLYING and GROUND cannot be distinguished; so are all targets with the model "ctrv-drone",
        whose frame moves.
    kind_probability : ndarray, shape (T, 5)
        Probability of every `TrackKind`, by number. Kinds that cannot be distinguished have equal
        probabilities. The probability of CLUTTER comes from the association at the last
        measurement; "nearest" does not estimate it.
    """

    stamp_ns: int
    id: NDArray[np.int64]
    states: NDArray[np.float64]
    covariances: NDArray[np.float64]
    velocity: NDArray[np.float64]
    born_ns: NDArray[np.int64]
    seen_ns: NDArray[np.int64]
    hits: NDArray[np.int64]
    confirmed: NDArray[np.bool_]
    existence: NDArray[np.float64]
    kind: NDArray[np.uint8]
    kind_probability: NDArray[np.float64]

    @property
    def position(self) -> NDArray[np.float64]:
        """Positions (T, 2) [m]."""
        return self.states[:, :2]


@dataclass(frozen=True, slots=True, repr=False)
class TargetTruth(ObjectTable):
    """States of the targets at the start of a scan, world frame, one row per target.

    Attributes
    ----------
    id : ndarray, shape (T,), int32
        ID of the target, as in `SimulatedScan.label`.
    position, velocity : ndarray, shape (T, 3), float64
        Position [m] and velocity [m/s] of the centre.
    radius : ndarray, shape (T,), float64
        Radius of the sphere around the target [m].
    hits : ndarray, shape (T,), int64
        Points on the target in this scan.
    rays : ndarray, shape (T,), int64
        Rays that would hit it within range if nothing else were there: 0 outside the field of view
        or range; many more than `hits` if it is hidden.
    visible : ndarray, shape (T,), bool
        True if at least one point of the scan is on the target.
    """

    id: NDArray[np.int32]
    position: NDArray[np.float64]
    velocity: NDArray[np.float64]
    radius: NDArray[np.float64]
    hits: NDArray[np.int64]
    rays: NDArray[np.int64]
    visible: NDArray[np.bool_]


@dataclass(frozen=True, slots=True, repr=False)
class ObjectTruth(ObjectTable):
    """Objects within the reach of a 2D LiDAR at the start of a scan, world frame, one row each.

    Attributes
    ----------
    id : ndarray, shape (T,), int32
        ID of the target, as in `SimulatedSweep.label`.
    kind : tuple of str
        Kinds of shape.
    center, velocity : ndarray, shape (T, 2), float64
        Centre [m] and velocity [m/s] of the frame of the shape.
    radius : ndarray, shape (T,), float64
        Radius of a cylinder or barrel [m]; NaN for other shapes.
    hits : ndarray, shape (T,), int64
        Rays of this scan that ended on it.
    rays : ndarray, shape (T,), int64
        Rays that would hit it within range if nothing else were there.
    """

    id: NDArray[np.int32]
    kind: tuple[str, ...]
    center: NDArray[np.float64]
    velocity: NDArray[np.float64]
    radius: NDArray[np.float64]
    hits: NDArray[np.int64]
    rays: NDArray[np.int64]

    @property
    def visible_share(self) -> NDArray[np.float64]:
        """Hits per ray that could hit it, shape (T,); 0 without such rays."""
        return self.hits / np.maximum(self.rays, 1)


@dataclass(frozen=True, slots=True, repr=False)
class Objects(ObjectTable):
    """Tracks, or elements of a map, at one time; world frame.

    Attributes
    ----------
    id : ndarray, shape (K,), int64
        IDs.
    position, velocity : ndarray, shape (K, 3), float64
        Position [m] and velocity [m/s]; heights are zero in the plane.
    covariance : ndarray, shape (K, 3, 3), float64
        Covariance of the position [m^2]; zero if unknown.
    size : ndarray, shape (K, 3), float64
        Sides of the bounding boxes [m]; circles have no height; zero where unknown.
    """

    STATE: ClassVar[tuple[str, ...]] = ("x", "y", "z")

    id: NDArray[np.int64]
    position: NDArray[np.float64]
    velocity: NDArray[np.float64]
    covariance: NDArray[np.float64]
    size: NDArray[np.float64]

    def outline(self, row: int) -> NDArray[np.float64]:
        """Return a closed line (V, 3) [m] around object `row` from above: a circle or rectangle."""
        if self.size[row, 2] == 0:
            angles = np.linspace(0, 2 * np.pi, CORNERS + 1)
            around = np.stack([np.cos(angles), np.sin(angles), np.zeros_like(angles)], axis=1)
        else:
            around = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0], [-1, -1, 0]], float)
        line: NDArray[np.float64] = self.position[row] + around * self.size[row] / 2
        return line


def __dir__() -> list[str]:
    return __all__
