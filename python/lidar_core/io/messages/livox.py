"""Decoder of Livox' own clouds, CustomMsg: a header and rows of one size, read as one array.

The library makes an object of every point. That takes longer than the scan itself: 0.1 s for
20,000 points.
"""

import struct
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidar_core.errors import FormatError
from lidar_core.io.files.guard import check_size

LIVOX_TYPES = ("livox_ros_driver/msg/CustomMsg", "livox_ros_driver2/msg/CustomMsg")
_FIELDS = {
    "offset_time": "u4",
    "x": "f4",
    "y": "f4",
    "z": "f4",
    "reflectivity": "u1",
    "tag": "u1",
    "line": "u1",
}
_ROW_BYTES = 19
_BETWEEN = 8 + 4 + 1 + 3  # timebase, point_num, lidar_id, rsvd: between frame and number of rows


class LivoxCloud(NamedTuple):
    """Points of a message as an array of rows, its time [ns], its frame."""

    rows: NDArray[Any]
    stamp_ns: int
    frame_id: str


def livox_cloud(raw: bytes, version: int, *, place: str, max_points: int) -> LivoxCloud:
    """Read a serialised CustomMsg of ROS 1 or 2.

    Raises
    ------
    FormatError
        Fewer bytes than the message claims.
    LimitError
        More than `max_points` points.
    """
    try:
        return _cloud1(raw, place, max_points) if version == 1 else _cloud2(raw, place, max_points)
    except (struct.error, UnicodeDecodeError) as error:
        raise FormatError(f"{place}: not a CustomMsg of Livox: {error}") from error


def _cloud1(raw: bytes, place: str, max_points: int) -> LivoxCloud:
    """Read a cloud serialised by ROS 1, where everything is packed."""
    _, seconds, nanoseconds, length = struct.unpack_from("<IIII", raw)
    frame = raw[16 : 16 + length].decode()
    rows = _rows(raw, 16 + length + _BETWEEN, "<", _ROW_BYTES, place, max_points)
    return LivoxCloud(rows, seconds * 10**9 + nanoseconds, frame)


def _cloud2(raw: bytes, place: str, max_points: int) -> LivoxCloud:
    """Read a cloud serialised as CDR (ROS 2).

    The first four bytes state the byte order. Numbers then lie at multiples of their sizes.
    """
    order, body = "<" if raw[1:2] == b"\x01" else ">", raw[4:]
    seconds, nanoseconds, length = struct.unpack_from(f"{order}iII", body)
    frame = body[12 : 12 + length].rstrip(b"\0").decode()
    between = (12 + length + 7) // 8 * 8
    rows = _rows(body, between + _BETWEEN, order, _ROW_BYTES + 1, place, max_points)
    return LivoxCloud(rows, seconds * 10**9 + nanoseconds, frame)


def _rows(
    data: bytes, position: int, order: str, step: int, place: str, max_points: int
) -> NDArray[Any]:
    """Read the rows that follow their number; the last row may lack its padding."""
    (count,) = struct.unpack_from(f"{order}I", data, position)
    check_size(place, count, limit=max_points, key="max_points", what="a scan of points")
    names, formats = list(_FIELDS), [order + code for code in _FIELDS.values()]
    packed = np.dtype({"names": names, "formats": formats})
    offsets = [packed.fields[name][1] for name in names] if packed.fields is not None else []
    dtype = np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": step})
    found = data[position + 4 : position + 4 + count * step]
    if len(found) < count * step - (step - _ROW_BYTES):
        raise FormatError(f"{place}: {count} points do not fit {len(found)} bytes")
    return np.frombuffer(found.ljust(count * step, b"\0"), dtype)
