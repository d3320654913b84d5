"""Writer of clouds as PCD files."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lidar_core.extras import require
from lidar_core.io.files.atomic import written_whole
from lidar_core.io.writers import register_writer


@register_writer("PCD", [".pcd"], "io", takes="points")
def write_pcd(path: Path, points: NDArray[np.float64], _: float | None) -> None:
    """Write points as float32 atomically."""
    library = require("pypcd4", extra="io", purpose="writing PCD")
    with written_whole(path) as temporary:
        library.PointCloud.from_xyz_points(points.astype(np.float32)).save(temporary)
