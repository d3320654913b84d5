"""Messages that have arrived and wait to be processed, in bounded memory."""

import time
from collections import Counter, deque
from dataclasses import dataclass, field
from threading import Condition

from lidar_core.io.records import SCAN_KINDS, Record
from lidar_core.live.tape import Tape

MAX_TOPICS = 64  # with scans that wait at once


@dataclass(frozen=True, slots=True)
class Arrival:
    """A record that arrived, not yet decoded, with its time of arrival."""

    record: Record
    time_ns: int


@dataclass(slots=True)
class Batch:
    """Messages since the last call.

    Attributes
    ----------
    poses, scans : list of Arrival
        Poses in their order; the newest scan of every topic.
    is_finished : bool
        Nothing more will come.
    refused : list of str
        Reason of every scan that the source refused.
    """

    poses: list[Arrival] = field(default_factory=list)
    scans: list[Arrival] = field(default_factory=list)
    is_finished: bool = False
    refused: list[str] = field(default_factory=list)


class Inbox:
    """Store for records from any thread; the newest scan of a topic replaces a waiting one.

    Parameters
    ----------
    max_poses : int
        Largest number of waiting messages with poses; beyond it the oldest are dropped.
    tape : Tape, optional
        Keeps every record, including replaced ones.

    Attributes
    ----------
    dropped, rejected : Counter
        Records replaced before anybody looked at them, by topic; messages that were none, by
        topic.
    heard : set of str
        Topics that brought a scan, readable or not.
    """

    def __init__(self, *, max_poses: int, tape: Tape | None = None) -> None:
        self.dropped: Counter[str] = Counter()
        self.rejected: Counter[str] = Counter()
        self.heard: set[str] = set()
        self._max_poses = max_poses
        self._tape = tape
        self._poses: deque[Arrival] = deque()
        self._scans: dict[str, Arrival] = {}
        self._refused: list[str] = []
        self._error: Exception | None = None
        self._is_finished = False
        self._changed = Condition()

    def put(self, record: Record) -> None:
        """Add one record; returns at once."""
        time_ns = time.time_ns()
        arrival = Arrival(record if self._tape is None else self._tape.keep(record), time_ns)
        topic = record.topic.name
        with self._changed:
            if record.topic.kind in SCAN_KINDS:
                if len(self.heard) < MAX_TOPICS:
                    self.heard.add(topic)
                if topic not in self._scans and len(self._scans) >= MAX_TOPICS:
                    self.dropped["other topics"] += 1
                    return
                if topic in self._scans:
                    self.dropped[topic] += 1
                self._scans[topic] = arrival
            else:
                if len(self._poses) >= self._max_poses:
                    self.dropped[self._poses.popleft().record.topic.name] += 1
                self._poses.append(arrival)
            self._changed.notify()

    def reject(self, topic: str) -> None:
        """Count a message that could not be understood."""
        with self._changed:
            self.rejected[topic] += 1

    def refuse(self, topic: str, reason: str) -> None:
        """Count a scan that cannot be used."""
        with self._changed:
            self.heard.add(topic)
            self._refused.append(reason)
            self._changed.notify()

    def fail(self, error: Exception) -> None:
        """End the run with an error."""
        with self._changed:
            self._error = error
            self._changed.notify()

    def finish(self) -> None:
        """Mark the end of the stream."""
        with self._changed:
            self._is_finished = True
            self._changed.notify()

    def take(self, timeout: float) -> Batch:
        """Return all waiting records; wait up to `timeout` seconds for the first.

        Raises
        ------
        Exception
            The error that the source failed with.
        """
        with self._changed:
            self._changed.wait_for(self._has_news, timeout)
            if self._error is not None:
                raise self._error
            batch = Batch(list(self._poses), list(self._scans.values()), self._is_finished)
            batch.refused, self._refused = self._refused, []
            self._poses.clear()
            self._scans.clear()
            return batch

    def _has_news(self) -> bool:
        return bool(self._poses or self._scans or self._refused or self._error or self._is_finished)
