"""MCAP files: ROS 2 and ROS 1 messages, and Foxglove's protobuf messages."""

import heapq
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import IO, Any

from lidar_core.errors import FormatError, LidarCoreError, LimitError
from lidar_core.extras import require
from lidar_core.io.files.beginnings import MCAP, check_beginning
from lidar_core.io.files.guard import check_size, reading
from lidar_core.io.files.mcap_chunk import CHUNK_CODE, RECORD_HEAD, chunk_records
from lidar_core.io.files.mcap_salvage import Salvage
from lidar_core.io.formats.ros import MAX_TOPICS
from lidar_core.io.hints import recovering
from lidar_core.io.messages.foxglove import FoxgloveDecoder, foxglove_kind
from lidar_core.io.messages.ouster import OusterTopics
from lidar_core.io.messages.ros import RosDecoder, kind_of, note_of, ros_name
from lidar_core.io.options import ReadOptions
from lidar_core.io.readers import register_reader
from lidar_core.io.recording import Recording
from lidar_core.io.records import Kind, Record, Topic
from lidar_core.messages import Message

"""First and last bytes of a file."""


@register_reader(
    "MCAP",
    [".mcap"],
    extra="io",
    folder="merged",
    marker="metadata.yaml",
    note="messages of ROS 2, or PointCloud, LaserScan, FrameTransform and PoseInFrame of Foxglove",
)
class McapRecording(Recording):
    """One MCAP file, read chunk by chunk in time order."""

    format = "MCAP"
    has_arrivals = True

    def __init__(self, path: Path, options: ReadOptions) -> None:
        super().__init__(path, options)
        self._mcap = require("mcap.stream_reader", extra="io", purpose="reading MCAP")
        self._records = require("mcap.records", extra="io", purpose="reading MCAP")
        require("mcap.reader", extra="io", purpose="reading MCAP")
        check_beginning(path, MCAP, "an MCAP file")
        self._file: IO[bytes] = path.open("rb")
        try:
            self._summary = self._read_summary()
            self._topics = self._list_topics()
            self._ros = {
                encoding: RosDecoder(version, options, self.findings)
                for encoding, version in (("cdr", 2), ("ros1", 1))
                if any(c.message_encoding == encoding for c in self._summary.channels.values())
            }
            self._ouster = OusterTopics(
                map(_with_ros_name, self._topics.values()),
                self._first_text,
                options,
                self.findings,
                str(path),
            )
            self._topics = {
                number: self._ouster.described(one) for number, one in self._topics.items()
            }
        except BaseException:
            self._file.close()
            raise
        self._foxglove = FoxgloveDecoder(options, self.findings)

    def topics(self) -> list[Topic]:
        """Streams of the recording, by name."""
        named: dict[str, Topic] = {}
        for topic in self._topics.values():
            before = named.get(topic.name)
            named[topic.name] = (
                topic if before is None else replace(topic, count=_sum(before, topic))
            )
        return list(named.values())

    def records(self, kinds: frozenset[str] | None = None) -> Iterator[Record]:
        """Messages in order of log time; chunks that overlap in time are merged."""
        wanted = {
            number for number, topic in self._topics.items() if kinds is None or topic.kind in kinds
        }
        ouster = self._ouster.streams()
        for order, message in self._messages(wanted):
            topic = self._topics.get(message.channel_id)
            if topic is not None and ouster.takes(topic.name):
                packet = self._message(order, message, topic).buf.tobytes()
                yield from ouster.add(topic, message.log_time, packet)
            else:
                yield self._record(order, message)
        yield from ouster.rest()

    def foxglove(self, type_name: str) -> Iterator[tuple[str, Any]]:
        """Return raw protobuf messages of one schema, with their places, by log time."""
        wanted = {
            number
            for number, channel in self._summary.channels.items()
            if self._topics[number].type == type_name and channel.message_encoding == "protobuf"
        }
        for order, message in self._messages(wanted):
            topic = self._topics[message.channel_id]
            channel = self._summary.channels[message.channel_id]
            place = f"{self.path}, message {order} on {topic.name}"
            schema = self._schema(channel, place)
            yield place, self._foxglove.message(schema, message.data, place)

    def stored(self) -> Iterator[tuple[Any, Any, Any]]:
        """Return every stored message with its channel and schema, by log time."""
        for _, message in self._messages(set(self._topics)):
            channel = self._summary.channels[message.channel_id]
            yield channel, self._summary.schemas.get(channel.schema_id), message

    def _messages(self, wanted: set[int]) -> Iterator[tuple[int, Any]]:
        """Stored messages of these channels with their order in the file, by log time."""
        chunks = sorted(
            (index for index in self._summary.chunk_indexes if self._may_hold(index, wanted)),
            key=lambda index: (index.message_start_time, index.chunk_start_offset),
        )
        if not self._summary.chunk_indexes:
            yield from self._read_without_chunks(wanted)
            return
        pending: list[tuple[int, int, Any]] = []
        order = 0
        for index in chunks:
            while pending and pending[0][0] < index.message_start_time:
                yield heapq.heappop(pending)[1:]
            for message in self._chunk_messages(index.chunk_start_offset):
                if message.channel_id in wanted:
                    heapq.heappush(pending, (message.log_time, order, message))
                    order += 1
        while pending:
            yield heapq.heappop(pending)[1:]

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    @contextmanager
    def _reading(self, place: str) -> Iterator[None]:
        """Convert errors like `reading`, for a library that has its own limit on records."""
        exceptions = require("mcap.exceptions", extra="io", purpose="reading MCAP")
        with reading(place):
            try:
                yield
            except exceptions.EndOfFile as error:
                raise FormatError(f"{place}: the file ends inside a record") from error
            except exceptions.RecordLengthLimitExceeded as error:
                if self.path.stat().st_size <= self.options.max_record_bytes:
                    raise  # no honest length: the file is smaller
                raise LimitError(f"{place}: {error}; raise it with max_record_bytes") from error

    def _read_summary(self) -> Any:
        reader = require("mcap.reader", extra="io", purpose="reading MCAP")
        limit = self.options.max_record_bytes
        place = f"{self.path}: MCAP summary"
        if self.options.recover:
            return self._salvage_index()
        self._check_end()
        with self._reading(place):
            summary = reader.SeekingReader(self._file, record_size_limit=limit).get_summary()
        summary = summary or self._empty_summary()
        if not self._is_complete(summary):
            self._scan_for_channels(summary)
        check_size(
            place, len(summary.channels), limit=MAX_TOPICS, key="nothing", what="a number of topics"
        )
        return summary

    def _check_end(self) -> None:
        """Refuse a file without its end: the library would take other bytes for a summary."""
        self._file.seek(-len(MCAP), os.SEEK_END)
        end, size = self._file.read(), self._file.tell()
        self._file.seek(0)
        if end != MCAP:
            raise FormatError(
                f"{self.path}, byte {size}: the file ends before its summary: it was"
                f" cut, or not closed; {recovering(self.path)}"
            )

    def _salvage_index(self) -> Any:
        """Index of the complete chunks, read from the start of the file to the first defect."""
        summary = self._empty_summary()
        salvage = Salvage(summary, self._records)
        self._file.seek(0)
        stored = iter(self._stream().records)
        while True:
            try:
                with self._reading(f"{self.path}: MCAP data"):
                    record = next(stored, None)
            except LidarCoreError as error:
                salvage.end = str(error)
                break
            if record is None or isinstance(record, self._records.DataEnd):
                break
            salvage.see(record, self._file.tell(), self._next_chunk)
        lost = self.path.stat().st_size - salvage.known_bytes if salvage.end else 0
        self.findings.notes.extend(salvage.notes(lost))
        return summary

    def _next_chunk(self, place: int) -> tuple[int, list[Any]]:
        """Find the next chunk; return its start [byte] and its records.

        The search begins with the record at byte `place` and skips records of other kinds. The
        position in the file does not change.
        """
        position = self._file.tell()
        try:
            self._file.seek(max(place, len(MCAP)))
            while (head := self._file.read(RECORD_HEAD.size))[:1] != CHUNK_CODE:
                self._file.seek(RECORD_HEAD.unpack(head)[1], os.SEEK_CUR)
            offset = self._file.tell() - RECORD_HEAD.size
            return offset, self._chunk_records(offset)
        finally:
            self._file.seek(position)

    @staticmethod
    def _empty_summary() -> Any:
        return require("mcap.summary", extra="io", purpose="reading MCAP").Summary()

    @staticmethod
    def _is_complete(summary: Any) -> bool:
        """Return whether the summary repeats all channels and their schemas, which is optional."""
        told = summary.statistics.channel_count if summary.statistics is not None else 1
        used = {channel.schema_id for channel in summary.channels.values()}
        return len(summary.channels) >= told and used <= {0, *summary.schemas}

    def _scan_for_channels(self, summary: Any) -> None:
        """Add the channels and schemas of the data to a summary that does not repeat them."""
        with self._reading(f"{self.path}: MCAP data"):
            for record in self._all_records():
                if isinstance(record, self._records.Schema):
                    summary.schemas[record.id] = record
                elif isinstance(record, self._records.Channel):
                    summary.channels[record.id] = record

    def _list_topics(self) -> dict[int, Topic]:
        counts = {}
        if self._summary.statistics is not None:
            counts = self._summary.statistics.channel_message_counts
        topics = {}
        for number, channel in sorted(self._summary.channels.items()):
            schema = self._summary.schemas.get(channel.schema_id)
            name = schema.name if schema is not None else ""
            kind, note = _kind(channel.message_encoding, name)
            topics[number] = Topic(channel.topic, name, kind, counts.get(number), note)
        return topics

    def _may_hold(self, index: Any, wanted: set[int]) -> bool:
        offsets = index.message_index_offsets
        return not offsets or not wanted.isdisjoint(offsets)

    def _stream(self) -> Any:
        return self._mcap.StreamReader(
            self._file,
            skip_magic=self._file.tell() >= len(MCAP),
            emit_chunks=True,
            record_size_limit=self.options.max_record_bytes,
        )

    def _chunk_messages(self, offset: int) -> list[Any]:
        records = self._chunk_records(offset)
        return [record for record in records if isinstance(record, self._records.Message)]

    def _chunk_records(self, offset: int) -> list[Any]:
        """Read the records of the chunk at byte `offset`; its checksum and its size are checked."""
        place = f"{self.path}, chunk at byte {offset}"
        with self._reading(place):
            self._file.seek(offset)
            chunk = next(self._stream().records, None)
            if not isinstance(chunk, self._records.Chunk):
                raise FormatError(f"{place}: the index points here, but there is no chunk")
            return chunk_records(chunk, place, self.options.max_record_bytes)

    def _all_records(self) -> Iterator[Any]:
        """Yield all records in the order of the file, including those inside chunks."""
        self._file.seek(0)
        for record in self._stream().records:
            if isinstance(record, self._records.Chunk):
                place = f"{self.path}, chunk that ends at byte {self._file.tell()}"
                yield from chunk_records(record, place, self.options.max_record_bytes)
            else:
                yield record

    def _read_without_chunks(self, wanted: set[int]) -> Iterator[tuple[int, Any]]:
        messages = []
        try:
            with self._reading(f"{self.path}: MCAP data"):
                for order, record in enumerate(self._all_records()):
                    if isinstance(record, self._records.Message) and record.channel_id in wanted:
                        messages.append((record.log_time, order, record))
        except LidarCoreError:
            if not self.options.recover:
                raise
        for _, number, message in sorted(messages, key=lambda item: item[:2]):
            yield number, message

    def _record(self, number: int, message: Any) -> Record:
        topic = self._topics.get(message.channel_id)
        if topic is None:
            raise FormatError(
                f"{self.path}, message {number}: unknown channel {message.channel_id}"
            )
        place = f"{self.path}, message {number} on {topic.name}"
        decode = partial(self._decode, message, topic, place)
        ros = self._ros.get(self._summary.channels[message.channel_id].message_encoding)
        said = (ros_name(topic.type), message.data, place)
        parse = None if ros is None else partial(ros.message, *said)
        return Record(topic, message.log_time, decode, parse)

    def _message(self, number: int, message: Any, topic: Topic) -> Any:
        """Decode a message of ROS by the type of its topic."""
        ros = self._ros[self._summary.channels[message.channel_id].message_encoding]
        place = f"{self.path}, message {number} on {topic.name}"
        return ros.message(ros_name(topic.type), message.data, place)

    def _first_text(self, name: str) -> str | None:
        """Return the text of the first message of a topic of texts; None without messages."""
        wanted = {number for number, topic in self._topics.items() if topic.name == name}
        for order, message in self._messages(wanted):
            text: str = self._message(order, message, self._topics[message.channel_id]).data
            return text
        return None

    def _decode(self, message: Any, topic: Topic, place: str) -> list[Message]:
        channel = self._summary.channels[message.channel_id]
        ros = self._ros.get(channel.message_encoding)
        if ros is not None:
            return ros.decode(topic.name, ros_name(topic.type), message.data, place)
        if channel.message_encoding == "protobuf":
            schema = self._schema(channel, place)
            return self._foxglove.decode(topic.name, schema, channel.metadata, message.data, place)
        return []

    def _schema(self, channel: Any, place: str) -> Any:
        schema = self._summary.schemas.get(channel.schema_id)
        if schema is None:
            raise FormatError(f"{place}: schema {channel.schema_id} is nowhere in the file")
        return schema


def _sum(one: Topic, other: Topic) -> int | None:
    """Number of messages of two channels of a topic; None if the file does not state it."""
    return None if one.count is None or other.count is None else one.count + other.count


def _with_ros_name(topic: Topic) -> Topic:
    return replace(topic, type=ros_name(topic.type))


def _kind(encoding: str, type_name: str) -> tuple[Kind, str]:
    if encoding in ("cdr", "ros1"):
        name = ros_name(type_name)
        return kind_of(name), note_of(name)
    if encoding == "protobuf":
        return foxglove_kind(type_name), ""
    return "other", f"message encoding {encoding!r} is not read"
