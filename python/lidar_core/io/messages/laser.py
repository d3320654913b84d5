"""2D scans of drivers: the meaning of ranges and times, by REP-117.

Conventions are detected on the first scan that shows them, kept for the rest of the topic, and
stated as a verdict; options override them.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_core.errors import FormatError
from lidar_core.io.files.guard import check_size
from lidar_core.io.messages.conventions import LONGEST_SCAN_S, SHORTEST_SCAN_S
from lidar_core.io.options import ReadOptions
from lidar_core.io.records import Findings
from lidar_core.messages import LaserScan

FULL_TURN = 2 * np.pi * 1.01  # a hundredth more than a turn is the rounding of a driver


@dataclass(slots=True)
class RangeRule:
    """Mark of a ray without return in the scans of one topic."""

    options: ReadOptions
    convention: str | None = None
    verdict: str = ""

    def apply(self, scan: LaserScan) -> NDArray[np.float32]:
        """Convert ranges of REP-117: +inf is no return; NaN and -inf are no information.

        A range above `range_max` is no return within range; a range below `range_min` is no
        measurement.
        """
        ranges = scan.ranges.astype(np.float32)
        with np.errstate(invalid="ignore"):
            zero, infinite = ranges == 0, np.isposinf(ranges)
            far = np.isfinite(ranges) & (ranges >= np.float32(scan.range_max))
            near = np.isfinite(ranges) & ((ranges < scan.range_min) | (ranges <= 0))
        self._decide(zero, infinite, far)
        broken = np.isnan(ranges)
        if self.convention != "max":
            far &= ranges > np.float32(scan.range_max)
        ranges[near] = np.nan
        ranges[far] = np.nan if self.convention == "none" else np.inf
        if self.convention == "zero":
            ranges[zero] = np.inf
        if self.convention == "nan":
            ranges[broken] = np.inf
        return ranges

    def _decide(
        self, zero: NDArray[np.bool_], infinite: NDArray[np.bool_], far: NDArray[np.bool_]
    ) -> None:
        if self.convention is not None:
            return
        if self.options.no_return != "auto":
            self.convention = self.options.no_return
            self.verdict = f"{self.convention}, set by the option no_return"
            return
        seen = (
            ("inf", infinite, "are +inf"),
            ("zero", zero, "are zero"),
            ("max", far, "are range_max or more"),
        )
        for name, mask, text in seen:
            if mask.any():
                self.convention = name
                self.verdict = f"{name}: {int(mask.sum())} of {len(mask)} ranges of a scan {text}"
                return
        self.verdict = "none seen: no range is +inf, zero, or range_max or more"


class LaserDecoder:
    """Converts the recorded scans of one topic to the conventions of `LaserScan`."""

    def __init__(self, topic: str, options: ReadOptions, findings: Findings) -> None:
        self._topic = topic
        self._options = options
        self._findings = findings
        self._ranges = RangeRule(options)

    def scan(self, raw: LaserScan, *, place: str) -> LaserScan:
        """`raw` with its ranges by REP-117, and without times that cannot be.

        Raises
        ------
        FormatError
            Bearings or limits that no scanner has.
        LimitError
            More rays than the options allow.
        """
        rays = len(raw.ranges)
        check_size(
            place, rays, limit=self._options.max_points, key="max_points", what="a scan of rays"
        )
        _check(raw, place)
        ranges = self._ranges.apply(raw)
        increment, self._findings.point_time[self._topic] = self._increment(raw)
        self._findings.no_return[self._topic] = self._ranges.verdict
        intensity = raw.intensity
        if intensity is not None and len(intensity) != rays:
            self._findings.note(f"{self._topic}: intensities left out, not one per ray")
            intensity = None
        return replace(raw, ranges=ranges, intensity=intensity, time_increment_ns=increment)

    def _increment(self, raw: LaserScan) -> tuple[int, str]:
        """Time from ray to ray [ns] that is used, and why."""
        step = raw.time_increment_ns
        sweep = abs(step) * (len(raw.ranges) - 1) * 1e-9
        if self._options.point_time == "none":
            return 0, "ignored, set by the option point_time"
        if step == 0:
            return 0, "none: time_increment is zero"
        what = f"time_increment of {step} ns, a sweep of {1e3 * sweep:.3g} ms"
        if step < 0 or not SHORTEST_SCAN_S <= sweep <= LONGEST_SCAN_S:
            return 0, f"ignored: {what}, which no scanner takes"
        return step, what


def ros_laser_scan(topic: str, message: Any, stamp_ns: int, frame_id: str) -> LaserScan:
    """Recorded values of a LaserScan or, its first echoes, a MultiEchoLaserScan message."""
    return LaserScan(
        stamp_ns=stamp_ns,
        ranges=_first_echoes(message.ranges),
        angle_min=float(message.angle_min),
        angle_increment=float(message.angle_increment),
        range_min=float(message.range_min),
        range_max=float(message.range_max),
        frame_id=frame_id,
        intensity=_first_echoes(message.intensities) if len(message.intensities) else None,
        time_increment_ns=_nanoseconds(message.time_increment),
        topic=topic,
    )


def _first_echoes(values: Sequence[Any]) -> NDArray[np.float32]:
    """One number per ray; zero for a ray without any echo."""
    if len(values) and hasattr(values[0], "echoes"):
        return np.array(
            [item.echoes[0] if len(item.echoes) else 0.0 for item in values], np.float32
        )
    return np.asarray(values, np.float32)


def _nanoseconds(seconds: float) -> int:
    return round(seconds * 1e9) if abs(seconds) < LONGEST_SCAN_S else 0


def _check(raw: LaserScan, place: str) -> None:
    angles = (raw.angle_min, raw.angle_increment)
    span = abs(raw.angle_increment) * len(raw.ranges)
    if not np.isfinite(angles).all() or raw.angle_increment == 0 or span > FULL_TURN:
        raise FormatError(
            f"{place}: {len(raw.ranges)} rays from {raw.angle_min} by {raw.angle_increment} rad:"
            " expected finite angles, an increment other than 0 and at most one turn"
        )
    if not 0 <= raw.range_min < raw.range_max:
        raise FormatError(
            f"{place}: expected 0 <= range_min < range_max, got {raw.range_min}, {raw.range_max}"
        )
