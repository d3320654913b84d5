"""Results of the circle pipeline for one scan."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from lidar_core.circles.estimators.fitting import Circles
from lidar_core.circles.mapping.map import MapEvents
from lidar_core.circles.segmentation import Segments
from lidar_core.circles.shapes import Shapes
from lidar_core.messages import ShortRepr
from lidar_core.objects import CircleElements, ShapeElements


@dataclass(frozen=True, slots=True, repr=False)
class CircleFrame(ShortRepr):
    """Result of one scan.

    The level frame has its origin at the scanner at the time of the scan, z up, and the scanner's
    yaw.

    Attributes
    ----------
    stamp_ns : int
        Time of the scan [ns].
    scanner : str
        Name of the scanner.
    ranges, bearings : ndarray, shape (B,), float64
        The scan in the level frame [m], [rad], limited to the operating volume.
    heights : ndarray, shape (B,), float64
        Height of each hit above the scanner [m]; NaN for other rays.
    segments : Segments
        Groups of rays, one per object.
    circles, circles_world : Circles
        One circle per segment, in the level frame and in the world.
    time_ns : ndarray, shape (C,), int64
        Time of each measurement: the mean time of the rays of its segment [ns]. A moving object was
        there at that time, not at `stamp_ns`.
    shapes : Shapes
        One shape per segment, in the level frame; empty if `shapes` of the configuration is off.
    element : ndarray, shape (C,), int64
        ID of the map element that every segment belongs to; -1 for a segment that the map does
        not use: it is not a circle, its hits do not lie on the fitted circle, or the object is too
        near.
    too_near : ndarray, shape (C,), bool
        True for segments that are left out of the map because part of the object may be nearer than
        the scanner measures: the mean of the remaining hits is too far away. All False if
        `CirclesConfig.shapes.enabled` is False.
    line : ndarray, shape (C,), int64
        Map line of every segment; -1 for other shapes, and for lines that are too short to start
        one.
    map : CircleElements
        Confirmed elements at the time of the scan.
    map_shapes : ShapeElements
        Map elements with other shapes than circles.
    events : MapEvents
        Changes of the map by this scan.
    stuck_pose : bool
        True if the scanner moved although earlier scans, 0.4 to 2.2 s before, have exactly the same
        pose: the source of the poses stopped, and static objects seem to move. False as well if so
        many objects move that no decision is possible. Always False in paper mode.
    timing_ms : dict
        Milliseconds per stage: prepare, segment, fit, map.
    rejected : str, optional
        Reason why the scan was not used; None if it was used.
    """

    stamp_ns: int
    scanner: str
    ranges: NDArray[np.float64]
    bearings: NDArray[np.float64]
    heights: NDArray[np.float64]
    segments: Segments
    circles: Circles
    circles_world: Circles
    time_ns: NDArray[np.int64]
    shapes: Shapes
    element: NDArray[np.int64]
    too_near: NDArray[np.bool_]
    line: NDArray[np.int64]
    map: CircleElements
    map_shapes: ShapeElements
    events: MapEvents
    stuck_pose: bool = False
    timing_ms: dict[str, float] = field(default_factory=dict)
    rejected: str | None = None


@dataclass(frozen=True, slots=True)
class CirclesHealth:
    """Scans counted since the start.

    Attributes
    ----------
    received, processed, rejected : int
        received = processed + rejected.
    reasons : mapping of str to int
        Number of rejected scans by reason, without the values of the single scan.
    range_std_estimated : float, optional
        Standard deviation of the ranges of the scanner that sent the last scan [m], estimated from
        neighbouring rays; None before there is enough evidence, and in paper mode.
    pose_offset_s : float, optional
        Delay of the poses of this scanner [s], estimated from static objects; None where it is
        not determined: before the motion of the scanner determines it to 5 ms, for long delays
        (with 10 scans per second often from 80 ms on), for scans that are 0.25 s or more apart, and
        in paper mode. In best mode poses are corrected by a delay that clearly differs from zero.
    no_return : str
        Value of the scanner's driver for a ray without return, learnt from the scans:
        "inf", "zero" or "nan"; always "inf" in paper mode. Ranges at or beyond `range_max` are
        misses, too.
    stuck_poses : int
        Scans with a `CircleFrame.stuck_pose`; more poses may be stuck.
    far_scans : int
        Scans of which half of the ranges are more than 500 m, farther than any 2D LiDAR for robots
        measures: ranges in millimetres.
    """

    received: int = 0
    processed: int = 0
    rejected: int = 0
    reasons: Mapping[str, int] = field(default_factory=dict)
    range_std_estimated: float | None = None
    pose_offset_s: float | None = None
    no_return: str = "inf"
    stuck_poses: int = 0
    far_scans: int = 0

    def one_more(self, name: str, reason: str | None = None) -> Self:
        """Count one more scan as `name`, for a reason if it is rejected."""
        reasons = dict(self.reasons)
        if reason is not None:
            kind = re.sub(r"-?\d+ ns", "... ns", reason.split(", got", maxsplit=1)[0])
            reasons[kind] = reasons.get(kind, 0) + 1
        return replace(self, **{name: getattr(self, name) + 1}, reasons=reasons)
