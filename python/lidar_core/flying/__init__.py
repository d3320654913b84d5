"""Detection and tracking of flying objects in 3D LiDAR."""

from lidar_core.flying.results import TrackEvents, Tracks
from lidar_core.flying.tracker import PointCloudTracker
from lidar_core.flying.tracker_config import TrackerConfig

__all__ = ["PointCloudTracker", "TrackEvents", "TrackerConfig", "Tracks"]
