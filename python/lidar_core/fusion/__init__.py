"""Targets, one or many, seen by LiDAR and radar from a platform that may move."""

from lidar_core.fusion.config import FusionConfig, PublishedModel
from lidar_core.fusion.coverage import TargetCoverage, empty_gospa, mean_gospa, target_coverage
from lidar_core.fusion.filter import FilterHealth, TargetFilter
from lidar_core.fusion.many import MultiTargetTracker, ScanResult, TrackerHealth
from lidar_core.fusion.many_config import MultiTargetConfig
from lidar_core.fusion.measurement import Measurement, Measurements
from lidar_core.fusion.plausibility import Implausible, implausible
from lidar_core.fusion.recordings.autoferry import DetectionScan, read_autoferry
from lidar_core.fusion.recordings.bags import BagOptions, read_bag
from lidar_core.fusion.recordings.continental import read_continental
from lidar_core.fusion.recordings.delphi import read_delphi
from lidar_core.fusion.recordings.nuscenes import read_nuscenes_boxes, read_nuscenes_radar
from lidar_core.fusion.recordings.overflight import level_overflight, write_overflight
from lidar_core.fusion.recordings.reading import TargetRecording, TargetTruth, read_laser_radar
from lidar_core.fusion.recordings.table import MeasurementLog, TableOptions, read_measurements
from lidar_core.fusion.run import Run, run, run_batch, smooth
from lidar_core.fusion.space import LevelSight, SpaceTrack, in_space, level_sight
from lidar_core.fusion.tuning import fit_noise
from lidar_core.objects import TargetTracks

__all__ = [
    "BagOptions",
    "DetectionScan",
    "FilterHealth",
    "FusionConfig",
    "Implausible",
    "LevelSight",
    "Measurement",
    "MeasurementLog",
    "Measurements",
    "MultiTargetConfig",
    "MultiTargetTracker",
    "PublishedModel",
    "Run",
    "ScanResult",
    "SpaceTrack",
    "TableOptions",
    "TargetCoverage",
    "TargetFilter",
    "TargetRecording",
    "TargetTracks",
    "TargetTruth",
    "TrackerHealth",
    "empty_gospa",
    "fit_noise",
    "implausible",
    "in_space",
    "level_overflight",
    "level_sight",
    "mean_gospa",
    "read_autoferry",
    "read_bag",
    "read_continental",
    "read_delphi",
    "read_laser_radar",
    "read_measurements",
    "read_nuscenes_boxes",
    "read_nuscenes_radar",
    "run",
    "run_batch",
    "smooth",
    "target_coverage",
    "write_overflight",
]


def __dir__() -> list[str]:
    return __all__
