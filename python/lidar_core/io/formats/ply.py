"""PLY files: one scan each."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_core.io.files.mesh import load_mesh
from lidar_core.io.formats.sequence import SequenceRecording
from lidar_core.io.readers import register_reader


@register_reader("PLY", [".ply"], extra="io", folder="together")
class PlyRecording(SequenceRecording):
    """PLY files, through trimesh: their vertices."""

    format = "PLY"

    def _rows(self, file: Path) -> NDArray[Any]:
        vertices = np.asarray(load_mesh(file, ".ply", self.options).vertices, np.float32)
        rows = np.empty(len(vertices), [(name, "<f4") for name in "xyz"])
        for axis, name in enumerate("xyz"):
            rows[name] = vertices[:, axis]
        return rows
