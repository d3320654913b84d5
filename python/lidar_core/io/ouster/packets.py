"""Decoder of Ouster's LiDAR packets: columns of pixels, collected to frames.

Layouts: Ouster firmware user manuals, "Lidar data format", profiles of firmware 1.12 to 3.2.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidar_core.errors import FormatError
from lidar_core.io.ouster.sensor import LEGACY, Sensor

HEADER_BYTES = FOOTER_BYTES = 32
"""Of a packet, in all profiles but the legacy one."""
COLUMN_IS_VALID = 1  # bit of a column's status
LIDAR_PACKET = 1  # type in the header
SECOND_AT = 4  # bytes from the first return of a pixel to the second, in all profiles with two
MOST_LATE = 2  # frames that a packet may come late, and is known to be late


class _Pixel(NamedTuple):
    """Positions of range and reflectivity in the bytes of a pixel of one profile."""

    size: int
    range_bits: int
    range_shift: int
    reflectivity_at: int
    returns: int = 1


PROFILES: dict[str, _Pixel] = {
    LEGACY: _Pixel(12, 20, 0, 4),
    "RNG19_RFL8_SIG16_NIR16": _Pixel(12, 19, 0, 4),
    "RNG19_RFL8_SIG16_NIR16_ZONE16": _Pixel(12, 19, 0, 4),
    "RNG19_RFL8_SIG16_NIR16_RGB16": _Pixel(16, 19, 0, 3),
    "RNG19_RFL8_SIG16_NIR16_DUAL": _Pixel(16, 19, 0, 3, 2),
    "RNG19_RFL8_SIG16_ZONE16_DUAL": _Pixel(16, 19, 0, 3, 2),
    "RNG19_RFL8_SIG16_NIR16_RGB16_DUAL": _Pixel(20, 19, 0, 3, 2),
    "FIVE_WORD_PIXEL": _Pixel(20, 19, 0, 3, 2),
    "RNG15_RFL8_NIR8": _Pixel(4, 15, 3, 2),
    "RNG15_RFL8_WIN8": _Pixel(4, 15, 3, 2),
    "RNG15_RFL8_NIR8_ZONE16": _Pixel(8, 15, 3, 2),
    "RNG15_RFL8_NIR8_DUAL": _Pixel(8, 15, 3, 2, 2),
    "FUSA_RNG15_RFL8_NIR8_DUAL": _Pixel(8, 15, 3, 2, 2),
}


@dataclass(slots=True, eq=False)
class Frame:
    """One turn of a sensor.

    Attributes
    ----------
    ranges : ndarray of uint32, shape (rows, columns)
        Ranges [mm]; 0 without return.
    reflectivity : ndarray or None, shape (rows, columns)
        Uncalibrated or calibrated, as the sensor's firmware has it.
    stamps_ns : ndarray of int64, shape (columns,)
        Times by the sensor's clock [ns].
    is_received : ndarray of bool, shape (columns,)
        Columns that arrived and are valid.
    world_from_body : ndarray or None, shape (columns, 4, 4)
        Poses, if the file contains any.
    returns : int
        Returns per pixel that were sent.
    is_second : bool
        True if this is the second return, not the first.
    """

    ranges: NDArray[np.uint32]
    reflectivity: NDArray[np.generic] | None
    stamps_ns: NDArray[np.int64]
    is_received: NDArray[np.bool_]
    world_from_body: NDArray[np.float64] | None = None
    returns: int = 1
    is_second: bool = False


class PacketLayout:
    """Sizes and places in the packets of one sensor.

    Raises
    ------
    FormatError
        The profile is not known, or has no second return where that is wanted.

    Attributes
    ----------
    size : int
        Bytes of a packet.
    frame_numbers : int
        Number of frame numbers before they start again.
    """

    def __init__(self, sensor: Sensor, place: str, *, is_second: bool = False) -> None:
        pixel = PROFILES.get(sensor.profile)
        if pixel is None:
            raise FormatError(
                f"{place}: packets of profile {sensor.profile!r} are not read; known are"
                f" {', '.join(PROFILES)}"
            )
        if is_second and pixel.returns < 2:
            raise FormatError(f"{place}: {one_return(sensor.profile)}")
        self.sensor, self.pixel, self._is_second = sensor, pixel, is_second
        self._is_legacy = sensor.profile == LEGACY
        self._is_fusa = sensor.is_fusa or sensor.profile.startswith("FUSA")
        pixels = ("pixels", _pixel_type(pixel, SECOND_AT * is_second), (sensor.rows,))
        self._column = np.dtype(
            [
                ("stamp", "<u8"),
                ("number", "<u2"),
                *([("frame", "<u2"), ("encoder", "<u4")] if self._is_legacy else []),
                *([] if self._is_legacy else [("status", "<u2")]),
                pixels,
                *([("status", "<u4")] if self._is_legacy else []),
            ]
        )
        self._header = 0 if self._is_legacy else HEADER_BYTES
        footer = 0 if self._is_legacy else FOOTER_BYTES
        self._payload = self._column.itemsize * sensor.in_packet
        self.size = self._header + self._payload + footer
        self.frame_numbers = 2**32 if self._is_fusa else 2**16

    def is_lidar(self, packet: bytes) -> bool:
        """True if bytes are a LiDAR packet of this layout; drivers may append a byte."""
        if not self.size <= len(packet) <= self.size + 1:
            return False
        if self._is_legacy:
            return True
        kind = packet[0] if self._is_fusa else int.from_bytes(packet[:2], "little")
        return kind == LIDAR_PACKET

    def frame_number(self, packet: bytes) -> int:
        """Number of the frame that a packet belongs to."""
        at, size = (10, 2) if self._is_legacy else (4, 4) if self._is_fusa else (2, 2)
        return int.from_bytes(packet[at : at + size], "little")

    def serial(self, packet: bytes) -> int | None:
        """Serial number of the sensor that sent a packet; legacy packets do not contain it."""
        if self._is_legacy:
            return None
        at = 11 if self._is_fusa else 7
        return int.from_bytes(packet[at : at + 5], "little")

    def frame(self, packets: list[bytes]) -> Frame:
        """Make a frame from its packets in any order; a later copy of a column replaces it."""
        sensor = self.sensor
        ends = self._header + self._payload
        columns = np.frombuffer(
            b"".join(packet[self._header : ends] for packet in packets), self._column
        )
        is_valid = (columns["status"] & COLUMN_IS_VALID).astype(bool)
        columns = columns[is_valid & (columns["number"] < sensor.columns)]
        numbers = columns["number"]
        shape = (sensor.rows, sensor.columns)
        frame = Frame(
            np.zeros(shape, np.uint32),
            np.zeros(shape, np.uint8),
            np.zeros(sensor.columns, np.int64),
            np.zeros(sensor.columns, bool),
            returns=self.pixel.returns,
            is_second=self._is_second,
        )
        pixels = columns["pixels"]
        ranges = pixels["range"] & np.uint32(2**self.pixel.range_bits - 1)
        frame.ranges[:, numbers] = (ranges << np.uint32(self.pixel.range_shift)).T
        assert frame.reflectivity is not None
        frame.reflectivity[:, numbers] = pixels["reflectivity"].T
        frame.stamps_ns[numbers] = columns["stamp"].astype(np.int64)
        frame.is_received[numbers] = True
        return frame


def one_return(profile: str) -> str:
    """Return why the second return cannot be read from such packets."""
    return f"profile {profile} has one return per beam; expected returns='first', got 'second'"


def _pixel_type(pixel: _Pixel, at: int) -> np.dtype[np.void]:
    return np.dtype(
        {
            "names": ["range", "reflectivity"],
            "formats": ["<u4", "u1"],
            "offsets": [at, at + pixel.reflectivity_at],
            "itemsize": pixel.size,
        }
    )


class FrameCollector:
    """Collector of arriving packets to frames; a frame ends when the next one begins.

    A frame whose packets have all arrived is returned at once. Packets of the frame before are
    late and dropped.

    Attributes
    ----------
    layout : PacketLayout
        Layout of the packets.
    late : int
        Packets that were dropped.
    refused : int
        Frames of which more than half of the packets came after a later frame, or once more.
    """

    def __init__(self, layout: PacketLayout) -> None:
        self.layout = layout
        sensor = layout.sensor
        first, last = sensor.window
        columns = (last - first) % sensor.columns + 1
        # A window that begins inside a packet touches one packet more.
        self._expected = -(-(columns + first % sensor.in_packet) // sensor.in_packet)
        self._packets: list[bytes] = []
        self._number: int | None = None
        self._is_done = False
        self._dropped: tuple[int, int] = 0, 0  # number of a frame, and packets of it
        self.late = self.refused = 0

    def add(self, packet: bytes) -> list[Frame]:
        """Process a packet; return the frames that it completes: the one before, or its own."""
        number = self.layout.frame_number(packet)
        done: list[Frame] = []
        if number != self._number:
            if self._is_late(number):
                self.late += 1
                self._drop(number)
                return done
            done += self.rest()
            self._number, self._is_done = number, False
        elif self._is_done:
            self._drop(number)
            return done  # a packet that came twice
        self._packets.append(packet)
        if len(self._packets) >= self._expected:
            done += self.rest()
            self._is_done = True
        return done

    @property
    def is_open(self) -> bool:
        """Return whether a frame has begun and its packets are not yet returned."""
        return bool(self._packets)

    def rest(self) -> list[Frame]:
        """Return the frame that has begun, complete or not; None if no packet waits."""
        if not self._packets:
            return []
        packets, self._packets = self._packets, []
        return [self.layout.frame(packets)]

    def _drop(self, number: int) -> None:
        """Count a dropped packet: single ones are usual, whole frames are not."""
        before, count = self._dropped
        count = count + 1 if number == before else 1
        if count == self._expected // 2 + 1:
            self.refused += 1
        self._dropped = number, count % self._expected  # the frame may come again and again

    def _is_late(self, number: int) -> bool:
        if self._number is None:
            return False
        return 1 <= (self._number - number) % self.layout.frame_numbers <= MOST_LATE
