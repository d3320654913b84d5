"""From raw LiDAR to the list of things around a robot that matter."""

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

__all__ = [
    "ConfigError",
    "FormatError",
    "InputError",
    "InternalError",
    "LidarCoreError",
    "LimitError",
    "MissingExtraError",
    "NumericalError",
    "__version__",
]
