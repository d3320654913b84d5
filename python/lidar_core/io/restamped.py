"""Replacement of the stamps of scans in recordings with unusable stamps."""

from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from functools import partial

from lidar_core.io.options import NS, ReadOptions
from lidar_core.io.recording import Recording
from lidar_core.io.records import SCAN_KINDS, Findings, Record, Topic
from lidar_core.messages import Message, Scan


class RestampedRecording(Recording):
    """Recording whose stamps are the times at which messages were stored, or counted times.

    Static poses keep their stamps: they hold at all times.

    Parameters
    ----------
    recording : Recording
        Recording with the original stamps; closed with this one.
    options : ReadOptions
        `stamps` is recorded or counted.
    """

    def __init__(self, recording: Recording, options: ReadOptions) -> None:
        super().__init__(recording.path, options)
        self._recording = recording
        self.format = recording.format
        self.has_arrivals = recording.has_arrivals and options.stamps == "recorded"

    def topics(self) -> list[Topic]:
        """Streams of the recording."""
        return self._recording.topics()

    def noticed(self) -> Findings:
        """Findings so far: detected conventions and skipped messages."""
        return self._recording.noticed()

    def close(self) -> None:
        """Release the recording."""
        self._recording.close()

    def records(self, kinds: frozenset[str] | None = None) -> Iterator[Record]:
        """Stored messages in the order of the recording, with other stamps.

        The scans of every topic are counted separately; poses have the time of the last scan.
        """
        if self.options.stamps == "recorded":
            for record in self._recording.records(kinds):
                yield _at(record, record.time_ns)
            return
        step_ns = round(NS / self.options.scan_rate)
        counts, last_ns = Counter[tuple[str, str]](), 0
        # All kinds are passed through, so that poses have the same times whoever asks for them.
        for record in self._recording.records():
            if record.topic.kind in SCAN_KINDS:
                stream = record.topic.name, record.topic.kind
                last_ns = counts[stream] * step_ns
                counts[stream] += 1
            if kinds is None or record.topic.kind in kinds:
                yield _at(record, last_ns)


def _at(record: Record, stamp_ns: int) -> Record:
    return replace(record, time_ns=stamp_ns, decode=partial(_decode, record, stamp_ns))


def _decode(record: Record, stamp_ns: int) -> list[Message]:
    return [_restamp(message, stamp_ns) for message in record.decode()]


def _restamp(message: Message, stamp_ns: int) -> Message:
    if isinstance(message, Scan) and message.point_time_ns is not None:
        moved = message.point_time_ns + (stamp_ns - message.stamp_ns)
        return replace(message, stamp_ns=stamp_ns, point_time_ns=moved)
    if getattr(message, "is_static", False):
        return message
    return replace(message, stamp_ns=stamp_ns)
