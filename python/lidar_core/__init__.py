"""LiDAR processing for robots: flying objects, maps of round obstacles, and fusion with radar."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from lidar_core._core import __version__
from lidar_core.errors import (
    ConfigError,
    FormatError,
    InputError,
    InternalError,
    LidarCoreError,
    LimitError,
    LinkError,
    MissingExtraError,
    NumericalError,
    PluginError,
)
from lidar_core.geometry import cluster_points, traverse
from lidar_core.util.lazy import first_use

if TYPE_CHECKING:
    from lidar_core import batch as batch
    from lidar_core import circles as circles
    from lidar_core import estimation as estimation
    from lidar_core import evaluation as evaluation
    from lidar_core import flying as flying
    from lidar_core import fusion as fusion
    from lidar_core import io as io
    from lidar_core import live as live
    from lidar_core import objects as objects
    from lidar_core import reproduce as reproduce
    from lidar_core import runs as runs
    from lidar_core import sim as sim
    from lidar_core import viz as viz
    from lidar_core.flying.config import VoxelMapConfig as VoxelMapConfig
    from lidar_core.flying.voxel_map import IntegrateStats as IntegrateStats
    from lidar_core.flying.voxel_map import VoxelMap as VoxelMap
    from lidar_core.messages import PointClass as PointClass
    from lidar_core.messages import TrackKind as TrackKind

_HOMES = {
    "VoxelMapConfig": "lidar_core.flying.config",
    "IntegrateStats": "lidar_core.flying.voxel_map",
    "VoxelMap": "lidar_core.flying.voxel_map",
    "PointClass": "lidar_core.messages",
    "TrackKind": "lidar_core.messages",
}
_LAZY = (
    "batch",
    "circles",
    "estimation",
    "evaluation",
    "flying",
    "fusion",
    "io",
    "live",
    "objects",
    "reproduce",
    "runs",
    "sim",
    "viz",
)
"""What is imported when it is first used."""

__all__ = [
    "ConfigError",
    "FormatError",
    "InputError",
    "IntegrateStats",
    "InternalError",
    "LidarCoreError",
    "LimitError",
    "LinkError",
    "MissingExtraError",
    "NumericalError",
    "PluginError",
    "PointClass",
    "TrackKind",
    "VoxelMap",
    "VoxelMapConfig",
    "__version__",
    "batch",
    "circles",
    "cluster_points",
    "estimation",
    "evaluation",
    "flying",
    "fusion",
    "io",
    "live",
    "objects",
    "reproduce",
    "runs",
    "sim",
    "traverse",
    "viz",
]


if not TYPE_CHECKING:  # so that type checkers find misspelt names

    def __getattr__(name: str) -> Any:
        if name in _LAZY:
            return import_module(f"lidar_core.{name}")
        return first_use("lidar_core", _HOMES)(name)


def __dir__() -> list[str]:
    return __all__
