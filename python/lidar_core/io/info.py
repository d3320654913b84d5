"""What is in a recording: topics, rates, frames, time span, conventions, defects."""

import statistics
import warnings
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_core.errors import LidarCoreError, PoseFrameWarning
from lidar_core.io.pose_frames import MOST_SCANS
from lidar_core.io.posed import posed_scans
from lidar_core.io.recording import SCAN_KINDS, Record, Recording, Topic
from lidar_core.io.scan_topics import NAMELESS
from lidar_core.messages import LaserScan, Message, Pose, Scan

SCANS_DECODED = 10  # per topic: clouds are costly, and conventions show early
GAP_FACTOR, FEWEST_FOR_GAPS = 3.0, 5


@dataclass(frozen=True, slots=True)
class TopicInfo:
    """One stream of a recording.

    Attributes
    ----------
    name, type, kind, note : str
        As in `Topic`.
    count : int
        Stored messages.
    rate_hz : float or None
        Messages per second [Hz].
    frames : tuple of str
        Frames that its scans or poses name.
    rays, points : int or None
        Most entries of a decoded scan, and most of them that are points.
    start_ns, end_ns : int or None
        First and last time [ns].
    """

    name: str
    type: str
    kind: str
    count: int
    rate_hz: float | None
    frames: tuple[str, ...]
    rays: int | None
    points: int | None
    start_ns: int | None
    end_ns: int | None
    note: str


@dataclass(frozen=True, slots=True)
class RecordingInfo:
    """Summary of a recording.

    Attributes
    ----------
    path, format : str
        File or folder, and its format.
    topics : tuple of TopicInfo
        By name.
    start_ns, end_ns : int or None
        First and last time of any message [ns].
    transforms : tuple of (parent, child, is_static)
        Edges of the transform tree, poses of odometry included.
    point_time, no_return : dict
        Verdict per topic of scans.
    defects : tuple of str
        What is wrong or missing, and what was assumed.
    """

    path: str
    format: str
    topics: tuple[TopicInfo, ...]
    start_ns: int | None
    end_ns: int | None
    transforms: tuple[tuple[str, str, bool], ...]
    point_time: dict[str, str]
    no_return: dict[str, str]
    defects: tuple[str, ...]

    @property
    def duration_s(self) -> float:
        """Time from the first to the last message [s]."""
        if self.start_ns is None or self.end_ns is None:
            return 0.0
        return (self.end_ns - self.start_ns) * 1e-9

    def to_dict(self) -> dict[str, Any]:
        """Everything as plain values, ready for JSON."""
        return asdict(self) | {"duration_s": self.duration_s}


@dataclass(slots=True)
class _Stream:
    """What the messages of one topic showed."""

    topic: Topic
    times: list[int] = field(default_factory=list)
    stamps: list[int] = field(default_factory=list)
    frames: dict[str, None] = field(default_factory=dict)
    rays: int | None = None
    points: int | None = None
    empty: int = 0

    @property
    def name(self) -> str:
        """Of its topic, in words where it has none."""
        return self.topic.name or NAMELESS

    def see(self, record: Record, messages: list[Message]) -> None:
        self.times.append(record.time_ns)
        for message in messages:
            if isinstance(message, Scan | LaserScan):
                has_point = _has_point(message)
                points = int(has_point.sum())
                self.rays = max(self.rays or 0, len(has_point))
                self.points = max(self.points or 0, points)
                self.empty += points == 0
                self.stamps.append(message.stamp_ns)
                self.frames[message.frame_id] = None
            elif self.topic.kind == "pose":
                self.frames[message.frame_id] = None

    def info(self) -> TopicInfo:
        span = (max(self.times) - min(self.times)) * 1e-9 if self.times else 0.0
        rate = (len(self.times) - 1) / span if span > 0 else None
        topic = self.topic
        return TopicInfo(
            topic.name, topic.type, topic.kind, len(self.times), rate, tuple(self.frames),
            self.rays, self.points, min(self.times, default=None), max(self.times, default=None),
            topic.note,
        )  # fmt: skip

    def defects(self) -> list[str]:
        """Times that jump, and empty scans."""
        name, found = self.name, []
        if self.topic.note and self.topic.kind != "scan":
            found.append(f"{name}: {self.topic.note}")
        if self.topic.count == 0:
            found.append(f"{name}: no messages")
        for what, values in (("recording times", self.times), ("stamps", self.stamps)):
            steps = [b - a for a, b in pairwise(values)]
            back = sum(step < 0 for step in steps)
            if back:
                found.append(f"{name}: {what} go backwards {back} times")
            if what == "stamps" and any(step == 0 for step in steps):
                found.append(f"{name}: {sum(s == 0 for s in steps)} stamps repeat the one before")
        found += self._gaps()
        if self.empty:
            found.append(f"{name}: {self.empty} scans without points")
        return found

    def _gaps(self) -> list[str]:
        if len(self.times) < FEWEST_FOR_GAPS or self.topic.kind not in SCAN_KINDS:
            return []
        ordered = sorted(self.times)
        steps = [b - a for a, b in pairwise(ordered)]
        usual = statistics.median(steps)
        gaps = [step for step in steps if usual > 0 and step > GAP_FACTOR * usual]
        if not gaps:
            return []
        return [f"{self.name}: {len(gaps)} gaps, the longest of {max(gaps) * 1e-9:.3g} s"]


def _has_point(scan: Scan | LaserScan) -> NDArray[np.bool_]:
    if isinstance(scan, LaserScan):
        return np.isfinite(scan.ranges)
    x, y, z = scan.points.reshape(-1, 3).T
    return np.isfinite(x) & np.isfinite(y) & np.isfinite(z)


def inspect(recording: Recording) -> RecordingInfo:
    """Read a recording through, decoding its poses and the first scans of each topic."""
    streams = {_key(topic): _Stream(topic) for topic in recording.topics()}
    edges: dict[tuple[str, str], bool] = {}
    for record in recording.records():
        stream = streams.setdefault(_key(record.topic), _Stream(record.topic))
        messages: list[Message] = []
        if record.topic.kind == "pose" or len(stream.stamps) < SCANS_DECODED:
            messages = record.decode()
        stream.see(record, messages)
        edges |= {
            (message.frame_id, message.child_frame_id): message.is_static
            for message in messages
            if isinstance(message, Pose)
        }
    if any(not is_static for is_static in edges.values()):
        _check_pose_frames(recording)
    infos = tuple(streams[name].info() for name in sorted(streams))
    found = recording.noticed()
    times = [t for info in infos for t in (info.start_ns, info.end_ns) if t is not None]
    return RecordingInfo(
        path=str(recording.path),
        format=recording.format,
        topics=infos,
        start_ns=min(times, default=None),
        end_ns=max(times, default=None),
        transforms=tuple((*edge, static) for edge, static in sorted(edges.items())),
        point_time=dict(found.point_time),
        no_return=dict(found.no_return),
        defects=tuple(_defects(recording, streams, edges)),
    )


def _check_pose_frames(recording: Recording) -> None:
    """Let the first scans say whether the poses are in their frame; it becomes a note."""
    with suppress(LidarCoreError), warnings.catch_warnings():
        warnings.simplefilter("ignore", PoseFrameWarning)
        for number, _ in enumerate(posed_scans(recording)):
            if number == MOST_SCANS:
                break


def _key(topic: Topic) -> tuple[str, str]:
    """What tells streams apart: scans and poses without topics have one name, too."""
    return topic.name, topic.kind


def _defects(
    recording: Recording,
    streams: dict[tuple[str, str], _Stream],
    edges: dict[tuple[str, str], bool],
) -> list[str]:
    found = [text for name in sorted(streams) for text in streams[name].defects()]
    noticed = recording.noticed()
    found += [f"{topic}: {count} messages rejected" for topic, count in noticed.rejected.items()]
    found += noticed.notes
    scans = [s for s in streams.values() if s.topic.kind in SCAN_KINDS]
    if not scans:
        measured = any(stream.topic.kind == "measurement" for stream in streams.values())
        found.append("no scans; measurements are for `lidar-core fuse`" if measured
                     else "no topic with scans that can be read")  # fmt: skip
    elif not any(not static for static in edges.values()):
        found.append("no poses: use --pose FILE, or --pose static for a sensor that does not move")
    children = {child for _, child in edges} | {parent for parent, _ in edges}
    found += [
        f"{stream.name}: no transform names its frame {frame!r}"
        for stream in scans
        for frame in stream.frames
        if edges and frame not in children and "" not in children
    ]
    return found
