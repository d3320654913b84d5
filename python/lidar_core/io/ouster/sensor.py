"""Reader of the JSON file of an Ouster sensor, as firmware 1.12 to 3.2 write it.

Layouts: Ouster firmware user manuals, "Sensor metadata"; ouster-sdk writes the same with more.
"""

import json
import re
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidar_core.errors import FormatError
from lidar_core.files import check_regular
from lidar_core.io.files.guard import check_size, reading

FloatArray = NDArray[np.float64]
MILLIMETRE = 1e-3
MOST_ROWS, MOST_COLUMNS, MOST_IN_PACKET = 1024, 65_535, 64
LEGACY = "LEGACY"
MOST_METADATA_BYTES = 4 * 2**20
BEAM_ORIGINS_MM = {"OS-0": 27.67, "OS-1": 15.806, "OS-2": 13.762}
"""Distance of the beams' origin from the axis of rotation, where a file leaves it out."""
LIDAR_TO_SENSOR = (-1, 0, 0, 0, 0, -1, 0, 0, 0, 0, 1, 36.18, 0, 0, 0, 1)
FIRST_MODE, FIRST_ROWS, FIRST_SHIFT = "1024x10", 64, 3
"""Of firmware 1: its files have no data format; rows differ by 3 columns of 512, or as much."""


class Beams(NamedTuple):
    """Geometry of all pixels: a point is range * direction + offset.

    Attributes
    ----------
    directions, offsets : ndarray, shape (rows, columns, 3)
        Unit vectors and offsets [m] in the sensor's frame.
    """

    directions: FloatArray
    offsets: FloatArray


@dataclass(frozen=True, eq=False)
class Sensor:
    """One sensor, as its file describes it.

    Attributes
    ----------
    product : str
        Name of the product line, such as OS-1-128.
    serial : int or None
        Serial number.
    rows, columns : int
        Size of a frame.
    in_packet : int
        Columns per packet.
    window : tuple of int
        First and last column that it sends.
    profile : str
        Layout of its packets.
    is_fusa : bool
        True if packets begin with the header of functional safety.
    port : int or None
        UDP port that it sends to.
    shifts : ndarray, shape (rows,)
        Number of columns by which each row must be shifted so that columns share an azimuth.
    altitudes, azimuths : ndarray, shape (rows,)
        Angles of the beams [rad].
    lidar_from_beam, sensor_from_lidar, body_from_sensor : ndarray, shape (4, 4)
        Transforms; lengths of the first two in millimetres, of the last in metres.
    """

    product: str
    serial: int | None
    rows: int
    columns: int
    in_packet: int
    window: tuple[int, int]
    profile: str
    is_fusa: bool
    port: int | None
    shifts: NDArray[np.int64]
    altitudes: FloatArray
    azimuths: FloatArray
    lidar_from_beam: FloatArray
    sensor_from_lidar: FloatArray
    body_from_sensor: FloatArray

    @cached_property
    def beams(self) -> Beams:
        """Return directions and offsets of all pixels."""
        encoder = -2 * np.pi / self.columns * np.arange(self.columns)
        angle = encoder - self.azimuths[:, None]
        level = np.cos(self.altitudes)[:, None]
        height = np.broadcast_to(np.sin(self.altitudes)[:, None], angle.shape)
        directions = np.stack([np.cos(angle) * level, np.sin(angle) * level, height], axis=-1)
        reach, rise = self.lidar_from_beam[0, 3], self.lidar_from_beam[2, 3]
        # Ranges are counted from the axis: a beam begins where it has run this far already.
        run = np.hypot(reach, rise)
        origins = np.stack(
            [reach * np.cos(encoder), reach * np.sin(encoder), np.full(self.columns, rise)], axis=-1
        )
        offsets = origins - run * directions
        rotation, shift = self.sensor_from_lidar[:3, :3], self.sensor_from_lidar[:3, 3]
        return Beams(directions @ rotation.T, (offsets @ rotation.T + shift) * MILLIMETRE)


def read_sensor(path: str | Path, *, max_points: int) -> Sensor:
    """Read the sensor of a JSON file.

    Raises
    ------
    FormatError
        The file is no regular file or larger than any metadata, or as of `parse_sensor`.
    """
    place = check_regular(path)
    if place.stat().st_size > MOST_METADATA_BYTES:
        raise FormatError(f"{place}: not the metadata of an Ouster sensor: the file is too large")
    return parse_sensor(place.read_bytes(), str(path), max_points=max_points)


def parse_sensor(text: str | bytes, place: str, *, max_points: int) -> Sensor:
    """Read the sensor of a JSON text.

    Raises
    ------
    FormatError
        The text has another format, or describes a sensor whose frames are not read.
    LimitError
        The frames are larger than `max_points`.
    """
    with reading(f"{place}: metadata of an Ouster sensor"):
        stored = json.loads(text)
        if not isinstance(stored, dict):
            raise FormatError(
                f"{place}: not the metadata of an Ouster sensor: expected a JSON object"
            )
        return _sensor(_Entries(stored), place, max_points)


class _Entries:
    """Values of a JSON file by name, at the top level or in a group of later firmware."""

    _PARTS = (
        "sensor_info",
        "beam_intrinsics",
        "lidar_intrinsics",
        "lidar_data_format",
        "data_format",
        "config_params",
        "ouster-sdk",
    )

    def __init__(self, stored: dict[str, Any]) -> None:
        parts = [stored.get(name) for name in self._PARTS]
        self._parts = [stored, *(part for part in parts if isinstance(part, dict))]

    def get(self, name: str, default: Any = None) -> Any:
        return next((part[name] for part in self._parts if name in part), default)


def _sensor(entries: _Entries, place: str, max_points: int) -> Sensor:
    altitudes = _angles(entries, "beam_altitude_angles", place)
    azimuths = _angles(entries, "beam_azimuth_angles", place)
    mode = str(entries.get("lidar_mode") or FIRST_MODE)
    found = re.match(r"(\d+)x\d+$", mode)
    columns = int(entries.get("columns_per_frame") or (found[1] if found else 0))
    rows = int(entries.get("pixels_per_column") or FIRST_ROWS)
    in_packet = int(entries.get("columns_per_packet") or 16)
    _check_counts(rows, columns, in_packet, place)
    check_size(place, rows * columns, limit=max_points, key="max_points", what="a scan of points")
    if altitudes.shape != (rows,) or azimuths.shape != (rows,):
        raise FormatError(
            f"{place}: {altitudes.size} altitude and {azimuths.size} azimuth angles of beams,"
            f" expected {rows} of each: sensors with angles for every pixel are not read"
        )
    shifts = np.asarray(entries.get("pixel_shift_by_row", _first_shifts(rows, columns)), np.int64)
    if shifts.shape != (rows,):
        raise FormatError(f"{place}: pixel_shift_by_row: expected {rows} numbers")
    product = str(entries.get("prod_line", ""))
    window = entries.get("column_window", [0, columns - 1])
    serial, port = entries.get("prod_sn"), entries.get("udp_port_lidar")
    return Sensor(
        product,
        int(serial) if serial else None,
        rows,
        columns,
        in_packet,
        (int(window[0]) % columns, int(window[1]) % columns),
        str(entries.get("udp_profile_lidar") or LEGACY),
        entries.get("header_type") == "FUSA",
        int(port) if port else None,
        shifts,
        altitudes,
        azimuths,
        _beam_origin(entries, product, place),
        _matrix(entries.get("lidar_to_sensor_transform", LIDAR_TO_SENSOR), place),
        _matrix(entries.get("extrinsic", np.eye(4)), place),
    )


def _check_counts(rows: int, columns: int, in_packet: int, place: str) -> None:
    for name, size, most in (
        ("pixels_per_column", rows, MOST_ROWS),
        ("columns_per_frame", columns, MOST_COLUMNS),
        ("columns_per_packet", in_packet, MOST_IN_PACKET),
    ):
        if not 1 <= size <= most:
            raise FormatError(f"{place}: {name}: expected 1 to {most}, got {size}")


def _beam_origin(entries: _Entries, product: str, place: str) -> FloatArray:
    given = entries.get("beam_to_lidar_transform")
    if given is not None:
        return _matrix(given, place)
    result = np.eye(4)
    usual = BEAM_ORIGINS_MM.get(product[:4], BEAM_ORIGINS_MM["OS-1"])
    result[0, 3] = float(entries.get("lidar_origin_to_beam_origin_mm", usual))
    return result


def _first_shifts(rows: int, columns: int) -> NDArray[np.int64]:
    return FIRST_SHIFT * columns // 512 * (np.arange(rows) % 4)


def _angles(entries: _Entries, name: str, place: str) -> FloatArray:
    degrees = np.asarray(entries.get(name, []), np.float64)
    if degrees.size == 0 or not np.isfinite(degrees).all():
        raise FormatError(f"{place}: not the metadata of an Ouster sensor: no {name}")
    return np.radians(degrees)


def _matrix(numbers: Any, place: str) -> FloatArray:
    matrix = np.asarray(numbers, np.float64).reshape(4, 4)
    if not np.isfinite(matrix).all():
        raise FormatError(f"{place}: a transform is not finite")
    return matrix
