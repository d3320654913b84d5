"""Writer of clouds as PLY files."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lidar_core.io.files.atomic import written_whole
from lidar_core.io.writers import register_writer


@register_writer("PLY", [".ply"], takes="points")
def write_ply(path: Path, points: NDArray[np.float64], _: float | None) -> None:
    """Write points as float64 atomically."""
    axes = "".join(f"property double {axis}\n" for axis in "xyz")
    head = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(points)}\n{axes}end_header\n"
    with written_whole(path) as temporary:
        temporary.write_bytes(head.encode() + points.astype("<f8").tobytes())
