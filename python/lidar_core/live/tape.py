"""Writer of a recording of everything that arrives."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from queue import Full, Queue
from threading import Lock, Thread

from lidar_core.errors import LidarCoreError
from lidar_core.io import McapWriter
from lidar_core.io.files.atomic import check_place
from lidar_core.io.poses.pose_topics import is_odometry
from lidar_core.io.poses.posed import WORLD_FRAME
from lidar_core.io.records import Record
from lidar_core.io.write.recording import write_arrivals
from lidar_core.messages import Message

MOST_WAITING = 256
"""Records that wait to be written; more are lost, so that a slow disk does not delay the robot."""


class _Once:
    """Replacement of `Record.decode` that decodes only once, for the loop and the tape."""

    def __init__(self, record: Record) -> None:
        self._record: Record | None = record
        self._messages: list[Message] = []
        self._error: LidarCoreError | None = None
        self._lock = Lock()

    def __call__(self) -> list[Message]:
        with self._lock:
            if self._record is not None:
                record, self._record = self._record, None
                try:
                    self._messages = record.decode()
                except LidarCoreError as error:
                    self._error = error
        if self._error is not None:
            raise self._error
        return self._messages


class Tape:
    """Writer of every scan and pose that arrives, in its own thread; the newest may be lost.

    Parameters
    ----------
    path : Path
        Recording to write; its ending chooses the format, as of `write_recording`. Only MCAP
        outlives a process that is killed: see `McapWriter`.
    has_arrivals : bool
        True if the times of the records are those at which the messages arrived. The recording
        keeps them, so that its replay is the same stream.

    Attributes
    ----------
    lost : int
        Number of records that arrived faster than they could be written.
    """

    def __init__(self, path: Path, *, has_arrivals: bool = True) -> None:
        check_place(path)
        self.path = path
        self.lost = 0
        self._has_arrivals = has_arrivals
        self._odometry: set[str] = set()
        self._waiting: Queue[Record | None] = Queue(MOST_WAITING)
        self._error: Exception | None = None
        self._thread = Thread(target=self._write, daemon=True)
        self._thread.start()

    def keep(self, record: Record) -> Record:
        """Write a record; return it with messages that are decoded only once."""
        shared = replace(record, decode=_Once(record))
        try:
            self._waiting.put_nowait(shared)
        except Full:
            self.lost += 1
        return shared

    def close(self) -> None:
        """Complete the file.

        Raises
        ------
        OSError
            The file could not be written.
        LidarCoreError
            The format cannot store the messages.
        """
        if self._thread.is_alive():
            self._waiting.put(None)
            self._thread.join()
        if self._error is not None:
            error, self._error = self._error, None
            raise error

    def _write(self) -> None:
        try:
            if self.path.suffix.lower() == ".mcap":
                with McapWriter(
                    self.path, tracks_frame=WORLD_FRAME, is_live=True, odometry=self._odometry
                ) as writer:
                    for message, arrival_ns in self._messages():
                        writer.write(message, log_time_ns=arrival_ns)
            else:
                write_arrivals(self.path, self._messages(), odometry=self._odometry)
        except Exception as error:  # whatever it is, the run ends with it
            self._error = error
            while self._waiting.get() is not None:
                self.lost += 1

    def _messages(self) -> Iterator[tuple[Message, int | None]]:
        while (record := self._waiting.get()) is not None:
            if is_odometry(record.topic):
                self._odometry.add(record.topic.name)
            arrival_ns = record.time_ns if self._has_arrivals else None
            try:
                yield from ((message, arrival_ns) for message in record.decode())
            except LidarCoreError:
                continue  # the loop counts what cannot be read
