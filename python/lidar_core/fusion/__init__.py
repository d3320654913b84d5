"""One target, seen by LiDAR and radar from a platform that may move."""

from lidar_core.fusion.config import FusionConfig
from lidar_core.fusion.filter import TargetFilter
from lidar_core.fusion.measurement import Measurement
from lidar_core.fusion.reading import TargetRecording, TargetTruth, read_laser_radar
from lidar_core.fusion.run import Run, run

__all__ = [
    "FusionConfig",
    "Measurement",
    "Run",
    "TargetFilter",
    "TargetRecording",
    "TargetTruth",
    "read_laser_radar",
    "run",
]
