"""KITTI .bin files: one scan each."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_core.errors import FormatError
from lidar_core.io.files.guard import check_size
from lidar_core.io.formats.sequence import POINT, SequenceRecording
from lidar_core.io.readers import register_reader


@register_reader(
    "KITTI",
    [".bin"],
    folder="together",
    subfolders=["velodyne", "velodyne_points/data", "data"],
)
class KittiRecording(SequenceRecording):
    """KITTI .bin files: x, y, z, intensity as little-endian float32."""

    format = "KITTI bin"

    def _rows(self, file: Path) -> NDArray[Any]:
        size = file.stat().st_size
        if size % POINT.itemsize:
            raise FormatError(
                f"{file}: {size} bytes are not a multiple of {POINT.itemsize}, the size of a"
                " point (x, y, z, intensity as float32)"
            )
        check_size(
            str(file),
            size // POINT.itemsize,
            limit=self.options.max_points,
            key="max_points",
            what="a scan of points",
        )
        return np.fromfile(file, POINT)
