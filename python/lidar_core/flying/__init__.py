"""Detection and tracking of flying objects in 3D LiDAR."""

from lidar_core.flying.analysis import (
    detection_probability,
    hit_probability,
    point_covariance,
)
from lidar_core.flying.center import TargetCenter, target_center
from lidar_core.flying.config import (
    ClassifyConfig,
    ClusterConfig,
    FlyingConfig,
    SeedConfig,
    SeparateConfig,
    VoxelMapConfig,
)
from lidar_core.flying.detector import FlyingObjectDetector
from lidar_core.flying.pose_config import PoseConfig
from lidar_core.flying.results import FlyingFrame, FlyingStatus, Health, TrackEvents
from lidar_core.flying.sensor_config import SensorConfig
from lidar_core.flying.tracker import PointCloudTracker
from lidar_core.flying.tracker_config import TrackerConfig
from lidar_core.objects import FlyingDetections, Tracks

__all__ = [
    "ClassifyConfig",
    "ClusterConfig",
    "FlyingConfig",
    "FlyingDetections",
    "FlyingFrame",
    "FlyingObjectDetector",
    "FlyingStatus",
    "Health",
    "PointCloudTracker",
    "PoseConfig",
    "SeedConfig",
    "SensorConfig",
    "SeparateConfig",
    "TargetCenter",
    "TrackEvents",
    "TrackerConfig",
    "Tracks",
    "VoxelMapConfig",
    "detection_probability",
    "hit_probability",
    "point_covariance",
    "target_center",
]


def __dir__() -> list[str]:
    return __all__
