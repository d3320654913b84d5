"""Playback of a recording in real time."""

import heapq
import time
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from threading import Event, Thread

from lidar_core.errors import LidarCoreError
from lidar_core.io import ReadOptions, open_recording
from lidar_core.io.poses.posed import span_ns
from lidar_core.io.recording import Recording
from lidar_core.io.records import POSE_KINDS, SCAN_KINDS, Record, decoded
from lidar_core.io.scan_topics import scan_topics
from lidar_core.live.sources.inbox import Inbox
from lidar_core.live.sources.source import Source, StreamTopics
from lidar_core.messages import LaserScan, Pose, Scan

__all__ = ["ReplaySource"]


class ReplaySource(Source):
    """Source that plays a recording once at its own pace.

    Parameters
    ----------
    path : Path
        Recording of any format.
    options : ReadOptions
        Options for reading it.
    rate : float
        Seconds of the recording per second.
    topics : StreamTopics
        Requested topics.

    Raises
    ------
    ConfigError
        The recording has no such topic.
    FormatError
        The recording has no scans of the wanted kind.
    """

    def __init__(
        self, path: Path, options: ReadOptions, *, rate: float, topics: StreamTopics
    ) -> None:
        super().__init__(f"{path} at {rate:g} times its pace")
        sorts = [
            *([Scan] if topics.wants_clouds else []),
            *([LaserScan] if topics.wants_scans else []),
        ]
        with ExitStack() as stack:
            self._recording: Recording = stack.enter_context(open_recording(path, options))
            scan_topics(self._recording, sorts, (*topics.clouds, *topics.scans), is_live=True)
            stack.pop_all()
        self.findings = self._recording.noticed()
        self._rate = rate
        self._ended = Event()
        self._thread: Thread | None = None
        self._begin_ns = self._first_ns = 0

    def start(self, inbox: Inbox) -> None:
        """Begin to play."""
        self._thread = Thread(target=self._play, args=(inbox,), daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop, and close the recording."""
        self._ended.set()
        if self._thread is not None:
            self._thread.join()
        self._recording.close()

    @property
    def is_stream(self) -> bool:
        """False: the content of a recording was checked before."""
        return False

    @property
    def has_arrivals(self) -> bool:
        """True if the recording keeps the times at which its messages arrived."""
        return self._recording.has_arrivals

    def lead_ns(self, stamp_ns: int) -> int:
        """Difference from the time of the recording to the time of playback [ns]."""
        return self._begin_ns + round((stamp_ns - self._first_ns) / self._rate) - stamp_ns

    def _play(self, inbox: Inbox) -> None:
        try:
            for due_ns, record in self._in_turn(inbox):
                wait_ns = due_ns + self.lead_ns(due_ns) - time.time_ns()
                if self._ended.wait(max(wait_ns, 0) * 1e-9):
                    return
                inbox.put(record)
            inbox.finish()
        except Exception as error:  # whatever it is, the loop raises it where the user is
            inbox.fail(error)

    def _in_turn(self, inbox: Inbox) -> Iterator[tuple[int, Record]]:
        """Yield records with the times at which a robot has them: a scan at its last ray."""
        waiting: list[tuple[int, int, Record]] = []
        for number, record in enumerate(self._recording.records(POSE_KINDS | SCAN_KINDS)):
            if not self._begin_ns:
                self._begin_ns, self._first_ns = time.time_ns(), record.time_ns
            while waiting and waiting[0][0] <= record.time_ns:
                due_ns, _, earlier = heapq.heappop(waiting)
                yield due_ns, earlier
            played = self._read(record, inbox)
            scans = (item for item in played.decode() if not isinstance(item, Pose))
            ends_ns = (span_ns(scan)[1] for scan in scans)
            heapq.heappush(waiting, (max(record.time_ns, *ends_ns, 0), number, played))
        while waiting:
            due_ns, _, last = heapq.heappop(waiting)
            yield due_ns, last

    def _read(self, record: Record, inbox: Inbox) -> Record:
        """Decode a record at once: a reader cannot decode it after it has read the next one."""
        try:
            return replace(record, decode=decoded(*record.decode()))
        except LidarCoreError as error:
            inbox.reject(record.topic.name)
            self.findings.note(str(error))
            return replace(record, decode=decoded())


def __dir__() -> list[str]:
    return __all__
