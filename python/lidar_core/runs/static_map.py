"""A map of all static points, which a run writes beside its folder."""

from pathlib import Path

from lidar_core.errors import ConfigError
from lidar_core.extras import require
from lidar_core.flying import FlyingObjectDetector
from lidar_core.io import write_cloud
from lidar_core.run_folder import RUN_FILE

ENDINGS = (".lcvm", ".pcd", ".ply")
OF_RUNS = ("map.lcvm",)
"""Maps in the folder of a run."""


def check_static_map(path: Path, *, reads: tuple[Path | None, ...]) -> None:
    """Refuse a path that cannot be written, before any work.

    Raises
    ------
    ConfigError
        Another ending, a folder that is not there, or a file that the run reads.
    MissingExtraError
        PCD without pypcd4.
    """
    suffix = path.suffix.lower()
    if suffix not in ENDINGS:
        raise ConfigError(
            f"static_map: expected a file that ends in {', '.join(ENDINGS)}, got {path}"
        )
    if not path.parent.is_dir():
        raise ConfigError(
            f"static_map: {path.parent} is not a folder; choose an existing one, but not the"
            " folder of this run, which is made later"
        )
    if (path.parent / RUN_FILE).is_file() and path.name in OF_RUNS:
        raise ConfigError(f"static_map: {path} is the map that a run writes; choose another name")
    if path.is_dir():
        raise ConfigError(f"static_map: {path} is a folder")
    if path.exists() and any(
        one is not None and one.exists() and (path.samefile(one) or _is_within(path, one))
        for one in reads
    ):
        raise ConfigError(f"static_map: {path} is an input of this run; choose another name")
    if suffix == ".pcd":
        require("pypcd4", extra="io", purpose="writing PCD")


def _is_within(path: Path, folder: Path) -> bool:
    """Return whether a file lies in a folder or in one of its subfolders."""
    return path.resolve().is_relative_to(folder.resolve())


def write_static_map(detector: FlyingObjectDetector, path: Path) -> None:
    """Write the static map: voxels of 0.1 m, or points in the world frame [m]."""
    if path.suffix.lower() == ".lcvm":
        detector.save_static_map(path)
    else:
        write_cloud(path, detector.static_points())
