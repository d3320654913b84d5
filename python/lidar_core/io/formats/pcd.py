"""PCD files: one scan each."""

from io import SEEK_END
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_core.errors import FormatError
from lidar_core.extras import require
from lidar_core.io.files.beginnings import not_a
from lidar_core.io.files.guard import check_size, reading
from lidar_core.io.formats.sequence import SequenceRecording
from lidar_core.io.readers import register_reader

MAX_COLUMNS = 4096
KEYS = ("FIELDS", "SIZE", "TYPE", "COUNT", "WIDTH", "POINTS", "DATA")
"""Lines that a header needs."""
MOST_PER_LZF_BYTE = 88
"""LZF repeats at most 264 bytes by three."""


@register_reader("PCD", [".pcd"], extra="io", folder="together")
class PcdRecording(SequenceRecording):
    """PCD files, through pypcd4."""

    format = "PCD"

    def rows(self, file: Path) -> NDArray[Any]:
        """Structured rows of one file, with all its fields."""
        return self._rows(file)

    def _rows(self, file: Path) -> NDArray[Any]:
        library = require("pypcd4", extra="io", purpose="reading PCD")
        with reading(str(file)), file.open("rb") as stream:
            header = self._header(file, library)
            cloud = library.PointCloud.from_fileobj(stream)
        rows: NDArray[Any] = np.atleast_1d(cloud.pc_data)
        if len(rows) != header.points:
            raise FormatError(f"{file}: header states {header.points} points, found {len(rows)}")
        if header.viewpoint != (0, 0, 0, 1, 0, 0, 0):
            self.findings.note(f"{file}: VIEWPOINT {header.viewpoint} is not applied")
        return rows.reshape(header.height, header.width) if header.height > 1 else rows

    def _header(self, file: Path, library: Any) -> Any:
        """Header of a file, its sizes checked before the data is read."""
        lines: list[str] = []
        with file.open("rb") as stream:
            while len(lines) < 64:
                raw = stream.readline(65_536)
                if not raw:
                    break
                line = raw.decode("utf-8", "replace").strip()
                lines.append(line)
                if line.startswith("DATA"):
                    break
            left = file.stat().st_size - stream.tell()
        _check_keys(file, lines)
        header = library.MetaData.parse_header(lines)
        if len({len(header.fields), len(header.size), len(header.type), len(header.count)}) != 1:
            raise FormatError(f"{file}: FIELDS, SIZE, TYPE and COUNT differ in length")
        columns = sum(header.count)
        if columns > MAX_COLUMNS:
            raise FormatError(f"{file}: {columns} columns, more than {MAX_COLUMNS}")
        check_size(
            str(file),
            header.points,
            limit=self.options.max_points,
            key="max_points",
            what="a scan of points",
        )
        if header.width * header.height != header.points:
            size_text = f"width {header.width} x height {header.height}"
            raise FormatError(f"{file}: {size_text} is not {header.points} points")
        size = header.build_dtype().itemsize * header.points
        if header.data.value == "binary" and left < size:
            raise FormatError(f"{file}: {left} bytes of points, the header states {size}")
        limit = self.options.max_record_bytes
        check_size(str(file), size, limit=limit, key="max_record_bytes", what="points of bytes")
        if header.data.value == "binary_compressed":
            _check_compressed(file, left, size)
        return header


def _check_keys(file: Path, lines: list[str]) -> None:
    """Refuse a file that is no PCD, and a header without the keys that the library needs."""
    words = {line.partition(" ")[0] for line in lines}
    if words.isdisjoint(KEYS):
        with file.open("rb") as stream:
            raise not_a(file, "a PCD file", stream.read(8))
    missing = [key for key in KEYS if key not in words]
    if missing:
        raise FormatError(f"{file}: the header has no {', '.join(missing)} line")


def _check_compressed(file: Path, left: int, size: int) -> None:
    """Refuse impossible sizes of compressed points, the last `left` bytes of a file.

    The library allocates the stated sizes before it decompresses anything.
    """
    with file.open("rb") as stream:
        stream.seek(-left, SEEK_END)
        stated = np.frombuffer(stream.read(8), "<u4")
    if len(stated) != 2:
        raise FormatError(f"{file}: the file ends before the sizes of its compressed points")
    packed, unpacked = stated.tolist()
    if packed > left - 8 or unpacked != size or unpacked > MOST_PER_LZF_BYTE * packed:
        raise FormatError(
            f"{file}: states {packed} bytes that unpack to {unpacked}; there are {left - 8} bytes,"
            f" and its points take {size}"
        )
