"""Decompression with a limit: the size that a file declares is not trusted."""

import bz2
from collections.abc import Callable
from io import SEEK_END, BytesIO
from pathlib import Path
from typing import Any, BinaryIO

from lidar_core.errors import FormatError, LimitError
from lidar_core.extras import require
from lidar_core.io.files.beginnings import ZSTD
from lidar_core.io.files.guard import reading

MOST_ZSTD_HEAD, ZSTD_BLOCK_HEAD = 18, 3
"""Bytes in front of a frame, at most, and in front of each of its blocks (RFC 8878)."""
MOST_RATIO, FREE_BYTES = 1000, 2**20
"""Compressed data may grow by this factor, and to 1 MiB in any case. Sensor data grows by less than
20; files made to fill memory or disk by 30,000 (zstd) and 1,000,000 (bz2)."""


def most_bytes(packed: int, limit: int) -> int:
    """Largest size allowed for `packed` compressed bytes after unpacking, at most `limit`."""
    return min(limit, max(FREE_BYTES, MOST_RATIO * packed))


def bounded_decompressor(
    original: Callable[[bytes], bytes], place: str, limit: int
) -> Callable[[bytes], bytes]:
    """Return a decompressor for bz2 or LZ4 like `original` that allows at most `limit` bytes.

    Other decompressors are returned as they are.
    """
    module = getattr(original, "__module__", "")
    if module == "bz2":
        return lambda data: _complete(bz2.BZ2Decompressor(), data, place, limit)
    if module.startswith("lz4"):
        return lambda data: lz4_data(data, place, limit)
    return original


def lz4_data(data: bytes, place: str, limit: int) -> bytes:
    """Decompress a frame of LZ4 to at most `limit` bytes."""
    frame = require("lz4.frame", extra="io", purpose="reading compressed recordings")
    return _complete(frame.LZ4FrameDecompressor(), data, place, limit)


def zstd_data(data: bytes, place: str, limit: int) -> bytes:
    """Decompress a frame of zstd to at most `limit` bytes."""
    _check_zstd(BytesIO(data), place)
    zstandard = _zstandard()
    most = most_bytes(len(data), limit)
    with zstandard.ZstdDecompressor().stream_reader(BytesIO(data)) as stream:
        output: bytes = stream.read(most + 1)
    _check_grown(len(output), len(data), limit, place)
    return output


def unpack_zstd(source: Path, target: Path, limit: int) -> int:
    """Decompress a file of one frame of zstd to `target`, at most `limit` bytes; return the size.

    Raises
    ------
    FormatError
        The file is cut short or broken, or there is another frame behind the first.
    LimitError
        The content would be larger than the limit, or more than 1,000 times as large as the file;
        no more than that is written.
    OSError
        `target` cannot be written, as on a full disk.
    """
    with source.open("rb") as packed, reading(str(source)):
        _check_zstd(packed, str(source))
        packed.seek(0)
        try:
            return _unpack(packed, source, target, limit)
        except OSError as error:
            told = f"{error.strerror}; TMPDIR names another folder to unpack {source} in"
            raise OSError(error.errno, told, str(target)) from error


def _unpack(packed: BinaryIO, source: Path, target: Path, limit: int) -> int:
    size, given = 0, source.stat().st_size
    with target.open("wb") as plain:
        for block in _zstandard().ZstdDecompressor().read_to_iter(packed):
            size += len(block)
            if size > limit:
                raise LimitError(
                    f"{source}: unpacks to more than {limit} bytes; raise it with"
                    f" max_unpacked_bytes, or unpack it: zstd -d {source.name}"
                )
            check_ratio(size, given, str(source))
            plain.write(block)
    return size


def _zstandard() -> Any:
    return require("zstandard", extra="io", purpose="reading compressed recordings")


def _check_zstd(file: BinaryIO, place: str) -> None:
    """Refuse truncated frames and several frames in a row, which the library accepts silently."""
    head = file.read(MOST_ZSTD_HEAD)
    zstandard = _zstandard()
    with reading(place):
        told = zstandard.get_frame_parameters(head)
        position = zstandard.frame_header_size(head)
    size, is_last = file.seek(0, SEEK_END), False
    while not is_last and position + ZSTD_BLOCK_HEAD <= size:
        file.seek(position)
        block = int.from_bytes(file.read(ZSTD_BLOCK_HEAD), "little")
        is_last, is_repeated, length = bool(block & 1), block >> 1 & 3 == 1, block >> 3
        position += ZSTD_BLOCK_HEAD + (1 if is_repeated else length)
    end = position + 4 * told.has_checksum
    if not is_last or end > size:
        raise FormatError(f"{place}: compressed data ends early")
    file.seek(end)
    if file.read(len(ZSTD)) == ZSTD:
        raise FormatError(f"{place}: compressed in several pieces; unpack it first: unzstd FILE")


def _complete(decompressor: Any, data: bytes, place: str, limit: int) -> bytes:
    most = most_bytes(len(data), limit)
    output: bytes = decompressor.decompress(data, max_length=most + 1)
    _check_grown(len(output), len(data), limit, place)
    if not decompressor.eof:
        raise FormatError(f"{place}: compressed data ends early")
    return output


def _check_grown(size: int, packed: int, limit: int, place: str) -> None:
    """Refuse output of `size` bytes so far from `packed` compressed bytes if it is too large."""
    if size > limit:
        raise LimitError(
            f"{place}: decompresses to more than {limit} bytes; raise it with max_record_bytes"
        )
    check_ratio(size, packed, place)


def check_ratio(size: int, packed: int, place: str) -> None:
    """Refuse output that is too large for its compressed data.

    Raises
    ------
    LimitError
        `size` bytes are more than 1 MiB and more than 1,000 times `packed`.
    """
    if size > max(FREE_BYTES, MOST_RATIO * packed):
        raise LimitError(
            f"{place}: {packed} compressed bytes become more than {MOST_RATIO} times as many"
            " bytes, which is suspicious; if you trust the file, decompress it with another"
            " program first"
        )
