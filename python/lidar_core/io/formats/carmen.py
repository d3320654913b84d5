"""CARMEN logs, plain or packed: one message a line, 2D scans with the odometry they belong to.

Line formats are those that the header of such a log states. Old scans (FLASER, RLASER) carry no
bearings and no limits: bearings follow from the number of readings, as CARMEN's own drivers set
them, and the readings that mean "no return" are those at the limit that the whole log shows.
"""

import bz2
import gzip
import io
import math
from collections import Counter
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidar_core.errors import FormatError, LimitError
from lidar_core.io.files.compressed import check_ratio
from lidar_core.io.files.guard import reading
from lidar_core.io.messages.laser import LaserDecoder
from lidar_core.io.options import ReadOptions
from lidar_core.io.poses.pose_files import stamp_from_text
from lidar_core.io.readers import register_reader
from lidar_core.io.recording import Recording
from lidar_core.io.records import POSE_KINDS, Kind, Record, Topic, decoded
from lidar_core.io.rotations import pose_matrix, quaternion_from_angles
from lidar_core.messages import LaserScan, Message, Pose

ODOM_FRAME, BASE_FRAME = "odom", "base_link"
OLD_SCANS = {"FLASER": "front_laser", "RLASER": "rear_laser"}
KINDS: dict[str, Kind] = {
    "ODOM": "pose",
    **dict.fromkeys(OLD_SCANS, "planar+pose"),
    **{f"ROBOTLASER{number}": "planar+pose" for number in range(5)},
    **{f"RAWLASER{number}": "planar" for number in range(1, 5)},
}
OTHER = ("PARAM", "SYNC", "TRUEPOS", "GPS", "NMEA-GGA", "NMEA-RMC", "IMU", "SONAR", "MARKER")
RANGE_PARAMETERS = ("robot_front_laser_max", "robot_frontlaser_max", "laser_front_laser_max")
LARGEST_RANGE = 80.0  # of the SICK LMS that these logs come from; its codes for failures lie above
NEAREST_LIMIT = 8.0  # of such a scanner when it counts in millimetres
FEWEST_AT_LIMIT = 10  # readings at the greatest value of a log that make it a limit
LAYOUTS = {
    180: (-90.0, 1.0),
    181: (-90.0, 1.0),
    360: (-90.0, 0.5),
    361: (-90.0, 0.5),
    400: (-50.0, 0.25),
    401: (-50.0, 0.25),
}
"""Bearing of the first reading, and between two [deg], by the number of readings."""
LINES_TO_RECOGNISE = 1000
MAX_UNPACKED_BYTES = 4 * 2**30
PACKED = {".bz2": bz2.BZ2File, ".gz": gzip.GzipFile}
"""How packed logs are opened, by the end of their names."""
LATEST_S = 9.2e9  # what int64 [ns] can hold
MOST_KEPT_BYTES = 64 * 2**20
"""Unpacked logs up to this size stay in memory: every pass would unpack them again."""


def _place(path: Path, number: int) -> str:
    return f"{path}, line {number}"


class _Line(NamedTuple):
    """Message of a log: the number of its line, its name, and the words after the name."""

    path: Path
    number: int
    name: str
    words: list[str]

    @property
    def place(self) -> str:
        """Position of the message in the log, for errors."""
        return _place(self.path, self.number)

    def numbers(self, start: int, count: int) -> NDArray[np.float64]:
        """Read numbers `start` to `start + count` after the name."""
        words = self.words[start : start + count]
        try:
            values = np.array(words, np.float64)
        except ValueError:
            raise FormatError(f"{self.place}: {self.name} holds text instead of a number") from None
        if len(words) != count:
            raise FormatError(
                f"{self.place}: {self.name} ends early, {len(self.words)} values follow its name"
            )
        return values

    def count(self, at: int) -> int:
        """Return the number of readings at word `at`, after checking that all of them exist."""
        text = self.words[at] if at < len(self.words) else ""
        if not text.isdecimal() or len(text) > 9 or int(text) > len(self.words):
            raise FormatError(
                f"{self.place}: {self.name} states {text or 'no'!r} readings,"
                f" {len(self.words)} values follow its name"
            )
        return int(text)

    def stamp_ns(self, end: int) -> int:
        """Read the time [ns] from the words after the `end` values of a message."""
        text = self.words[end] if end < len(self.words) else ""
        try:
            seconds = float(text)
        except ValueError:
            (seconds,) = self.numbers(end, 1)  # says what is wrong
        if not abs(seconds) < LATEST_S:
            raise FormatError(f"{self.place}: {self.name} has no time, got {text!r}")
        return stamp_from_text(text)


@register_reader(
    "CARMEN log",
    [f"{name}{packed}" for name in (".clf", ".log") for packed in ("", *PACKED)],
)
class CarmenRecording(Recording):
    """One CARMEN log; one pass finds its topics, a second pass reads its messages."""

    format = "CARMEN log"

    def __init__(self, path: Path, options: ReadOptions) -> None:
        super().__init__(path, options)
        self._counts: Counter[str] = Counter()
        self._range_max = LARGEST_RANGE
        self._first_ns = 0
        self._lasers: dict[str, LaserDecoder] = {}
        self._rejected: set[int] = set()
        self._unpacked: bytes | None = None
        self._survey()

    def topics(self) -> list[Topic]:
        """Streams of the log, by the names of its messages."""
        return [
            Topic(name, f"CARMEN {name}", KINDS.get(name, "other"), count)
            for name, count in sorted(self._counts.items())
        ]

    def records(self, kinds: frozenset[str] | None = None) -> Iterator[Record]:
        """Yield messages in the order of the log; one without a time gets the time before it."""
        for topic, line, parts, stamp_ns in self._timed(kinds):
            decode: Callable[[], list[Message]] = decoded()
            if parts is not None:
                decode = partial(self._decode, line, parts, stamp_ns)
            yield Record(topic, stamp_ns, decode)

    def poses(self) -> Iterator[tuple[Topic, Pose]]:
        """Yield only the poses; the readings of their lines are not decoded."""
        for topic, line, parts, stamp_ns in self._timed(POSE_KINDS):
            if parts is None or line.number in self._rejected:
                continue
            try:
                pose = _pose(line, parts, stamp_ns)
            except FormatError as error:
                self._reject(line, error)
                continue
            if pose is not None:
                yield topic, pose

    def _timed(
        self, kinds: frozenset[str] | None
    ) -> Iterator[tuple[Topic, _Line, "_Parts | None", int]]:
        """Yield messages with topic, parts and time [ns]; parts are None for kinds not read."""
        topics = {
            topic.name: topic for topic in self.topics() if kinds is None or topic.kind in kinds
        }
        last_ns = self._first_ns
        for line in self._lines():
            topic = topics.get(line.name)
            if topic is None:
                continue
            parts = None
            if topic.kind != "other":
                try:
                    parts = _parts(line)
                    last_ns = line.stamp_ns(parts.end)
                except FormatError:  # counted by the survey
                    continue
            yield topic, line, parts, last_ns

    def _reject(self, line: _Line, error: FormatError) -> None:
        """Count an unreadable line once, and note the first one of its name."""
        if line.number in self._rejected:
            return
        self._rejected.add(line.number)
        self.findings.rejected[line.name] += 1
        if self.findings.rejected[line.name] == 1:
            self.findings.note(f"left out: {error}")

    def _decode(self, line: _Line, parts: "_Parts", stamp_ns: int) -> list[Message]:
        try:
            return self._messages(line, parts, stamp_ns)
        except FormatError as error:
            self._reject(line, error)
            return []

    def _messages(self, line: _Line, parts: "_Parts", stamp_ns: int) -> list[Message]:
        pose = _pose(line, parts, stamp_ns)
        messages: list[Message] = [] if pose is None else [pose]
        if parts.readings_at is not None:
            if line.name not in self._lasers:
                self._lasers[line.name] = LaserDecoder(line.name, self.options, self.findings)
            raw = self._raw(line, parts, stamp_ns)
            messages.append(self._lasers[line.name].scan(raw, place=line.place))
        return messages

    def _raw(self, line: _Line, parts: "_Parts", stamp_ns: int) -> LaserScan:
        ranges = line.numbers(parts.readings_at or 0, parts.readings).astype(np.float32)
        start, step, limit = _layout(line, parts)
        return LaserScan(
            stamp_ns=stamp_ns,
            ranges=ranges,
            angle_min=start,
            angle_increment=step,
            range_min=0.0,
            range_max=limit or self._range_max,
            frame_id=parts.frame,
            topic=line.name,
        )

    def _survey(self) -> None:
        """Count the messages, and find the limit of the readings that state none."""
        readings: Counter[float] = Counter()
        stated: list[float] = []
        for number, line in enumerate(self._lines()):
            try:
                self._count(line, readings, stated)
            except FormatError as error:
                self._reject(line, error)
            if number == LINES_TO_RECOGNISE and not self._counts and not self._rejected:
                break
        if not self._counts.keys() & KINDS.keys():
            found = f"found none of {', '.join(KINDS)}"
            raise FormatError(
                "; ".join(self.findings.notes) or f"{self.path}: not a CARMEN log: {found}"
            )
        greatest = max(readings, default=0.0)
        if greatest >= NEAREST_LIMIT and readings[greatest] >= FEWEST_AT_LIMIT:
            stated.append(greatest)
        self._range_max = min([value for value in stated if value > 0] + [LARGEST_RANGE])

    def _count(self, line: _Line, readings: Counter[float], stated: list[float]) -> None:
        """Count a message and its evidence about the largest valid reading."""
        values = line.numbers(1, line.count(0)) if line.name in OLD_SCANS else np.empty(0)
        if line.name in KINDS:
            stamp_ns = line.stamp_ns(_parts(line).end)
            if not self._counts.keys() & KINDS.keys():
                self._first_ns = stamp_ns
        if line.name == "PARAM" and line.words[:1] and line.words[0] in RANGE_PARAMETERS:
            stated.append(float(line.numbers(1, 1)[0]))
        if line.name in KINDS or line.name in OTHER:
            self._counts[line.name] += 1
        greatest = values.max(initial=0.0)
        if found := np.count_nonzero(values == greatest):
            readings[float(greatest)] += int(found)

    def _lines(self) -> Iterator[_Line]:
        """Yield messages with the numbers of their lines, without comments and empty lines."""
        for number, text in enumerate(self._texts(), 1):
            words = text.decode("ascii", "replace").split()
            if words and not words[0].startswith("#"):
                yield _Line(self.path, number, words[0], words[1:])

    def _texts(self) -> Iterator[bytes]:
        """Yield the lines of the log; a packed log of moderate size is unpacked only once."""
        if self._unpacked is not None:
            yield from io.BytesIO(self._unpacked)
            return
        packed = PACKED.get(self.path.suffix.lower())
        limit, total, size = self.options.max_record_bytes, 0, self.path.stat().st_size
        kept = io.BytesIO()
        with self.path.open("rb") if packed is None else packed(self.path) as stream:
            for number in range(1, 2**62):
                place = _place(self.path, number)
                with reading(place):
                    text = stream.readline(limit + 1)
                if not text:
                    break
                total += len(text)
                if len(text) > limit:
                    raise LimitError(
                        f"{place}: a line of more than {limit} bytes; raise it with"
                        " max_record_bytes"
                    )
                if total > MAX_UNPACKED_BYTES:
                    raise LimitError(f"{place}: unpacks to more than {MAX_UNPACKED_BYTES} bytes")
                if packed is not None:
                    check_ratio(total, size, place)
                    if total <= MOST_KEPT_BYTES:
                        kept.write(text)
                yield text
        if packed is not None and total <= MOST_KEPT_BYTES:
            self._unpacked = kept.getvalue()


class _Parts(NamedTuple):
    """Positions of readings, pose and time among the words of a message."""

    frame: str
    readings_at: int | None
    readings: int
    pose_at: int | None
    end: int


def _pose(line: _Line, parts: _Parts, stamp_ns: int) -> Pose | None:
    """Pose of a message; None if it holds none."""
    if parts.pose_at is None:
        return None
    x, y, angle = line.numbers(parts.pose_at, 3).tolist()
    if not (math.isfinite(x) and math.isfinite(y) and math.isfinite(angle)):
        raise FormatError(f"{line.place}: pose {x} {y} {angle} is not finite")
    matrix = pose_matrix(np.array([x, y, 0.0]), quaternion_from_angles(0.0, 0.0, angle))
    return Pose(stamp_ns, ODOM_FRAME, parts.frame, matrix, topic=line.name)


def _parts(line: _Line) -> _Parts:
    name = line.name
    if name == "ODOM":
        return _Parts(BASE_FRAME, None, 0, 0, 6)
    if name in OLD_SCANS:
        count = line.count(0)
        return _Parts(OLD_SCANS[name], 1, count, 1 + count, 7 + count)
    count = line.count(7)
    remissions = line.count(8 + count)
    after = 9 + count + remissions
    frame = f"laser_{name[-1]}"
    if name.startswith("RAW"):
        return _Parts(frame, 8, count, None, after)
    return _Parts(frame, 8, count, after, after + 11)


def _layout(line: _Line, parts: _Parts) -> tuple[float, float, float | None]:
    """First bearing and bearing step of a scan [rad]; its range limit [m], None if not stated."""
    if line.name in OLD_SCANS:
        few = max(parts.readings - 1, 1)
        start, step = LAYOUTS.get(parts.readings, (-90.0, 180.0 / few))
        return math.radians(start), math.radians(step), None
    _, start, _, step, limit = line.numbers(0, 5).tolist()
    return start, step, limit
