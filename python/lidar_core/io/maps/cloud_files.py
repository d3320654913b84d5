"""Single clouds and maps in files: known maps as input, and maps for other programs."""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lidar_core import _core
from lidar_core.arrays import as_finite_rows
from lidar_core.errors import FormatError, InputError
from lidar_core.extras import require
from lidar_core.files import check_regular, naming
from lidar_core.io.child.client import call
from lidar_core.io.child.trust import is_trusted
from lidar_core.io.files.guard import check_size, reading
from lidar_core.io.files.las import read_las
from lidar_core.io.files.mesh import load_mesh
from lidar_core.io.maps.octomap import read_octomap
from lidar_core.io.opening import open_recording
from lidar_core.io.options import ReadOptions
from lidar_core.io.writers import writer_of
from lidar_core.messages import Scan

SPACING = 0.1
"""Between points on the surfaces of a mesh [m]."""
MESHES = (".glb", ".obj", ".off", ".stl")
MAPS = (".bt", ".lcvm", *MESHES)
"""Endings of files that are no recordings."""
FOREIGN = (".pcd", ".ply", ".las", ".laz", *MESHES)
"""Endings of files that libraries parse."""
READABLE = ".pcd, .ply, .las, .laz, .bt (OctoMap), .lcvm (our map), .bin (KITTI), " + ", ".join(
    MESHES
)


class Cloud(NamedTuple):
    """Points of one file.

    Attributes
    ----------
    points : ndarray, shape (N, 3), float64
        Coordinates [m] of the file.
    resolution : float or None
        Edge of the voxels whose centres these are [m]; None for measured points.
    """

    points: NDArray[np.float64]
    resolution: float | None = None


def read_cloud(
    path: str | Path,
    *,
    spacing: float = SPACING,
    options: ReadOptions | None = None,
    trusted: bool | None = None,
) -> Cloud:
    """Read the points of one file: a cloud, a map, or the surface of a mesh.

    Parameters
    ----------
    path : str or Path
        PCD, PLY, LAS, LAZ, KITTI .bin; OctoMap's .bt and lidar_core's .lcvm (centres of occupied
        voxels); a mesh as STL, OBJ, OFF, GLB or PLY with faces.
    spacing : float
        Greatest distance of neighbouring points on the surface of a mesh [m].
    options : ReadOptions, optional
        Limits.
    trusted : bool, optional
        See `open_recording`: with False a child process parses what libraries read.

    Returns
    -------
    cloud : Cloud
        Finite points; rows of zeros in PCD and KITTI files are not points.

    Raises
    ------
    FormatError
        Unknown or broken format.
    LimitError
        More than the options allow.
    MissingExtraError
        The format needs a package that is not installed.
    """
    place, chosen = Path(path), options or ReadOptions()
    suffix = place.suffix.lower()
    check_size(
        str(place),
        check_regular(place).stat().st_size,
        limit=chosen.max_record_bytes,
        key="max_record_bytes",
        what="a file of bytes",
    )
    if suffix in FOREIGN and not is_trusted(trusted):
        values = chosen.model_dump(mode="json")
        return Cloud(*call("maps.cloud_files:read_in_child", place, spacing=spacing, **values))
    if suffix == ".bt":
        return Cloud(*read_octomap(place, options=chosen))
    if suffix == ".lcvm":
        return _read_map(place)
    if suffix in (".ply", *MESHES):
        points = _read_mesh(place, suffix, spacing, chosen)
    elif suffix in (".las", ".laz"):
        points = read_las(place, chosen)[0]
    elif suffix in (".pcd", ".bin"):
        points = _read_scan(place, chosen)
    else:
        raise FormatError(f"{place}: unknown format {suffix!r}; readable are: {READABLE}")
    return Cloud(points[np.isfinite(points).all(axis=1)])


def read_in_child(path: Path, spacing: float, **options: Any) -> list[Any]:
    """Return the result of `read_cloud`; for a child process."""
    return list(read_cloud(path, spacing=spacing, options=ReadOptions(**options), trusted=True))


def write_cloud(path: str | Path, points: ArrayLike, *, resolution: float | None = None) -> Path:
    """Write points as .pcd or .ply, or their voxels as OctoMap's .bt, atomically.

    Parameters
    ----------
    path : str or Path
        Path of the file; its ending chooses the format.
    points : array_like, shape (N, 3)
        Coordinates [m]; float64 in PLY, float32 in PCD.
    resolution : float, optional
        Edge of the voxels of .bt [m], which needs it.

    Raises
    ------
    ConfigError
        Another ending.
    InputError
        Points that are not finite, .bt without resolution, or points too far for it.
    MissingExtraError
        PCD without pypcd4.
    """
    place = Path(path)
    writer = writer_of(place, "points")
    rows = as_finite_rows(points, name="points", rows=None, shape=(3,))
    if writer.needs_resolution and resolution is None:
        raise InputError(f"resolution: {place.suffix} needs the edge of its voxels [m], got None")
    writer(place, rows, resolution)
    return place


def _read_mesh(
    path: Path, suffix: str, spacing: float, options: ReadOptions
) -> NDArray[np.float64]:
    if not 0 < spacing < np.inf:
        raise InputError(f"spacing: expected a finite number > 0, got {spacing}")
    loaded = load_mesh(path, suffix, options)
    faces = getattr(loaded, "faces", None)
    if faces is None or len(faces) == 0:
        return np.asarray(loaded.vertices, np.float64)
    if not np.isfinite(loaded.vertices).all():
        raise FormatError(f"{path}: a corner of the surface is not finite")
    needed = 2 * float(loaded.area) / spacing**2 + len(loaded.vertices)
    check_size(
        str(path),
        int(min(needed, 2**62)),
        limit=options.max_points,
        key="max_points",
        what=f"a surface with a point every {spacing:g} m, of points",
    )
    library = require("trimesh.remesh", extra="io", purpose="reading meshes and PLY")
    with reading(str(path)):
        fine, _ = library.subdivide_to_size(loaded.vertices, faces, max_edge=spacing, max_iter=32)
    return np.unique(np.asarray(fine, np.float64), axis=0)


def _read_map(path: Path) -> Cloud:
    with naming(path):
        known = _core.VoxelMap.load(path, threads=1)
    points = known.occupied_points() + np.array(known.origin())
    return Cloud(points, float(known.parameters()["voxel_size"]))


def _read_scan(path: Path, options: ReadOptions) -> NDArray[np.float64]:
    with open_recording(path, options, trusted=True, no_return="none") as recording:
        scans = [message for message in recording if isinstance(message, Scan)]
    return np.asarray(scans[0].points.reshape(-1, 3), np.float64)
