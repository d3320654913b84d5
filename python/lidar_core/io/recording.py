"""Base class of recordings: records in time order, decoded to messages on request."""

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import Self

from lidar_core.io.info import RecordingInfo, inspect
from lidar_core.io.options import ReadOptions
from lidar_core.io.records import POSE_KINDS, UNREAD_KINDS, Findings, Record, Topic
from lidar_core.messages import Message, Pose

DAY_NS = 86_400 * 10**9


class Recording(ABC):
    """A recording that is open for reading; iterate it for `Scan`, `LaserScan` and `Pose` messages.

    Attributes
    ----------
    path : Path
        File or folder.
    options : ReadOptions
        Options for reading it.
    skipped : Counter
        Messages per topic that no reader understands.
    findings : Findings
        Detected conventions and rejected messages.
    has_arrivals : bool
        True if the times of the records are those at which the messages arrived; without it they
        are the stamps of the messages.
    """

    format: str
    has_arrivals = False

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
        return (message for message, _ in self.arrivals())

    def arrivals(self) -> Iterator[tuple[Message, int | None]]:
        """Messages, each with the time at which it arrived [ns]; None if that is not known."""
        self.skipped.clear()
        for record in self.records():
            messages = record.decode()
            if record.topic.kind in UNREAD_KINDS and not messages:
                self.skipped[record.topic.name] += 1
            arrival_ns = record.time_ns if self.has_arrivals else None
            yield from ((message, arrival_ns) for message in messages)

    def first_stamp(self) -> int | None:
        """Time of the first scan or moving pose [ns]; None if there is none.

        A first stamp of zero, followed by times days later, counts as not set.
        """
        stamps = (item.stamp_ns for item in self if not (isinstance(item, Pose) and item.is_static))
        first = next(stamps, None)
        if first != 0:
            return first
        later = next((stamp for stamp in stamps if stamp != 0), 0)
        return later if later > DAY_NS else 0

    def noticed(self) -> Findings:
        """Findings so far: detected conventions and skipped messages."""
        return self.findings

    def poses(self) -> Iterator[tuple[Topic, Pose]]:
        """Yield only the poses, each with its topic."""
        for record in self.records(POSE_KINDS):
            for message in record.decode():
                if isinstance(message, Pose):
                    yield record.topic, message

    def info(self) -> RecordingInfo:
        """Topics, rates, frames, time span and defects."""
        return inspect(self)

    def close(self) -> None:
        """Close the file, if one is open; further reads are not allowed."""
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
