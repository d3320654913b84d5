"""Decompression with a limit: the size that a file declares is not trusted."""

import bz2
from collections.abc import Callable
from io import BytesIO
from typing import Any

from lidar_core.errors import FormatError, LimitError
from lidar_core.extras import require

ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"


def bounded_decompressor(
    original: Callable[[bytes], bytes], place: str, limit: int
) -> Callable[[bytes], bytes]:
    """A decompressor like `original` that stops at `limit` bytes of output."""
    module = getattr(original, "__module__", "")
    if module == "bz2":
        return lambda data: _complete(bz2.BZ2Decompressor(), data, place, limit)
    if module.startswith("lz4"):
        return lambda data: lz4_data(data, place, limit)
    return original


def lz4_data(data: bytes, place: str, limit: int) -> bytes:
    """A frame of LZ4, decompressed to at most `limit` bytes."""
    frame = require("lz4.frame", extra="io", purpose="reading compressed recordings")
    return _complete(frame.LZ4FrameDecompressor(), data, place, limit)


def zstd_data(data: bytes, place: str, limit: int) -> bytes:
    """A frame of zstd, decompressed to at most `limit` bytes."""
    zstandard = require("zstandard", extra="io", purpose="reading compressed recordings")
    with zstandard.ZstdDecompressor().stream_reader(BytesIO(data)) as stream:
        output: bytes = stream.read(limit + 1)
    return _limited(output, place, limit)


def _complete(decompressor: Any, data: bytes, place: str, limit: int) -> bytes:
    output = _limited(decompressor.decompress(data, max_length=limit + 1), place, limit)
    if not decompressor.eof:
        raise FormatError(f"{place}: compressed data ends early")
    return output


def _limited(output: bytes, place: str, limit: int) -> bytes:
    if len(output) > limit:
        raise LimitError(
            f"{place}: decompresses to more than {limit} bytes; raise it with max_record_bytes"
        )
    return output
