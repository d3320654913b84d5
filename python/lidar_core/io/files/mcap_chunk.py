"""Records inside a chunk of an MCAP file.

The library's own function checks no lengths. Fields that a later version of the format may put
behind the known ones it takes for the next record.
"""

import struct
import zlib
from io import BytesIO
from typing import Any

from lidar_core.errors import FormatError
from lidar_core.extras import require
from lidar_core.io.files.compressed import lz4_data, zstd_data
from lidar_core.io.files.guard import check_size

RECORD_HEAD = struct.Struct("<BQ")  # operation code and length
CHUNK_CODE = b"\x06"
_MESSAGE = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time
_SCHEMA_CODE, _CHANNEL_CODE, _MESSAGE_CODE = 3, 4, 5


def chunk_records(chunk: Any, place: str, limit: int) -> list[Any]:
    """Schemas, channels and messages of a chunk.

    Raises
    ------
    FormatError
        Its checksum or a length is wrong.
    LimitError
        The chunk has more than `limit` bytes.
    """
    what = "a chunk of bytes"
    check_size(place, chunk.uncompressed_size, limit=limit, key="max_record_bytes", what=what)
    data = _decompress(chunk, place, limit)
    if chunk.uncompressed_crc not in (0, found := zlib.crc32(data)):
        told = f"{found:#x}, not {chunk.uncompressed_crc:#x}"
        raise FormatError(f"{place}: damaged, its crc is {told}")
    records, at = [], 0
    while at < len(data):
        if len(data) - at < RECORD_HEAD.size:
            raise FormatError(f"{place}: ends with {len(data) - at} bytes that are no record")
        code, length = RECORD_HEAD.unpack_from(data, at)
        at += RECORD_HEAD.size
        if length > len(data) - at:
            raise FormatError(f"{place}: record of {length} bytes where {len(data) - at} are left")
        if (record := _record(code, data[at : at + length], place)) is not None:
            records.append(record)
        at += length
    return records


def _record(code: int, data: bytes, place: str) -> Any:
    """Parse a record from its bytes; None if it is no schema, channel or message."""
    known = require("mcap.records", extra="io", purpose="reading MCAP")
    if code == _MESSAGE_CODE:
        if len(data) < _MESSAGE.size:
            raise FormatError(
                f"{place}: message of {len(data)} bytes, the least is {_MESSAGE.size}"
            )
        channel, sequence, log_time, publish_time = _MESSAGE.unpack_from(data)
        return known.Message(
            channel_id=channel,
            log_time=log_time,
            data=data[_MESSAGE.size :],
            publish_time=publish_time,
            sequence=sequence,
        )
    if code not in (_SCHEMA_CODE, _CHANNEL_CODE):
        return None
    streams = require("mcap.data_stream", extra="io", purpose="reading MCAP")
    kind = known.Schema if code == _SCHEMA_CODE else known.Channel
    return kind.read(streams.ReadDataStream(BytesIO(data)))


def _decompress(chunk: Any, place: str, limit: int) -> bytes:
    """Data of a chunk, at most `limit` bytes: the size that the file declares is not trusted."""
    data: bytes = chunk.data
    if chunk.compression == "zstd":
        data = zstd_data(data, place, limit)
    elif chunk.compression == "lz4":
        data = lz4_data(data, place, limit)
    elif chunk.compression:
        raise FormatError(f"{place}: unknown compression {chunk.compression!r}")
    if len(data) != chunk.uncompressed_size:
        raise FormatError(
            f"{place}: declared {chunk.uncompressed_size} bytes, holds {len(data)} or more"
        )
    return data
