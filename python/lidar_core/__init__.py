"""From raw LiDAR to the list of things around a robot that matter."""

from lidar_core import flying
from lidar_core._core import __version__
from lidar_core.errors import (
    ConfigError,
    FormatError,
    InputError,
    InternalError,
    LidarCoreError,
    LimitError,
    MissingExtraError,
    NumericalError,
)
from lidar_core.flying.config import VoxelMapConfig
from lidar_core.flying.voxel_map import IntegrateStats, VoxelMap
from lidar_core.geometry import cluster_points, traverse

__all__ = [
    "ConfigError",
    "FormatError",
    "InputError",
    "IntegrateStats",
    "InternalError",
    "LidarCoreError",
    "LimitError",
    "MissingExtraError",
    "NumericalError",
    "VoxelMap",
    "VoxelMapConfig",
    "__version__",
    "cluster_points",
    "flying",
    "traverse",
]
