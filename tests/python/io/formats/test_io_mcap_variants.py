"""MCAP files as other writers make them: with and without chunks, indexes, repeated records and
fields of later versions. One recording gives the same messages in each of 416 variants.

The features are those of the conformance files of the MCAP project, which hold no scans.
"""

import struct
from itertools import product
from typing import NamedTuple

import numpy as np
import pytest

from lidar_core.errors import FormatError
from lidar_core.io import open_recording, write_recording
from lidar_core.io.files.mcap_chunk import chunk_records
from lidar_core.io.formats.mcap import McapRecording
from lidar_core.messages import Pose, Scan

writer = pytest.importorskip("mcap.writer")
records = pytest.importorskip("mcap.records")
data_stream = pytest.importorskip("mcap.data_stream")

FOOTER, MESSAGE = 2, 5
"""Records behind whose fields nothing can follow."""
LATER = bytes(range(7))
"""Fields of a later version."""


class Variant(NamedTuple):
    """Features of a writer, each with or without."""

    has_chunks: bool
    compression: str
    chunk_index: bool
    message_index: bool
    channels: bool
    schemas: bool
    statistics: bool
    offsets: bool
    later: bool

    def __str__(self):
        told = [name for name, value in self._asdict().items() if value is True]
        return "-".join([self.compression.lower(), *told])


BOTH = (True, False)
EVERY = [
    *(Variant(True, *rest) for rest in product(("NONE", "LZ4", "ZSTD"), *7 * (BOTH,))),
    *(Variant(False, "NONE", False, False, *rest) for rest in product(*5 * (BOTH,))),
]
SOME = [*EVERY[::9], *EVERY[-32::3]]


def told(path, **options):
    with open_recording(path, trusted=True, **options) as recording:
        topics = sorted((one.name, one.type, one.kind) for one in recording.topics())
        messages = [
            (type(one), one.stamp_ns, one.points.tobytes() if isinstance(one, Scan) else repr(one))
            for one in recording
        ]
        return topics, messages, recording.noticed().notes


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    """A recording as this package writes it."""
    path, rng = tmp_path_factory.mktemp("mcap") / "good.mcap", np.random.default_rng(0)
    messages = []
    for stamp in range(10**9, 16 * 10**8, 10**8):
        messages.append(Pose(stamp, "world", "lidar", np.eye(4), topic="/tf"))
        points = rng.normal(size=(20, 3)).astype(np.float32)
        messages.append(Scan(stamp, points, topic="/points"))
    write_recording(path, messages)
    return path


def write(path, good, variant):
    """The messages of `good` in a file with these features, in chunks of one or two messages."""
    kinds = writer.IndexType
    index = kinds.ATTACHMENT | kinds.METADATA
    index |= kinds.CHUNK if variant.chunk_index else kinds.NONE
    index |= kinds.MESSAGE if variant.message_index else kinds.NONE
    with path.open("wb") as file, open_recording(good, trusted=True) as recording:
        assert isinstance(recording, McapRecording)
        made = writer.Writer(
            file,
            chunk_size=1000,
            compression=writer.CompressionType[variant.compression],
            index_types=index,
            repeat_channels=variant.channels,
            repeat_schemas=variant.schemas,
            use_chunking=variant.has_chunks,
            use_statistics=variant.statistics,
            use_summary_offsets=variant.offsets,
        )
        made.start("", "another writer")
        known = {}
        for channel, schema, message in recording.stored():
            if channel.id not in known:
                number = made.register_schema(schema.name, schema.encoding, schema.data)
                about = (channel.topic, channel.message_encoding, number, channel.metadata)
                known[channel.id] = made.register_channel(*about)
            times = {"log_time": message.log_time, "publish_time": message.publish_time}
            made.add_message(known[channel.id], data=message.data, **times)
        made.add_attachment(1, 2, "note", "text/plain", b"abc")
        made.add_metadata("robot", {"name": "a"})
        made.finish()


@pytest.fixture
def with_later_fields(monkeypatch):
    """Every record has more fields than the format of today."""
    finish = data_stream.RecordBuilder.finish_record

    def finish_longer(self):
        if self._buffer.getbuffer()[self._record_start_offset] not in (FOOTER, MESSAGE):
            self.write(LATER)
        finish(self)

    def chosen(is_on):
        used = finish_longer if is_on else finish
        monkeypatch.setattr(data_stream.RecordBuilder, "finish_record", used)

    return chosen


def check(variants, folder, good, with_later_fields):
    expected = told(good)[:2]
    assert len(expected[1]) == 12
    differ = {}
    for variant in variants:
        path = folder / f"{variant}.mcap"
        with_later_fields(variant.later)
        write(path, good, variant)
        for recover in BOTH:
            topics, messages, notes = told(path, recover=recover)
            if (topics, messages) != expected or (recover and any("lost" in one for one in notes)):
                differ[f"{variant}, recover={recover}"] = topics, len(messages), notes
        path.unlink()
    assert not differ


def test_files_of_other_writers_have_the_same_messages(tmp_path, good, with_later_fields):
    check(SOME, tmp_path, good, with_later_fields)


@pytest.mark.nightly
def test_every_variant_has_the_same_messages(tmp_path, good, with_later_fields):
    assert len({str(one) for one in EVERY}) == 416
    check(EVERY, tmp_path, good, with_later_fields)


def chunk(data, **values):
    fields = {"compression": "", "uncompressed_size": len(data), "uncompressed_crc": 0}
    times = {"message_start_time": 0, "message_end_time": 0}
    return records.Chunk(data=data, **{**times, **fields, **values})


MESSAGE_BYTES = struct.pack("<BQHIQQ", MESSAGE, 22 + 3, 1, 7, 20, 30) + b"abc"


def test_messages_of_a_chunk():
    unknown = struct.pack("<BQ", 200, 4) + b"1234"
    found = chunk_records(chunk(unknown + MESSAGE_BYTES), "file", 1000)
    expected = records.Message(channel_id=1, log_time=20, data=b"abc", publish_time=30, sequence=7)
    assert found == [expected]


@pytest.mark.parametrize(
    ("data", "values", "says"),
    [
        (MESSAGE_BYTES[:-1], {}, "record of 25 bytes where 24 are left"),
        (MESSAGE_BYTES + b"123", {}, "ends with 3 bytes that are no record"),
        (struct.pack("<BQ", MESSAGE, 21) + bytes(21), {}, "message of 21 bytes, the least is 22"),
        (struct.pack("<BQ", MESSAGE, 2**63), {}, "record of 9223372036854775808 bytes where 0"),
        (MESSAGE_BYTES, {"uncompressed_crc": 5}, "file: damaged, its crc is 0x"),
        (MESSAGE_BYTES, {"uncompressed_size": 5}, "declared 5 bytes"),
        (MESSAGE_BYTES, {"compression": "brotli"}, "unknown compression 'brotli'"),
    ],
)
def test_chunks_that_no_writer_makes_are_errors(data, values, says):
    with pytest.raises(FormatError, match=says):
        chunk_records(chunk(data, **values), "file", 1000)


def test_a_channel_without_its_schema_is_an_error(tmp_path):
    path = tmp_path / "none.mcap"
    with path.open("wb") as file:
        made = writer.Writer(file)
        made.start("", "another writer")
        number = made.register_schema("foxglove.PointCloud", "protobuf", b"")
        channel = made.register_channel("/points", "protobuf", number)
        made._Writer__schemas.clear()  # those that the summary repeats
        made._Writer__chunk_builder.reset()
        made.add_message(channel, 1, b"abc", 1)
        made.finish()
    with open_recording(path, trusted=True) as recording:
        (topic,) = recording.topics()
        assert (topic.name, topic.type, topic.kind) == ("/points", "", "other")
        with pytest.raises(FormatError, match="/points: schema 1 is nowhere in the file"):
            list(recording)
