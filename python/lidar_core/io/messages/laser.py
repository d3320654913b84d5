"""Decoder of 2D scans of drivers: meaning of ranges and times, by REP-117.

Conventions are learnt from the scans of a topic and stated as a verdict; options override them.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_core import _core
from lidar_core.errors import FormatError
from lidar_core.io.files.guard import check_size
from lidar_core.io.messages.conventions import LONGEST_SCAN_S, SHORTEST_SCAN_S
from lidar_core.io.options import ReadOptions
from lidar_core.io.records import Findings
from lidar_core.messages import LaserScan

FULL_TURN = 2 * np.pi * 1.01  # a hundredth more than a turn is the rounding of a driver
NEAR = 0.1
"""Invalid rays beside a range nearer to `range_min` than this may have met it too near [m]."""


class RangeRule:
    """Meaning of the ranges in the scans of one topic."""

    def __init__(self, options: ReadOptions) -> None:
        self._option = options.no_return
        self._misses = _core.Misses()
        self._seen = ""
        self.verdict = "none seen: no range is +inf, zero, or range_max or more"

    def apply(self, scan: LaserScan) -> NDArray[np.float32]:
        """Convert ranges to REP-117: +inf is no return; NaN and -inf are no information.

        A range of `range_max` or more is no return within range; a range below `range_min` is no
        measurement. With the option "auto" zeros, and NaN on rays that have worked, are no return
        as soon as the scans tell so.
        """
        ranges = scan.ranges.astype(np.float32)
        if self._option == "auto":
            return self._learnt(ranges, scan)
        self.verdict = f"{self._option}, set by the option no_return"
        with np.errstate(invalid="ignore"):
            zero = ranges == 0
            far = np.isfinite(ranges) & (ranges > np.float32(scan.range_max))
            if self._option == "max":
                far |= ranges == np.float32(scan.range_max)
            near = np.isfinite(ranges) & ((ranges < scan.range_min) | (ranges <= 0))
        broken = np.isnan(ranges)
        ranges[near] = np.nan
        ranges[far] = np.nan if self._option == "none" else np.inf
        if self._option == "zero":
            ranges[zero] = np.inf
        if self._option == "nan":
            ranges[broken] = np.inf
        return ranges

    def _learnt(self, ranges: NDArray[np.float32], scan: LaserScan) -> NDArray[np.float32]:
        """Convert ranges by the convention that the scans up to this one show."""
        with np.errstate(invalid="ignore"):
            at_limit = np.isfinite(ranges) & (ranges >= np.float32(scan.range_max))
        stated = np.where(at_limit, np.float32(np.inf), ranges)
        marked, name = self._misses.marked(
            stated,
            range_min=scan.range_min,
            range_max=scan.range_max,
            nearest=scan.range_min + NEAR,
        )
        self._tell(name, ranges, at_limit)
        marked[np.isneginf(ranges)] = -np.inf
        return marked.astype(np.float32)

    def _tell(self, learnt: str, ranges: NDArray[np.float32], at_limit: NDArray[np.bool_]) -> None:
        """Store the convention as verdict, with the counts of the scan that first showed it."""
        infinite = np.isposinf(ranges)
        name, rays, text = {
            "zero": ("zero", ranges == 0, "are zero"),
            "nan": ("nan", np.isnan(ranges), "are NaN"),
            "inf": ("inf", infinite, "are +inf")
            if infinite.any()
            else ("max", at_limit, "are range_max or more"),
        }[learnt]
        if rays.any() and name != self._seen and not (name == "max" and self._seen == "inf"):
            self._seen = name
            self.verdict = f"{name}: {int(rays.sum())} of {len(rays)} ranges of a scan {text}"


class LaserDecoder:
    """Converts the recorded scans of one topic to the conventions of `LaserScan`."""

    def __init__(self, topic: str, options: ReadOptions, findings: Findings) -> None:
        self._topic = topic
        self._options = options
        self._findings = findings
        self._ranges = RangeRule(options)

    def scan(self, raw: LaserScan, *, place: str) -> LaserScan:
        """Return `raw` with ranges by REP-117, and without impossible times.

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
        """Return the time from ray to ray that is used [ns], 0 for none, and the reason as text."""
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
