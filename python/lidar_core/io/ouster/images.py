"""Decoder of images in OSF files: PNG, and differences compressed with zstd (Zpng).

Layouts: W3C "Portable Network Graphics"; Zpng by C. Taylor.
"""

import struct
import zlib
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidar_core.errors import FormatError
from lidar_core.io.files.compressed import zstd_data

PNG_MAGIC = b"\x89PNG\r\n\x1a\n"
ZPNG_MAGIC = b"\xf8\xfb"
_ZPNG_HEAD = struct.Struct("<HHHBB")
_GREY, _RGB, _RGBA = 0, 2, 6
_CHANNELS = {_GREY: 1, _RGB: 3, _RGBA: 4}
_SUB, _UP, _AVERAGE, _PAETH = 1, 2, 3, 4

Image = NDArray[np.unsignedinteger[Any]]


class _Rows(NamedTuple):
    """Rows of a PNG before their filters are undone.

    Attributes
    ----------
    filters : ndarray of uint8, shape (height,)
    values : ndarray of uint8, shape (height, width, bytes of a pixel)
    is_big : bool
        Whether the bytes of a pixel are one number, most significant first.
    """

    filters: NDArray[np.uint8]
    values: NDArray[np.uint8]
    is_big: bool


def is_png(data: bytes) -> bool:
    """True if bytes are a PNG; Ouster's PNGs have shifted rows."""
    return data.startswith(PNG_MAGIC)


def decode_pngs(images: Sequence[bytes], shape: tuple[int, int], place: str) -> list[Image]:
    """Numbers per pixel of images of the same size, each of shape (height, width).

    Raises
    ------
    FormatError
        One is not a PNG of this size with 8, 16, 24 or 32 bits per pixel.
    """
    parts = [_png_rows(data, shape, place) for data in images]
    filters = np.concatenate(
        [np.repeat(part.filters[:, None], part.values.shape[2], axis=1) for part in parts], axis=1
    )
    values = _unfiltered(filters, np.concatenate([part.values for part in parts], axis=2))
    result, first = [], 0
    for part in parts:
        size = part.values.shape[2]
        pixel = values[..., first : first + size]
        result.append(_numbers(pixel[..., ::-1] if part.is_big else pixel))
        first += size
    return result


def decode_zpng(data: bytes, shape: tuple[int, int], place: str) -> Image:
    """Decode a Zpng image of this shape, (height, width); errors are those of PNG images."""
    if len(data) < _ZPNG_HEAD.size or not data.startswith(ZPNG_MAGIC):
        raise FormatError(f"{place}: could not decode a field: neither PNG nor Zpng")
    _, width, height, channels, depth = _ZPNG_HEAD.unpack_from(data)
    size = channels * depth
    if (height, width) != shape or not 1 <= size <= 8:
        raise FormatError(
            f"{place}: could not decode a field: an image of {height} x {width} pixels of {size}"
            f" bytes, expected {shape[0]} x {shape[1]}"
        )
    expected = height * width * size
    plain = zstd_data(data[_ZPNG_HEAD.size :], place, expected)
    if len(plain) != expected:
        raise FormatError(f"{place}: could not decode a field: {len(plain)} bytes of {expected}")
    packed = np.frombuffer(plain, np.uint8)
    if size in (3, 4):
        blue, green, red, *rest = packed.reshape(size, height, width)
        green = green + blue
        changes = np.stack([green - red, green, blue, *rest], axis=-1)
    else:
        changes = packed.reshape(height, width, size)
    return _numbers(np.cumsum(changes, axis=1, dtype=np.uint8))


def _numbers(pixels: NDArray[np.uint8]) -> Image:
    """Convert the bytes in the last axis to whole numbers, least significant byte first."""
    size = next(fit for fit in (1, 2, 4, 8) if pixels.shape[2] <= fit)
    wide = np.zeros((*pixels.shape[:2], size), np.uint8)
    wide[..., : pixels.shape[2]] = pixels
    return wide.view(f"<u{size}")[..., 0]


def _png_rows(data: bytes, shape: tuple[int, int], place: str) -> _Rows:
    head, packed = _png_parts(data, place)
    width, height, depth, kind, _, _, interlace = head
    if (height, width) != shape or kind not in _CHANNELS or depth not in (8, 16) or interlace:
        raise FormatError(
            f"{place}: could not decode a field: a PNG of {height} x {width} pixels, depth {depth},"
            f" kind {kind}; expected {shape[0]} x {shape[1]}, 8 or 16 bits"
        )
    size = _CHANNELS[kind] * depth // 8
    expected = height * (1 + width * size)
    plain = zlib.decompressobj().decompress(packed, expected + 1)
    if len(plain) != expected:
        raise FormatError(f"{place}: could not decode a field: {len(plain)} bytes of {expected}")
    rows = np.frombuffer(plain, np.uint8).reshape(height, -1)
    if rows[:, 0].max() > _PAETH:
        raise FormatError(f"{place}: could not decode a field: filter {rows[:, 0].max()}")
    return _Rows(rows[:, 0], rows[:, 1:].reshape(height, width, size), kind == _GREY)


def _png_parts(data: bytes, place: str) -> tuple[tuple[int, ...], bytes]:
    """Return header values and compressed data of a PNG after a check of its checksums."""
    position, head, packed = len(PNG_MAGIC), None, []
    while position + 12 <= len(data):
        size, kind = struct.unpack_from(">I4s", data, position)
        end = position + 8 + size
        if (
            end + 4 > len(data)
            or zlib.crc32(data[position + 4 : end]) != struct.unpack_from(">I", data, end)[0]
        ):
            break
        if kind == b"IHDR" and size == 13:
            head = struct.unpack_from(">IIBBBBB", data, position + 8)
        elif kind == b"IDAT":
            packed.append(data[position + 8 : end])
        elif kind == b"IEND" and head is not None:
            return head, b"".join(packed)
        position = end + 4
    raise FormatError(f"{place}: could not decode a field: the PNG is damaged")


def _unfiltered(filters: NDArray[np.uint8], rows: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Undo the PNG filters: add to every byte its prediction from the bytes left and above.

    Bytes on a diagonal do not depend on each other, so they are computed together: row t of
    `known` holds the bytes of line r and column t - r, one column of the array per line.

    Parameters
    ----------
    filters : ndarray, shape (height, channels)
    rows : ndarray, shape (height, width, channels)
    """
    height, width, channels = rows.shape
    lines = np.arange(height)[:, None]
    steps = lines + np.arange(width)
    added = np.zeros((height + width - 1, height, channels), np.int16)
    added[steps, lines] = rows
    known = np.zeros((height + width + 1, height + 1, channels), np.int16)
    is_sub, is_up, is_average, is_paeth = (
        (filters == kind).astype(np.int16) for kind in (_SUB, _UP, _AVERAGE, _PAETH)
    )
    # Before the first and after the last byte of a line nothing is added, and zero is known.
    for step in range(height + width - 1):
        left, above, corner = known[step + 1, 1:], known[step + 1, :-1], known[step, :-1]
        to_left, to_above = np.abs(above - corner), np.abs(left - corner)
        to_corner = np.abs(left + above - 2 * corner)
        nearest = np.where(
            (to_left <= to_above) & (to_left <= to_corner),
            left,
            np.where(to_above <= to_corner, above, corner),
        )
        predicted = is_sub * left + is_up * above + is_paeth * nearest
        predicted += is_average * ((left + above) >> 1)
        first, last = max(0, step - width + 1), min(height, step + 1)
        values = (added[step, first:last] + predicted[first:last]) & 255
        known[step + 2, first + 1 : last + 1] = values
    values_by_line: NDArray[np.uint8] = known[steps + 2, lines + 1].astype(np.uint8)
    return values_by_line
