"""From raw LiDAR to the list of things around a robot that matter."""

from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING

from lidar_core import circles, flying
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
)
from lidar_core.flying.config import VoxelMapConfig
from lidar_core.flying.voxel_map import IntegrateStats, VoxelMap
from lidar_core.geometry import cluster_points, traverse

if TYPE_CHECKING:
    from lidar_core import estimation as estimation
    from lidar_core import evaluation as evaluation
    from lidar_core import fusion as fusion
    from lidar_core import io as io
    from lidar_core import live as live
    from lidar_core import reproduce as reproduce
    from lidar_core import sim as sim
    from lidar_core import viz as viz

_LAZY = ("estimation", "evaluation", "fusion", "io", "live", "reproduce", "sim", "viz")
"""Modules that are imported when they are first used."""

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
    "VoxelMap",
    "VoxelMapConfig",
    "__version__",
    "circles",
    "cluster_points",
    "flying",
    "traverse",
]


def __getattr__(name: str) -> ModuleType:
    if name in _LAZY:
        return import_module(f"lidar_core.{name}")
    raise AttributeError(f"module 'lidar_core' has no attribute {name!r}")
