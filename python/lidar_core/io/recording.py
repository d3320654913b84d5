"""A recording: records in time order, decoded to messages when asked for."""

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, Self, TypeAlias

from lidar_core.io.options import ReadOptions
from lidar_core.messages import Message, Pose

Kind: TypeAlias = Literal[
    "scan", "planar", "pose", "scan+pose", "planar+pose", "measurement", "packets", "other"
]

PACKETS: dict[str, str] = {
    "velodyne_msgs/msg/VelodyneScan": "Velodyne packets",
    "ouster_msgs/msg/PacketMsg": "Ouster packets: readable where ouster-sdk is installed",
    "ouster_ros/msg/PacketMsg": "Ouster packets: readable where ouster-sdk is installed",
    "ouster_sensor_msgs/msg/PacketMsg": "Ouster packets: readable where ouster-sdk is installed",
    "pandar_msgs/msg/PandarScan": "Hesai packets: no library decodes them; record the"
    " driver's PointCloud2",
    "nebula_msgs/msg/NebulaPackets": "Nebula packets: no library decodes them; record the"
    " driver's PointCloud2",
}
"""Message types that hold raw sensor packets, and what to say about them."""

POSE_KINDS = frozenset({"pose", "scan+pose", "planar+pose"})
SCAN_KINDS = frozenset({"scan", "scan+pose", "planar", "planar+pose"})
"""Kinds of topics that bring poses, and of those that bring scans: in 3D, or planar in 2D."""
UNREAD_KINDS = frozenset({"measurement", "packets", "other"})
"""Kinds whose messages are neither: measurements are for `lidar_core.fusion`."""
MOST_NOTES = 1000
DAY_NS = 86_400 * 10**9


@dataclass(frozen=True, slots=True)
class Topic:
    """One stream of a recording.

    Attributes
    ----------
    name, type : str
        As the recording names them.
    kind : str
        What a reader makes of it.
    count : int or None
        Messages, where the recording states it.
    note : str
        Why it is not read, or what was assumed.
    """

    name: str
    type: str
    kind: Kind
    count: int | None = None
    note: str = ""


@dataclass(frozen=True, slots=True)
class Record:
    """One stored message.

    Attributes
    ----------
    topic : Topic
        Stream it belongs to.
    time_ns : int
        When it was stored [ns].
    decode : callable
        Its messages; none for a record that no reader understands or that was rejected.
    parse : callable, optional
        The message as its ROS type says, where it has one.
    """

    topic: Topic
    time_ns: int
    decode: Callable[[], list[Message]]
    parse: Callable[[], Any] | None = None


@dataclass(slots=True)
class Findings:
    """What a reader noticed on the way: conventions it detected, messages it left out."""

    point_time: dict[str, str] = field(default_factory=dict)
    no_return: dict[str, str] = field(default_factory=dict)
    rejected: Counter[str] = field(default_factory=Counter)
    notes: list[str] = field(default_factory=list)

    def note(self, text: str) -> None:
        """Keep `text` once, and no more texts than anybody reads."""
        if len(self.notes) < MOST_NOTES and text not in self.notes:
            self.notes.append(text)


def decoded(*messages: Message) -> Callable[[], list[Message]]:
    """`Record.decode` of a reader that has the messages at hand."""
    return lambda: list(messages)


class Recording(ABC):
    """A recording that is open for reading; iterate it for `Scan`, `LaserScan` and `Pose` messages.

    Attributes
    ----------
    path : Path
        File or folder.
    options : ReadOptions
        How it is read.
    skipped : Counter
        Messages per topic that no reader understands.
    findings : Findings
        Detected conventions and rejected messages.
    """

    format: str

    def __init__(self, path: Path, options: ReadOptions) -> None:
        self.path = path
        self.options = options
        self.skipped: Counter[str] = Counter()
        self.findings = Findings()

    @abstractmethod
    def topics(self) -> list[Topic]:
        """Streams of the recording, also those without messages."""

    @abstractmethod
    def records(self, kinds: frozenset[str] | None = None) -> Iterator[Record]:
        """Stored messages in time order; only topics of `kinds`, if given."""

    def __iter__(self) -> Iterator[Message]:
        self.skipped.clear()
        for record in self.records():
            messages = record.decode()
            if record.topic.kind in UNREAD_KINDS and not messages:
                self.skipped[record.topic.name] += 1
            yield from messages

    def first_stamp(self) -> int | None:
        """Time of the first scan or moving pose [ns]; None without.

        A zero that other times follow days later is a stamp that nobody set.
        """
        stamps = (item.stamp_ns for item in self if not (isinstance(item, Pose) and item.is_static))
        first = next(stamps, None)
        if first != 0:
            return first
        later = next((stamp for stamp in stamps if stamp != 0), 0)
        return later if later > DAY_NS else 0

    def noticed(self) -> Findings:
        """What the reads so far detected and left out."""
        return self.findings

    def poses(self) -> Iterator[tuple[Topic, Pose]]:
        """Poses alone, with the topic each came from."""
        for record in self.records(POSE_KINDS):
            for message in record.decode():
                if isinstance(message, Pose):
                    yield record.topic, message

    def info(self) -> Any:
        """Topics, rates, frames, time span and defects, as a `RecordingInfo`."""
        from lidar_core.io.info import inspect

        return inspect(self)

    def close(self) -> None:
        """Release the file, where one is held; further reads are not allowed."""
        return

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()
