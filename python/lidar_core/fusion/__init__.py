"""One target, seen by LiDAR and radar from a platform that may move."""

from lidar_core.fusion.config import FusionConfig, PublishedModel
from lidar_core.fusion.filter import TargetFilter
from lidar_core.fusion.measurement import Measurement, Measurements
from lidar_core.fusion.reading import TargetRecording, TargetTruth, read_laser_radar
from lidar_core.fusion.run import Run, run, run_batch, smooth
from lidar_core.fusion.space import LevelSight, SpaceTrack, in_space, level_sight
from lidar_core.fusion.table import MeasurementLog, TableOptions, read_measurements
from lidar_core.fusion.tuning import fit_noise

__all__ = [
    "FusionConfig",
    "LevelSight",
    "Measurement",
    "MeasurementLog",
    "Measurements",
    "PublishedModel",
    "Run",
    "SpaceTrack",
    "TableOptions",
    "TargetFilter",
    "TargetRecording",
    "TargetTruth",
    "fit_noise",
    "in_space",
    "level_sight",
    "read_laser_radar",
    "read_measurements",
    "run",
    "run_batch",
    "smooth",
]
