"""ROS 1 bags and ROS 2 sqlite3 recordings, through rosbags."""

import heapq
import sqlite3
from collections.abc import Iterator
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from shlex import quote
from typing import Any

from lidar_core.errors import FormatError
from lidar_core.extras import require
from lidar_core.io.files.beginnings import BAG, DATABASE, check_beginning
from lidar_core.io.files.compressed import bounded_decompressor
from lidar_core.io.files.guard import check_size, reading
from lidar_core.io.messages.ouster import OusterTopics
from lidar_core.io.messages.ros import RosDecoder, kind_of, note_of
from lidar_core.io.options import ReadOptions
from lidar_core.io.readers import register_reader
from lidar_core.io.recording import Recording
from lidar_core.io.records import Record, Topic

MAX_TOPICS = 4096


class RosRecording(Recording):
    """A ROS 1 bag, or the sqlite3 files of a ROS 2 recording.

    A ROS 2 folder is read through its storage files: its metadata.yaml repeats their content, and
    is often incomplete (a missing serialization format) or stale.
    """

    format = "ros"
    has_arrivals = True

    def __init__(self, path: Path, options: ReadOptions, files: list[Path], version: int) -> None:
        super().__init__(path, options)
        self.format = "ROS 1 bag" if version == 1 else "ROS 2 sqlite3"
        self._decoder = RosDecoder(version, options, self.findings)
        self._stack = ExitStack()
        self._readers: list[tuple[Path, Any]] = []
        with ExitStack() as stack:
            for file in files:
                self._readers.append((file, self._open_reader(file, version, stack)))
            topics = self._list_topics()
            self._ouster = OusterTopics(
                topics.values(), self._first_text, options, self.findings, str(path)
            )
            self._topics = {name: self._ouster.described(one) for name, one in topics.items()}
            self._stack = stack.pop_all()

    def topics(self) -> list[Topic]:
        """Streams of the recording, by name."""
        return list(self._topics.values())

    def records(self, kinds: frozenset[str] | None = None) -> Iterator[Record]:
        """Stored messages in the order of the times at which they were recorded."""
        parts = [self._file_records(file, reader, kinds) for file, reader in self._readers]
        yield from heapq.merge(*parts, key=lambda record: record.time_ns)

    def close(self) -> None:
        """Close the files."""
        self._stack.close()

    def _open_reader(self, file: Path, version: int, stack: ExitStack) -> Any:
        module = require(f"rosbags.rosbag{version}", extra="io", purpose="reading ROS recordings")
        if version == 2:
            _check_database(file, self.options)
            with reading(str(file)):
                return stack.enter_context(module.Reader(file))
        check_beginning(file, BAG, "a ROS 1 bag")
        with reading(str(file)):
            try:
                reader = stack.enter_context(module.Reader(file))
            except module.ReaderError as error:
                if "index" not in str(error):
                    raise
                raise FormatError(
                    f"{file}: the index at the end of the bag is missing or damaged: the bag was"
                    f" not closed, or was cut; a new index: rosbag reindex {quote(str(file))}"
                ) from error
        _bound_chunks(reader, file, self.options)
        return reader

    def _file_records(
        self, file: Path, reader: Any, kinds: frozenset[str] | None
    ) -> Iterator[Record]:
        wanted = [
            connection
            for connection in reader.connections
            if kinds is None or self._topics[connection.topic].kind in kinds
        ]
        if not wanted:
            return
        ouster = self._ouster.streams()
        for connection, time_ns, raw, place in self._stored(file, reader, wanted):
            topic = self._topics[connection.topic]
            said = (connection.msgtype, raw, place)
            if ouster.takes(topic.name):
                packet = self._decoder.message(*said).buf.tobytes()
                yield from ouster.add(topic, time_ns, packet)
                continue
            decode = partial(self._decoder.decode, connection.topic, *said)
            parse = partial(self._decoder.message, *said)
            yield Record(topic, time_ns, decode, parse)
        yield from ouster.rest()

    def _stored(
        self, file: Path, reader: Any, wanted: list[Any]
    ) -> Iterator[tuple[Any, int, bytes, str]]:
        """Yield the messages of these connections: connection, time [ns], bytes, place as text."""
        stored = iter(reader.messages(connections=wanted))
        number = 0
        while True:
            place = f"{file}, message {number}"
            with reading(place):
                item = next(stored, None)
            if item is None:
                return
            connection, time_ns, raw = item
            place = f"{file}, message {number} on {connection.topic}"
            # A database holds what somebody put there: texts where bytes and times belong.
            if not isinstance(time_ns, int) or not isinstance(raw, bytes | memoryview | bytearray):
                got = f"{type(time_ns).__name__} and {type(raw).__name__}"
                raise FormatError(f"{place}: expected a time and bytes, got {got}")
            yield connection, time_ns, bytes(raw), place
            number += 1

    def _first_text(self, topic: str) -> str | None:
        """Return the text of the first message of a topic of texts; None without messages."""
        for file, reader in self._readers:
            wanted = [one for one in reader.connections if one.topic == topic]
            if wanted:
                for connection, _, raw, place in self._stored(file, reader, wanted):
                    text: str = self._decoder.message(connection.msgtype, raw, place).data
                    return text
        return None

    def _list_topics(self) -> dict[str, Topic]:
        topics: dict[str, Topic] = {}
        for file, reader in self._readers:
            check_size(
                str(file),
                len(reader.connections),
                limit=MAX_TOPICS,
                key="nothing",
                what="a number of topics",
            )
            for item in reader.connections:
                before = topics.get(item.topic)
                count = int(item.msgcount) + (before.count or 0 if before else 0)
                note = note_of(item.msgtype)
                topics[item.topic] = Topic(
                    item.topic, item.msgtype, kind_of(item.msgtype), count, note
                )
        return dict(sorted(topics.items()))


@register_reader("ROS 1 bag", [".bag"], extra="io")
def open_bag(path: Path, options: ReadOptions) -> RosRecording:
    """Open a ROS 1 bag."""
    return RosRecording(path, options, [path], version=1)


@register_reader("ROS 2 sqlite3", [".db3"], extra="io", folder="together", marker="metadata.yaml")
def open_database(path: Path, options: ReadOptions, files: list[Path]) -> RosRecording:
    """Open the files of a ROS 2 recording with sqlite3 storage."""
    return RosRecording(path, options, files, version=2)


def _check_database(file: Path, options: ReadOptions) -> None:
    """Refuse a message larger than the limit before rosbags loads it."""
    check_beginning(file, DATABASE, "an SQLite database")
    with reading(str(file)):
        database = sqlite3.connect(f"{file.absolute().as_uri()}?immutable=1", uri=True)
        try:
            query = "SELECT id, length(data) FROM messages ORDER BY length(data) DESC LIMIT 1"
            row = database.execute(query).fetchone()
        finally:
            database.close()
    if row is not None and row[1] is not None:
        check_size(
            f"{file}, message {row[0]}",
            int(row[1]),
            limit=options.max_record_bytes,
            key="max_record_bytes",
            what="a message of bytes",
        )


def _bound_chunks(reader: Any, file: Path, options: ReadOptions) -> None:
    """Replace rosbags' decompressors, which have no limit, by ones that have."""
    limit = options.max_record_bytes
    for position, chunk in reader.chunks.items():
        place = f"{file}, chunk at byte {position}"
        check_size(
            place, chunk.datasize, limit=limit, key="max_record_bytes", what="a chunk of bytes"
        )
        bounded = bounded_decompressor(chunk.decompressor, place, limit)
        reader.chunks[position] = chunk._replace(decompressor=bounded)
