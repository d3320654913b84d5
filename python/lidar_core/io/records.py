"""Parts of a recording: topics, stored messages, and findings of the reader."""

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Literal, TypeAlias

from lidar_core.messages import Message

__all__ = [
    "MOST_NOTES",
    "PACKETS",
    "POSE_KINDS",
    "SCAN_KINDS",
    "UNREAD_KINDS",
    "Findings",
    "Kind",
    "Record",
    "Topic",
    "decoded",
]

Kind: TypeAlias = Literal[
    "scan", "planar", "pose", "scan+pose", "planar+pose", "measurement", "packets", "other"
]

PACKETS: dict[str, str] = {
    "velodyne_msgs/msg/VelodyneScan": "Velodyne packets",
    "ouster_msgs/msg/PacketMsg": "Ouster packets",
    "ouster_ros/msg/PacketMsg": "Ouster packets",
    "ouster_sensor_msgs/msg/PacketMsg": "Ouster packets",
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


@dataclass(frozen=True, slots=True)
class Topic:
    """One stream of a recording.

    Attributes
    ----------
    name, type : str
        Name and type in the recording.
    kind : str
        Kind of message that the reader returns.
    count : int or None
        Messages, where the recording states it.
    note : str
        Reason why it is not read, or assumptions that were made.
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
        Time at which it was stored [ns].
    decode : callable
        Decode the messages of the record; none if it was rejected or has no reader.
    parse : callable, optional
        Parse the message by its ROS type, if it has one.
    """

    topic: Topic
    time_ns: int
    decode: Callable[[], list[Message]]
    parse: Callable[[], Any] | None = None


@dataclass(slots=True)
class Findings:
    """Findings of a reader: detected conventions and skipped messages."""

    point_time: dict[str, str] = field(default_factory=dict)
    no_return: dict[str, str] = field(default_factory=dict)
    rejected: Counter[str] = field(default_factory=Counter)
    notes: list[str] = field(default_factory=list)

    def note(self, text: str) -> None:
        """Add `text` once; the number of texts is limited."""
        if len(self.notes) < MOST_NOTES and text not in self.notes:
            self.notes.append(text)


def decoded(*messages: Message) -> Callable[[], list[Message]]:
    """Return a function for `Record.decode` that returns these messages."""
    return lambda: list(messages)


def __dir__() -> list[str]:
    return __all__
