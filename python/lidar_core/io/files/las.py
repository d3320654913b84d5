"""Reader of points and intensities in LAS and LAZ files that checks all stated sizes itself.

lazrs trusts the sizes of chunks and layers in a file, and allocates that much memory: a file of 2
KB ended the process. So lazrs gets one chunk at a time, cut out and measured here, and never a
table from the file.
"""

import struct
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidar_core.errors import FormatError, LimitError
from lidar_core.extras import require
from lidar_core.io.files.guard import check_size, reading
from lidar_core.io.options import ReadOptions

MOST_RECORD = 256
"""Bytes of one compressed point, at most: each extra byte costs the library a model of its own."""
POINTS_PER_BYTE, MOST_RATIO = 200, 4000
"""Points and bytes that one compressed byte may promise. Three million copies of one point have 145
and 3,500, a scan some 0.2 and 4."""
POINTS_PER_CHUNK, FREE_CHUNKS = 256, 64
"""Chunks beyond the first 64 must hold so many points on average: each costs about 1 ms to begin.
LASzip makes chunks of 50,000."""
BLOCK_BYTES = 16 * 2**20
"""Points that are unpacked at a time."""

_HEAD = struct.Struct("<4s20x2B68xH2IBHI")
"""Signature, version (major, minor), sizes: header, offset to the points, records, format, point
length, number of points (LAS 1.4 specification, table 3)."""
_SCALES_AT, _COUNT_AT, _COUNT_END = 131, 247, 255
_RECORD_HEAD = struct.Struct("<2x16sHH32x")
_LASZIP = (b"laszip encoded", 22204)
_CHUNK_SIZE_AT, _ITEMS_AT, _ITEM = 12, 32, struct.Struct("<3H")
_RAW_BYTES = (20, 28, 26, 34, 57, 63, 30, 36, 38, 59, 67)
"""Bytes of a point without extra bytes, by point format."""
_ITEMS: dict[int, tuple[int, ...]] = {
    0: (6,),
    1: (6, 7),
    2: (6, 8),
    3: (6, 7, 8),
    4: (6, 7, 9),
    5: (6, 7, 8, 9),
    6: (10,),
    7: (10, 11),
    8: (10, 12),
    9: (10, 13),
    10: (10, 12, 13),
}
"""Parts that LASzip makes of each point format; extra bytes follow as part 0 or 14."""
_ITEM_BYTES = {6: 20, 7: 8, 8: 6, 9: 29, 10: 30, 11: 6, 12: 8, 13: 29}
_ITEM_LAYERS = {10: 9, 11: 1, 12: 2, 13: 1}
_BYTES, _BYTES14 = 0, 14
_ONE_STREAM, _POINTWISE, _LAYERED = 1, 2, 3
_VARIABLE = 2**32 - 1
_NO_TABLE = struct.pack("<II", 0, 0)


class Head(NamedTuple):
    """Header of a file, checked against the file's size."""

    points_at: int
    n_records: int
    point_format: int
    is_packed: bool
    point_bytes: int
    n_points: int
    scales: NDArray[np.float64]
    offsets: NDArray[np.float64]


class Packing(NamedTuple):
    """LASzip's record, checked against the header."""

    record: bytes
    kind: int
    chunk_points: int
    n_layers: int


def read_las(path: Path, options: ReadOptions) -> tuple[NDArray[np.float64], NDArray[np.float32]]:
    """Read points (N, 3) [m] and intensities (N,) of a LAS or LAZ file.

    Raises
    ------
    FormatError
        Sizes and counts of the file contradict each other or the file's own size, or it is broken.
    LimitError
        More points than `options` allow, or more than the compressed data can contain.
    """
    place, data = str(path), path.read_bytes()
    with reading(place):
        head = _head(place, data)
        check_size(
            place,
            head.n_points,
            limit=options.max_points,
            key="max_points",
            what="a cloud of points",
        )
        blocks = _unpack_laz(place, data, head) if head.is_packed else [_plain(place, data, head)]
        places, intensities, done = np.empty((head.n_points, 3)), np.empty(head.n_points, "f4"), 0
        for block in blocks:
            rows = slice(done, done + len(block))
            whole = np.ascontiguousarray(block[:, :12]).view("<i4")
            places[rows] = whole * head.scales + head.offsets
            intensities[rows] = np.ascontiguousarray(block[:, 12:14]).view("<u2")[:, 0]
            done += len(block)
    return places, intensities


def _head(place: str, data: bytes) -> Head:
    signature, major, minor, *sizes = _HEAD.unpack_from(data)
    size, points_at, n_records, kind, length, count = sizes
    if signature != b"LASF" or major != 1:
        raise FormatError(f"{place}: expected a LAS file of version 1, got {signature!r} {major}")
    if minor >= 4:
        (count,) = struct.unpack("<Q", data[_COUNT_AT:_COUNT_END])
    is_packed, point_format = bool(kind & 0x80), kind & 0x3F
    if point_format >= len(_RAW_BYTES) or length < _RAW_BYTES[point_format]:
        raise FormatError(
            f"{place}: points of {length} bytes do not fit point format {point_format}"
        )
    if not _SCALES_AT + 48 <= size <= points_at <= len(data):
        raise FormatError(
            f"{place}: header of {size} bytes, points at byte {points_at}, in a file of {len(data)}"
        )
    numbers = np.frombuffer(data, "<f8", 6, _SCALES_AT)
    if not np.isfinite(numbers).all():
        raise FormatError(f"{place}: scales and offsets are not finite: {numbers.tolist()}")
    known = points_at, n_records, point_format, is_packed, length, count
    return Head(*known, *numbers.reshape(2, 3))


def _plain(place: str, data: bytes, head: Head) -> NDArray[np.uint8]:
    needed, held = head.n_points * head.point_bytes, len(data) - head.points_at
    if needed > held:
        raise FormatError(
            f"{place}: {head.n_points} points of {head.point_bytes} bytes are stated, {held}"
            " bytes follow"
        )
    rows = np.frombuffer(data, np.uint8, needed, head.points_at)
    return rows.reshape(head.n_points, head.point_bytes)


def _unpack_laz(place: str, data: bytes, head: Head) -> Iterator[NDArray[np.uint8]]:
    """Yield the points of a LAZ file in parts."""
    if not head.n_points:
        return
    packing = _packing(place, data, head)
    start, end = _span(place, data, head, packing)
    _check_ratio(place, head, end - start)
    for first, last, count in _chunks(place, data, (start, end), head, packing):
        stream = data[first:last]
        if packing.kind != _ONE_STREAM:
            # In front of the points stands where the table of chunks is; ours has no entries.
            stream = struct.pack("<q", 8 + len(stream)) + stream + _NO_TABLE
        yield from _points_of(place, stream, packing.record, head.point_bytes, count)


def _packing(place: str, data: bytes, head: Head) -> Packing:
    record = _laszip_record(place, data, head)
    (kind,) = struct.unpack_from("<H", record)
    (chunk_points,) = struct.unpack_from("<I", record, _CHUNK_SIZE_AT)
    (n_items,) = struct.unpack_from("<H", record, _ITEMS_AT)
    most = min(n_items, (len(record) - _ITEMS_AT - 2) // _ITEM.size)
    items = [_ITEM.unpack_from(record, _ITEMS_AT + 2 + _ITEM.size * at) for at in range(most)]
    is_new = head.point_format >= 6
    extra = head.point_bytes - _RAW_BYTES[head.point_format]
    expected = [(item, _ITEM_BYTES[item]) for item in _ITEMS[head.point_format]]
    if extra or (items and items[-1][0] in (_BYTES, _BYTES14)):
        expected.append((_BYTES14 if is_new else _BYTES, extra))
    versions = {version for _, _, version in items}
    fits = n_items == most and [item[:2] for item in items] == expected
    if not fits or not versions <= ({3, 4} if is_new else {1, 2}):
        raise FormatError(
            f"{place}: compressed parts (kind, bytes, version) {items} are not those of point"
            f" format {head.point_format} in {head.point_bytes} bytes"
        )
    if kind not in ((_LAYERED,) if is_new else (_ONE_STREAM, _POINTWISE)):
        raise FormatError(f"{place}: compressor {kind} does not write format {head.point_format}")
    if head.point_bytes > MOST_RECORD:
        raise LimitError(
            f"{place}: compressed points of {head.point_bytes} bytes, limit"
            f" {MOST_RECORD}; unpack the file to LAS first"
        )
    layers = sum(_ITEM_LAYERS[item] for item, _ in expected if item in _ITEM_LAYERS)
    return Packing(
        _with_one_chunk(record), kind, chunk_points or _VARIABLE, layers + extra * is_new
    )


def _with_one_chunk(record: bytes) -> bytes:
    """Change LASzip's record to chunks so large that the library never begins a second one."""
    largest = struct.pack("<I", _VARIABLE - 1)
    return record[:_CHUNK_SIZE_AT] + largest + record[_CHUNK_SIZE_AT + 4 :]


def _laszip_record(place: str, data: bytes, head: Head) -> bytes:
    (at,) = struct.unpack_from("<H", data, 94)
    for _ in range(head.n_records):
        if at + _RECORD_HEAD.size > head.points_at:
            break
        user, number, length = _RECORD_HEAD.unpack_from(data, at)
        at += _RECORD_HEAD.size
        if (user.rstrip(b"\0"), number) == _LASZIP and at + length <= head.points_at:
            return data[at : at + length]
        at += length
    raise FormatError(f"{place}: compressed, but the record of LASzip is missing")


def _span(place: str, data: bytes, head: Head, packing: Packing) -> tuple[int, int]:
    """Return start and end of the compressed points [byte]; the table of chunks follows them."""
    if packing.kind == _ONE_STREAM:
        return head.points_at, len(data)
    (table_at,) = struct.unpack_from("<q", data, head.points_at)
    start = head.points_at + 8
    if table_at == -1 and len(data) >= start + 8:  # a writer that could not go back
        (table_at,) = struct.unpack("<q", data[-8:])
    if not start < table_at <= len(data):
        raise FormatError(
            f"{place}: table of chunks at byte {table_at}, points begin at {start},"
            f" the file has {len(data)} bytes"
        )
    return start, table_at


def _check_ratio(place: str, head: Head, packed: int) -> None:
    size = head.n_points * head.point_bytes
    if head.n_points > POINTS_PER_BYTE * packed or size > MOST_RATIO * packed:
        raise LimitError(
            f"{place}: {head.n_points} points ({size} bytes) in {packed} compressed bytes; the"
            f" limit is {POINTS_PER_BYTE} points and {MOST_RATIO} bytes per compressed byte"
        )


def _chunks(
    place: str, data: bytes, span: tuple[int, int], head: Head, packing: Packing
) -> Iterator[tuple[int, int, int]]:
    """Yield start, end [byte] and number of points of parts that the library reads at once."""
    at, end = span
    left, begun, most = head.n_points, 0, FREE_CHUNKS + head.n_points // POINTS_PER_CHUNK
    if packing.kind == _ONE_STREAM:
        yield at, end, left
        return
    if packing.kind == _POINTWISE:
        yield from _pointwise_chunks(place, data, span, head, packing, most)
        return
    while left > 0:
        stop, held = _layered_chunk(place, data, at, end, head, packing)
        count = held if packing.chunk_points == _VARIABLE else min(packing.chunk_points, left)
        begun += 1
        if not 0 < count <= left or begun > most:
            raise FormatError(
                f"{place}: chunk {begun} at byte {at} holds {count} points, {left}"
                f" are left, at most {most} chunks are possible"
            )
        yield at, stop, count
        at, left = stop, left - count


def _layered_chunk(
    place: str, data: bytes, at: int, end: int, head: Head, packing: Packing
) -> tuple[int, int]:
    """Return the end [byte] and the stated number of points of a layered chunk.

    Its layout: a point, the number of points, the sizes of the layers, the layers.
    """
    sizes_at = at + head.point_bytes
    layers_at = sizes_at + 4 * (1 + packing.n_layers)
    if layers_at > end:
        raise FormatError(f"{place}: compressed data ends early, in the chunk at byte {at}")
    held, *layers = struct.unpack_from(f"<{1 + packing.n_layers}I", data, sizes_at)
    if layers_at + sum(layers) > end:
        raise FormatError(
            f"{place}: layers of the chunk at byte {at} have {sum(layers)} bytes,"
            f" {end - layers_at} follow"
        )
    return layers_at + sum(layers), held


def _pointwise_chunks(
    place: str, data: bytes, span: tuple[int, int], head: Head, packing: Packing, most: int
) -> Iterator[tuple[int, int, int]]:
    """Yield the chunks of the old formats, as `_chunks`; only the table states where they begin."""
    start, end = span
    if head.n_points <= packing.chunk_points < _VARIABLE:
        yield start, end, head.n_points
        return
    n_chunks = struct.unpack_from("<4xI", data, end)[0] if end + 8 <= len(data) else 0
    # A chunk holds at least its first point, so the bytes bound how many there can be.
    if not 0 < n_chunks <= min(most, (end - start) // head.point_bytes):
        raise FormatError(
            f"{place}: {n_chunks} chunks for {end - start} compressed bytes and {head.n_points}"
            f" points, at most {most} are possible"
        )
    record = packing.record[:_CHUNK_SIZE_AT] + struct.pack("<I", packing.chunk_points)
    record += packing.record[_CHUNK_SIZE_AT + 4 :]
    stream = BytesIO(struct.pack("<q", 8) + data[end:])
    lazrs, left = _lazrs(), head.n_points
    with _no_panic(place):
        table = lazrs.read_chunk_table(stream, lazrs.LazVlr(record))
    for points, size in table:
        count = points if packing.chunk_points == _VARIABLE else min(packing.chunk_points, left)
        if not 0 < count <= left or not head.point_bytes <= size <= end - start:
            raise FormatError(
                f"{place}: chunk of {count} points in {size} bytes at byte {start},"
                f" {left} points and {end - start} bytes are left"
            )
        yield start, start + size, count
        start, left = start + size, left - count
        if not left:
            return
    raise FormatError(f"{place}: compressed data ends early, {left} points are missing")


def _points_of(
    place: str, stream: bytes, record: bytes, point_bytes: int, count: int
) -> Iterator[NDArray[np.uint8]]:
    lazrs = _lazrs()
    wanted = (
        lazrs.SELECTIVE_DECOMPRESS_XY_RETURNS_CHANNEL
        | lazrs.SELECTIVE_DECOMPRESS_Z
        | lazrs.SELECTIVE_DECOMPRESS_INTENSITY
    )
    with _no_panic(place):
        selection = lazrs.DecompressionSelection(wanted)
        source = lazrs.LasZipDecompressor(BytesIO(stream), record, selection)
    most = max(BLOCK_BYTES // point_bytes, 1)
    for done in range(0, count, most):
        rows = np.zeros((min(most, count - done), point_bytes), np.uint8)
        with _no_panic(place):
            source.decompress_many(rows.reshape(-1))
        yield rows


class _no_panic:  # noqa: N801
    """Context manager that turns a panic of the library, which is no `Exception`, into an error."""

    def __init__(self, place: str) -> None:
        self._place = place

    def __enter__(self) -> None:
        return

    def __exit__(self, kind: Any, error: BaseException | None, trace: Any) -> None:
        if kind is not None and kind.__name__ == "PanicException":
            raise FormatError(f"{self._place}: cannot be read: {error}") from error


def _lazrs() -> Any:
    return require("lazrs", extra="io", purpose="reading LAZ")
