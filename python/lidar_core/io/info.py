"""Content of a recording: topics, rates, frames, time span, conventions, defects."""

import statistics
import warnings
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from itertools import accumulate, pairwise
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from lidar_core.errors import LidarCoreError, PoseFrameWarning
from lidar_core.io.poses.leaps import MovingTransforms
from lidar_core.io.poses.pose_frames import MOST_SCANS
from lidar_core.io.poses.posed import posed_scans
from lidar_core.io.records import SCAN_KINDS, Record, Topic
from lidar_core.io.scan_topics import NAMELESS, WORDS
from lidar_core.io.stamp_unit import stamp_unit_note
from lidar_core.messages import LaserScan, Message, Pose, Scan
from lidar_core.sensors import LONGEST_2D, LONGEST_3D, far_median, far_text

if TYPE_CHECKING:
    from lidar_core.io.recording import Recording

FEWEST_DECODED = 10
"""Scans per topic that are decoded, whatever they cost: conventions show early."""
EFFORT, EFFORT_PER_SCAN = 12_000_000, 2_500
"""Points and rays that are decoded in all, below two seconds; what a scan costs beside these."""
GAP_FACTOR, FEWEST_FOR_GAPS = 3.0, 5


@dataclass(frozen=True, slots=True)
class TopicInfo:
    """One stream of a recording.

    Attributes
    ----------
    name, type, kind, note : str
        Properties of the topic, as in `Topic`.
    count : int
        Stored messages.
    rate_hz : float or None
        Messages per second [Hz].
    frames : tuple of str
        Frames that its scans or poses name.
    rays, points : int or None
        Largest number of entries of a decoded scan, and largest number of them that are points.
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
        Topics by name.
    start_ns, end_ns : int or None
        First and last time of any message [ns].
    transforms : tuple of (parent, child, is_static)
        Edges of the transform tree, poses of odometry included.
    point_time, no_return : dict
        Verdict per topic of scans.
    defects : tuple of str
        Defects, missing parts, and assumptions that were made.
    looked_at : dict
        Scans that were decoded, and all of them, per topic of which not all were: large
        recordings are not read to their end.
    stamps : dict
        Suggested value of `ReadOptions.stamps` per topic, if most scans would be rejected for their
        stamps.
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
    looked_at: dict[str, tuple[int, int]] = field(default_factory=dict)
    stamps: dict[str, Literal["recorded", "counted"]] = field(default_factory=dict)

    @property
    def duration_s(self) -> float:
        """Time from the first to the last message [s]."""
        if self.start_ns is None or self.end_ns is None:
            return 0.0
        return (self.end_ns - self.start_ns) * 1e-9

    def to_dict(self) -> dict[str, Any]:
        """Return the summary as plain values, ready for JSON."""
        return asdict(self) | {"duration_s": self.duration_s}


def info_of(values: dict[str, Any]) -> RecordingInfo:
    """Return the summary whose `RecordingInfo.to_dict` gave these values, maybe through JSON."""
    given = {name: value for name, value in values.items() if name != "duration_s"}
    topics = [TopicInfo(**one | {"frames": tuple(one["frames"])}) for one in given["topics"]]
    return RecordingInfo(
        **given
        | {
            "topics": tuple(topics),
            "transforms": tuple(tuple(one) for one in given["transforms"]),
            "defects": tuple(given["defects"]),
            "looked_at": {name: tuple(pair) for name, pair in given["looked_at"].items()},
        }
    )


@dataclass(slots=True)
class _Stream:
    """Statistics of the messages of one topic."""

    topic: Topic
    times: list[int] = field(default_factory=list)
    stamps: list[int] = field(default_factory=list)
    frames: dict[str, None] = field(default_factory=dict)
    rays: int | None = None
    points: int | None = None
    empty: int = 0
    far: list[float] = field(default_factory=list)
    decoded: int = 0
    effort: int = 0

    @property
    def name(self) -> str:
        """Name of the topic, or a description if it has none."""
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
                self.far += _far(message)
                self.stamps.append(message.stamp_ns)
                self.effort += EFFORT_PER_SCAN + len(has_point)
                self.frames[message.frame_id] = None
            elif self.topic.kind == "pose":
                self.frames[message.frame_id] = None

    def info(self) -> TopicInfo:
        span = (max(self.times) - min(self.times)) * 1e-9 if self.times else 0.0
        rate = (len(self.times) - 1) / span if span > 0 else None
        topic = self.topic
        return TopicInfo(
            topic.name,
            topic.type,
            topic.kind,
            len(self.times),
            rate,
            tuple(self.frames),
            self.rays,
            self.points,
            min(self.times, default=None),
            max(self.times, default=None),
            topic.note,
        )

    def defects(self) -> list[str]:
        """Texts about defects: no messages, jumping times, gaps, empty scans, impossible ranges."""
        name, found = self.name, []
        if self.topic.note and self.topic.kind != "scan":
            found.append(f"{name}: {self.topic.note}")
        if self.topic.count == 0:
            found.append(f"{name}: no messages")
        back = sum(b < a for a, b in pairwise(self.times))
        if back and self.times != self.stamps:
            found.append(f"{name}: recording times go backwards {back} times")
        found += self._stamp_defects()
        found += self._gaps()
        if self.empty:
            found.append(f"{name}: {self.empty} scans without points")
        if 2 * len(self.far) > len(self.stamps) - self.empty:
            is_planar = self.topic.kind in WORDS[LaserScan].kinds
            found.append(f"{name}: {far_text(statistics.median(self.far), is_planar=is_planar)}")
        return found

    def _stamp_defects(self) -> list[str]:
        """Count stamps for which scans are rejected, and name the remedy."""
        steps = [b - a for a, b in pairwise(self.stamps)]
        zero, total = self.stamps.count(0), len(self.stamps)
        repeated, back = sum(step == 0 for step in steps), sum(step < 0 for step in steps)
        cure = f'; stamps="{self.other_times}" gives others'
        if total > 1 and zero == total:
            return [f"{self.name}: all {total} stamps are 0{cure}"]
        found = []
        if zero > 1:
            found.append(f"{self.name}: {zero} of {total} stamps are 0{cure}")
        if repeated:
            found.append(f"{self.name}: {repeated} of {total} stamps repeat the one before{cure}")
        if back:
            found.append(f"{self.name}: {back} of {total} stamps go backwards{cure}")
        unit = stamp_unit_note(self.stamps)
        return found if unit is None else [*found, f"{self.name}: {unit}"]

    @property
    def other_times(self) -> Literal["recorded", "counted"]:
        """Better times than the stamps: "recorded" if these increase more often, else "counted"."""
        times = self.times[: len(self.stamps)]
        return "recorded" if _late(times) < _late(self.stamps) else "counted"

    @property
    def wants_other_times(self) -> bool:
        """Return whether more than half of the scans have stamps that are rejected as late."""
        return 2 * _late(self.stamps) > len(self.stamps)

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


def _late(times: list[int]) -> int:
    """Count the stamps that are not newer than all earlier ones."""
    newest = accumulate(times, max)
    return sum(time <= before for before, time in zip(newest, times[1:], strict=False))


def _far(scan: Scan | LaserScan) -> list[float]:
    """Median range [m] as a list of one value if no LiDAR measures so far; else an empty list."""
    if isinstance(scan, LaserScan):
        far = far_median(scan.ranges, LONGEST_2D)
    else:
        far = far_median(scan.points.reshape(-1, 3), LONGEST_3D)
    return [] if far is None else [far]


def _has_point(scan: Scan | LaserScan) -> NDArray[np.bool_]:
    if isinstance(scan, LaserScan):
        return np.isfinite(scan.ranges)
    x, y, z = scan.points.reshape(-1, 3).T
    return np.isfinite(x) & np.isfinite(y) & np.isfinite(z)


def inspect(recording: "Recording") -> RecordingInfo:
    """Read a whole recording; decode its poses, and as many scans as is fast."""
    streams = {_key(topic): _Stream(topic) for topic in recording.topics()}
    edges: dict[tuple[str, str], bool] = {}
    moving = MovingTransforms()
    for record in recording.records():
        stream = streams.setdefault(_key(record.topic), _Stream(record.topic))
        messages: list[Message] = []
        is_quick = sum(one.effort for one in streams.values()) < EFFORT
        if record.topic.kind == "pose" or is_quick or stream.decoded < FEWEST_DECODED:
            messages = record.decode()
            stream.decoded += 1
        stream.see(record, messages)
        poses = [message for message in messages if isinstance(message, Pose)]
        edges |= {(pose.frame_id, pose.child_frame_id): pose.is_static for pose in poses}
        moving.add(record.topic, poses)
    rejected = dict(recording.noticed().rejected)
    if any(not is_static for is_static in edges.values()):
        _check_pose_frames(recording)  # reads again, and counts what is rejected again
    for text in moving.notes():
        recording.findings.note(text)
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
        defects=tuple(_defects(recording, streams, edges, rejected)),
        looked_at=_looked_at(streams.values()),
        stamps={
            stream.topic.name: stream.other_times
            for stream in streams.values()
            if stream.wants_other_times
        },
    )


def _looked_at(streams: Iterable[_Stream]) -> dict[str, tuple[int, int]]:
    """Decoded scans and all scans of the streams that were not decoded to their end."""
    return {
        stream.name: (stream.decoded, len(stream.times))
        for stream in streams
        if stream.decoded < len(stream.times) and stream.topic.kind in SCAN_KINDS
    }


def _check_pose_frames(recording: "Recording") -> None:
    """Check with the first scans whether the poses are in the stated frame; add a note if not."""
    with suppress(LidarCoreError), warnings.catch_warnings():
        warnings.simplefilter("ignore", PoseFrameWarning)
        for number, _ in enumerate(posed_scans(recording)):
            if number == MOST_SCANS:
                break


def _key(topic: Topic) -> tuple[str, str]:
    """Key of a stream: name and kind, because scans and poses without a topic share a name."""
    return topic.name, topic.kind


def _defects(
    recording: "Recording",
    streams: dict[tuple[str, str], _Stream],
    edges: dict[tuple[str, str], bool],
    rejected: dict[str, int],
) -> list[str]:
    found = [text for name in sorted(streams) for text in streams[name].defects()]
    noticed = recording.noticed()
    found += [f"{topic}: {count} messages rejected" for topic, count in rejected.items()]
    found += noticed.notes
    scans = [s for s in streams.values() if s.topic.kind in SCAN_KINDS]
    if not scans:
        measured = any(stream.topic.kind == "measurement" for stream in streams.values())
        found.append(
            "no scans; measurements are for `lidar-core fuse`"
            if measured
            else "no topic with scans that can be read"
        )
    elif not any(not static for static in edges.values()):
        found.append('no poses: use pose=FILE, or pose="static" for a sensor that does not move')
    children = {child for _, child in edges} | {parent for parent, _ in edges}
    found += [
        f"{stream.name}: no transform names its frame {frame!r}"
        for stream in scans
        for frame in stream.frames
        if edges and frame not in children and "" not in children
    ]
    return found
