"""Meshes, and clouds in PLY, through trimesh."""

from pathlib import Path
from typing import Any

import numpy as np

from lidar_core.errors import FormatError
from lidar_core.extras import require
from lidar_core.io.files.guard import check_size, reading
from lidar_core.io.options import ReadOptions


def load_mesh(path: Path, suffix: str, options: ReadOptions) -> Any:
    """Load a mesh or cloud through trimesh, after counting its vertices."""
    library = require("trimesh", extra="io", purpose="reading meshes and PLY")
    with reading(str(path)), path.open("rb") as file:
        loaded = library.load(file, file_type=suffix[1:], process=False)
        if isinstance(loaded, library.Scene):
            loaded = loaded.to_mesh()
        count = len(loaded.vertices)
        faces = getattr(loaded, "faces", None)
        if faces is not None and len(faces) and not 0 <= np.min(faces) <= np.max(faces) < count:
            raise FormatError(
                f"{path}: a face refers to a vertex that does not exist; there are {count}"
            )
    check_size(
        str(path), count, limit=options.max_points, key="max_points", what="a cloud of points"
    )
    return loaded
