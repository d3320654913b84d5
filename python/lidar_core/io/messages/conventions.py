"""Driver conventions that no format states: rays without return, and the time of each point.

Both are detected on the first scan that shows them, kept for the rest of the topic, and stated
as a verdict; an option overrides each.
"""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_core.errors import FormatError
from lidar_core.io.options import ReadOptions

NS_PER_UNIT = {"s": 1_000_000_000, "ms": 1_000_000, "us": 1_000, "ns": 1}
TIME_FIELDS = (
    "t",
    "time",
    "timestamp",
    "time_stamp",
    "timestamps",
    "stamps",
    "offset_time",
    "time_offset",
    "point_time",
)
SHORTEST_SCAN_S, LONGEST_SCAN_S = 0.002, 1.1  # a factor below 1000: at most one unit fits
FEWEST_SAME, SAME_SHARE = 20, 0.05  # rows of a scan that are its nearest point: a placeholder
NEAR_STAMP_S = 60.0  # an absolute point time lies this close to its scan's stamp


@dataclass(slots=True)
class NoReturnRule:
    """Mark of a ray without return in the clouds of one topic."""

    options: ReadOptions
    convention: str | None = None
    verdict: str = ""

    def apply(self, points: NDArray[np.float32], *, organised: bool) -> NDArray[np.bool_] | None:
        """Set marked and broken rows to NaN; return the mask (N,) of rays without return.

        None if the cloud does not mark such rays.
        """
        x, y, z = points.T  # columns: reducing over an axis of three is five times slower
        finite: NDArray[np.bool_] = np.isfinite(x) & np.isfinite(y) & np.isfinite(z)
        zero: NDArray[np.bool_] = (x == 0) & (y == 0) & (z == 0)
        self._decide(points, zero, ~finite, organised=organised)
        if zero.any() or not finite.all():
            points[zero | ~finite] = np.nan
        if self.convention == "zero":
            return zero
        return ~finite if self.convention == "nan" else None

    def _decide(
        self,
        points: NDArray[np.float32],
        zero: NDArray[np.bool_],
        is_broken: NDArray[np.bool_],
        *,
        organised: bool,
    ) -> None:
        zeros, broken, rows = int(zero.sum()), int(is_broken.sum()), len(points)
        if self.convention is not None or rows == 0:
            return
        if self.options.no_return != "auto":
            self.convention = self.options.no_return
            self.verdict = f"{self.convention}, set by the option no_return"
            if self.convention == "max":
                self.verdict += ": marks nothing in a 3D cloud, only in 2D scans"
        elif zeros:
            self.convention = "zero"
            self.verdict = f"zero: {zeros} of {rows} rows of a scan are zeros"
        elif broken and organised:
            self.convention = "nan"
            self.verdict = f"nan: {broken} of {rows} rows of an organised scan are NaN"
        elif not self.verdict:  # the first scan tells as much as all: placeholders are in each
            self.verdict = _placeholder(points[~is_broken], rows)


def _placeholder(points: NDArray[np.float32], rows: int) -> str:
    """Verdict on a cloud without marks: some recorders write one near point instead of them."""
    nearest = points[np.abs(points).max(axis=1).argmin()] if len(points) else None
    count = 0 if nearest is None else int((points == nearest).all(axis=1).sum())
    if nearest is None or count < max(FEWEST_SAME, SAME_SHARE * rows):
        return "none seen: the driver seems to drop rays without return"
    point = ", ".join(f"{value:g}" for value in nearest)
    return (
        f"none marked: {count} of {rows} rows of a scan are the point ({point}), probably rays"
        " without return; `detect` uses points from sensor.min_range on"
    )


@dataclass(slots=True)
class PointTimeRule:
    """Field, unit and reference of the time of each point, in the clouds of one topic."""

    options: ReadOptions
    rule: tuple[str, str, str] | None = None
    verdict: str = ""
    decided: bool = field(default=False)

    def apply(
        self, fields: dict[str, NDArray[Any]], stamp_ns: int, place: str
    ) -> NDArray[np.int64] | None:
        """Return the absolute time of every point [ns], or None if the recording has none."""
        if not self.decided:
            self._decide(fields, stamp_ns, place)
        if self.rule is None:
            return None
        name, unit, reference = self.rule
        if name not in fields:
            raise FormatError(
                f"{place}: no field {name!r} for the point times, {_field_list(fields)}"
            )
        nanoseconds = _nanoseconds(fields[name], NS_PER_UNIT[unit], place)
        if reference == "absolute" or nanoseconds.size == 0:
            return nanoseconds
        offset = int(nanoseconds.max()) if reference == "end" else 0
        return nanoseconds + np.int64(stamp_ns - offset)

    def _decide(self, fields: dict[str, NDArray[Any]], stamp_ns: int, place: str) -> None:
        choice = self.options.point_time
        if choice == "none":
            self.decided, self.verdict = True, "ignored, set by the option point_time"
            return
        if choice != "auto":
            name, unit, reference = choice.split(":")
            self.rule, self.decided = (name, unit, reference), True
            self.verdict = f"{choice}, set by the option point_time"
            return
        names = [name for name in TIME_FIELDS if name in fields]
        if not names:
            self.decided = True
            self.verdict = "none: the clouds carry no field " + ", ".join(TIME_FIELDS)
            return
        values = fields[names[0]]
        if values.size < 2:
            return  # the next scan may tell more
        self.decided = True
        self._detect(names[0], values.astype(np.float64), stamp_ns)

    def _detect(self, name: str, values: NDArray[np.float64], stamp_ns: int) -> None:
        low, high = float(values.min()), float(values.max())
        what = f"field {name} spans {low:.9g} to {high:.9g}"
        for unit, scale in NS_PER_UNIT.items():
            in_range = SHORTEST_SCAN_S <= (high - low) * scale * 1e-9 <= LONGEST_SCAN_S
            if not in_range:
                continue
            if max(abs(low), abs(high)) * scale * 1e-9 <= 2 * LONGEST_SCAN_S:
                self.rule = (name, unit, "start")
            elif abs(low * scale - stamp_ns) * 1e-9 <= NEAR_STAMP_S:
                self.rule = (name, unit, "absolute")
        if self.rule is None:
            self.verdict = f"ignored: {what}, which fits no unit; state it as field:unit:reference"
        else:
            self.verdict = f"{':'.join(self.rule)} detected: {what}"


def _nanoseconds(values: NDArray[Any], scale: int, place: str) -> NDArray[np.int64]:
    """Convert `values` to nanoseconds: integers exactly, floats rounded."""
    if np.issubdtype(values.dtype, np.integer):
        bound = np.iinfo(np.int64).max // scale
        if values.size and (int(values.max()) > bound or int(values.min()) < -bound):
            raise FormatError(f"{place}: point times exceed the range of int64 [ns]")
        return values.astype(np.int64) * np.int64(scale)
    whole = np.where(np.isfinite(values), values, 0).astype(np.float64)
    if whole.size and np.abs(whole).max() * scale >= 2.0**63:
        raise FormatError(f"{place}: point times exceed the range of int64 [ns]")
    seconds = np.floor(whole)
    rest = np.rint((whole - seconds) * scale)
    return seconds.astype(np.int64) * np.int64(scale) + rest.astype(np.int64)


def _field_list(fields: dict[str, NDArray[Any]]) -> str:
    return "found " + (", ".join(fields) or "none")
