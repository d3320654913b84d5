"""A recording, played as if it came from a robot."""

import time
from dataclasses import replace
from pathlib import Path
from threading import Event, Thread

from lidar_core.errors import LidarCoreError
from lidar_core.io import ReadOptions, open_recording
from lidar_core.io.recording import POSE_KINDS, SCAN_KINDS, Record, Recording, decoded
from lidar_core.live.inbox import Inbox
from lidar_core.live.source import Source


class ReplaySource(Source):
    """Plays a recording at its own pace, once.

    Parameters
    ----------
    path : Path
        Recording of any format.
    options : ReadOptions
        How to read it.
    rate : float
        Seconds of the recording per second.
    """

    def __init__(self, path: Path, options: ReadOptions, *, rate: float) -> None:
        super().__init__(f"{path} at {rate:g} times its pace")
        self._recording: Recording = open_recording(path, options)
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

    def lead_ns(self, stamp_ns: int) -> int:
        """From the time of the recording to the time at which it is played [ns]."""
        return self._begin_ns + round((stamp_ns - self._first_ns) / self._rate) - stamp_ns

    def _play(self, inbox: Inbox) -> None:
        try:
            for record in self._recording.records(POSE_KINDS | SCAN_KINDS):
                if not self._begin_ns:
                    self._begin_ns, self._first_ns = time.time_ns(), record.time_ns
                played = self._read(record, inbox)
                wait_ns = record.time_ns + self.lead_ns(record.time_ns) - time.time_ns()
                if self._ended.wait(max(wait_ns, 0) * 1e-9):
                    return
                inbox.put(played)
            inbox.finish()
        except Exception as error:  # whatever it is, the loop raises it where the user is
            inbox.fail(error)

    def _read(self, record: Record, inbox: Inbox) -> Record:
        """The record, decoded: readers do not do that after they went on to the next one."""
        try:
            return replace(record, decode=decoded(*record.decode()))
        except LidarCoreError as error:
            inbox.reject(record.topic.name)
            self.findings.note(str(error))
            return replace(record, decode=decoded())
