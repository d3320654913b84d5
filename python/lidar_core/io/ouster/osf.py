"""Reader of OSF files of Ouster: sensors and frames, checked chunk by chunk.

Layout: the schemas of ouster-sdk (`ouster_osf/fb`), version 2.
"""

import heapq
import mmap
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from lidar_core.errors import FormatError
from lidar_core.io.files.guard import reading
from lidar_core.io.ouster.flatbuffer import SIZE_BYTES, Table, sized_table
from lidar_core.io.ouster.frames import shift_rows
from lidar_core.io.ouster.images import Image, decode_pngs, decode_zpng, is_png
from lidar_core.io.ouster.packets import COLUMN_IS_VALID, Frame, one_return
from lidar_core.io.ouster.sensor import Sensor, parse_sensor

SENSOR_TYPE, STREAM_TYPE = (
    b"ouster/v1/os_sensor/LidarSensor",
    b"ouster/v1/os_sensor/LidarScanStream",
)
RANGE, SECOND_RANGE, REFLECTIVITY, SECOND_REFLECTIVITY = 1, 2, 5, 6  # numbers of fields
WHOLE, MAJOR = 2, 2  # status of a file that was closed; version that is read
MAJOR_BITS, FIRST_VERSION = 48, 20  # versions are major << 48, before that 20 and 21
HINT = (
    "The file is damaged or of another version: take it from the source again, or convert it with"
    " the ouster-sdk that wrote it"
)


class _Chunk(NamedTuple):
    start_ns: int
    offset: int


class OsfFile:
    """Open OSF file.

    Attributes
    ----------
    sensors : list of Sensor
        In the order of the file.
    """

    def __init__(self, path: Path, *, max_points: int, is_second: bool = False) -> None:
        self._path, self._is_second = path, is_second
        with path.open("rb") as file:
            size = file.seek(0, 2)
            if size == 0:
                raise FormatError(f"{path}: the file is empty. {HINT}")
            self._data = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        try:
            with reading(f"{path}, header"):
                metadata = self._open()
            with reading(f"{path}, metadata"):
                self._chunks = sorted(
                    _Chunk(start, offset)
                    for start, _, offset in struct.iter_unpack("<QQQ", metadata.vector(3, 24))
                )
                self.sensors, self._sensor_of = self._entries(metadata, max_points)
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Close the file."""
        self._data.close()

    def frames(self) -> Iterator[tuple[int, Frame]]:
        """Frames with the number of their sensor, in the order in which they were recorded."""
        for number, (stream, message) in enumerate(self._messages()):
            place = f"{self._path}, frame {number}"
            with reading(place):
                sensor = self._sensor_of[stream]
                yield sensor, self._frame(self.sensors[sensor], sized_table(message), place)

    def _open(self) -> Table:
        """Check that the file is complete and of a supported version; return its metadata."""
        header = self._block(0, "header")
        table = sized_table(header)
        version = table.number(0, "Q")
        major = version >> MAJOR_BITS or (version // 10 if version >= FIRST_VERSION else 1)
        if major != MAJOR:
            minor, patch = version >> 32 & 0xFFFF, version >> 16 & 0xFFFF
            raise FormatError(
                f"{self._path}: schema version {major}.{minor}.{patch}, only version {MAJOR} is"
                f" read. {HINT}"
            )
        if table.number(1, "B") != WHOLE or table.number(3, "Q", 1) != len(self._data):
            raise FormatError(
                f"{self._path}: the file was not closed, or its end is missing: it has"
                f" {len(self._data)} bytes of {table.number(3, 'Q', 1)}. {HINT}"
            )
        self._first = len(header) + SIZE_BYTES
        return sized_table(self._block(table.number(2, "Q", 1), "metadata"))

    def _entries(self, metadata: Table, max_points: int) -> tuple[list[Sensor], dict[int, int]]:
        """Return the sensors, and the index of the sensor of every stream."""
        sensors: dict[int, Sensor] = {}
        streams: dict[int, int] = {}
        for entry in metadata.tables(4):
            number, kind = entry.number(0, "I"), bytes(entry.bytes(1))
            if kind == SENSOR_TYPE:
                text = bytes(sized_table(entry.bytes(2)).bytes(0))
                place = f"{self._path}, sensor {number}"
                sensors[number] = parse_sensor(text, place, max_points=max_points)
            elif kind == STREAM_TYPE:
                streams[number] = sized_table(entry.bytes(2)).number(0, "I")
        order = {number: index for index, number in enumerate(sensors)}
        strangers = sorted(set(streams.values()) - set(order))
        if strangers:
            raise FormatError(f"{self._path}: frames of unknown sensors {strangers}. {HINT}")
        return list(sensors.values()), {stream: order[one] for stream, one in streams.items()}

    def _messages(self) -> Iterator[tuple[int, memoryview]]:
        """Yield stored frames with their stream by time; chunks that overlap in time are merged."""
        pending: list[tuple[int, int, int, memoryview]] = []
        count = 0
        for chunk in self._chunks:
            while pending and pending[0][0] < chunk.start_ns:
                yield heapq.heappop(pending)[2:]
            with reading(f"{self._path}, chunk at byte {chunk.offset}"):
                table = sized_table(self._block(self._first + chunk.offset, "chunk"))
                for message in table.tables(0):
                    stream = message.number(1, "I")
                    if stream in self._sensor_of:
                        heapq.heappush(
                            pending, (message.number(0, "Q"), count, stream, message.bytes(2))
                        )
                        count += 1
        while pending:
            yield heapq.heappop(pending)[2:]

    def _block(self, offset: int, what: str) -> bytes:
        """Return a buffer after a check of the size before it and the checksum after it."""
        begin = offset + SIZE_BYTES
        if begin > len(self._data):
            raise FormatError(f"{self._path}: invalid {what} at byte {offset}: no data. {HINT}")
        (size,) = struct.unpack_from("<I", self._data, offset)
        end = begin + size
        if end + SIZE_BYTES > len(self._data):
            raise FormatError(f"{self._path}: invalid {what} at byte {offset}: cut. {HINT}")
        block = self._data[offset:end]
        if zlib.crc32(block) != struct.unpack_from("<I", self._data, end)[0]:
            raise FormatError(
                f"{self._path}: invalid {what} at byte {offset}: its checksum does not fit. {HINT}"
            )
        return block

    def _frame(self, sensor: Sensor, message: Table, place: str) -> Frame:
        kinds = [kind for kind, _ in struct.iter_unpack("<BB", message.vector(1, 2))]
        stored = dict(zip(kinds, (bytes(part.bytes(0)) for part in message.tables(0)), strict=True))
        if RANGE not in stored:
            raise FormatError(f"{place}: no ranges. {HINT}")
        range_, reflectivity = RANGE, REFLECTIVITY
        if self._is_second:
            range_, reflectivity = SECOND_RANGE, SECOND_REFLECTIVITY
            if SECOND_RANGE not in stored:
                raise FormatError(f"{place}: {one_return(sensor.profile)}")
        images = self._images(sensor, stored, place, (range_, reflectivity))
        columns = sensor.columns
        stamps = np.frombuffer(message.vector(2, 8), "<u8").astype(np.int64)
        status = np.frombuffer(message.vector(4, 4), "<u4")
        poses = np.frombuffer(message.vector(6, 8), "<f8")
        if len(stamps) != columns or len(status) != columns or len(poses) not in (0, 16 * columns):
            raise FormatError(
                f"{place}: {len(stamps)} times, {len(status)} states and {len(poses)} numbers of"
                f" poses, expected {columns} columns. {HINT}"
            )
        return Frame(
            images[range_].astype(np.uint32),
            images.get(reflectivity),
            stamps,
            (status & COLUMN_IS_VALID).astype(bool),
            poses.reshape(columns, 4, 4) if len(poses) else None,
            returns=2 if SECOND_RANGE in stored else 1,
            is_second=self._is_second,
        )

    @staticmethod
    def _images(
        sensor: Sensor, stored: dict[int, bytes], place: str, kinds: tuple[int, int]
    ) -> dict[int, Image]:
        wanted = {kind: stored[kind] for kind in kinds if kind in stored}
        shape = (sensor.rows, sensor.columns)
        pngs = [kind for kind, data in wanted.items() if is_png(data)]
        try:
            images = {
                kind: decode_zpng(data, shape, place)
                for kind, data in wanted.items()
                if kind not in pngs
            }
            if pngs:
                shifted = decode_pngs([wanted[kind] for kind in pngs], shape, place)
                for kind, image in zip(pngs, shifted, strict=True):
                    images[kind] = shift_rows(image, -sensor.shifts)
        except (FormatError, zlib.error) as error:
            raise FormatError(f"{error}. {HINT}") from error
        return images
