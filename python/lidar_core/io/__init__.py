"""Recordings in and out: one iterator over every readable format, poses, and writers."""

from lidar_core.io.child.trust import trusted_files
from lidar_core.io.info import RecordingInfo, TopicInfo
from lidar_core.io.maps.cloud_files import Cloud, read_cloud, write_cloud
from lidar_core.io.opening import open_recording
from lidar_core.io.options import PoseOptions, ReadOptions, Span
from lidar_core.io.poses.posed import PosedScans, posed_laser_scans, posed_scans
from lidar_core.io.poses.tf_buffer import NoTransformError, TransformBuffer
from lidar_core.io.readers import register_reader
from lidar_core.io.recording import Recording
from lidar_core.io.records import Record, Topic
from lidar_core.io.tables.circles import write_circles_table, write_circles_tum
from lidar_core.io.tables.columns import read_columns
from lidar_core.io.tables.shapes import write_shapes_table
from lidar_core.io.tables.tracks import write_tracks_table, write_tum
from lidar_core.io.write.mcap import McapWriter, write_mcap
from lidar_core.io.write.mot import write_mot
from lidar_core.io.write.npz import write_npz
from lidar_core.io.write.nuscenes import write_nuscenes
from lidar_core.io.write.objects import RunObjects
from lidar_core.io.write.recording import write_recording
from lidar_core.io.write.ros import RosWriter, write_ros
from lidar_core.io.write.ros_obstacles import write_ros_objects
from lidar_core.io.writers import register_writer
from lidar_core.messages import LaserScan, Pose, PosedScan, Scan

__all__ = [
    "Cloud",
    "LaserScan",
    "McapWriter",
    "NoTransformError",
    "Pose",
    "PoseOptions",
    "PosedScan",
    "PosedScans",
    "ReadOptions",
    "Record",
    "Recording",
    "RecordingInfo",
    "RosWriter",
    "RunObjects",
    "Scan",
    "Span",
    "Topic",
    "TopicInfo",
    "TransformBuffer",
    "open_recording",
    "posed_laser_scans",
    "posed_scans",
    "read_cloud",
    "read_columns",
    "register_reader",
    "register_writer",
    "trusted_files",
    "write_circles_table",
    "write_circles_tum",
    "write_cloud",
    "write_mcap",
    "write_mot",
    "write_npz",
    "write_nuscenes",
    "write_recording",
    "write_ros",
    "write_ros_objects",
    "write_shapes_table",
    "write_tracks_table",
    "write_tum",
]


def __dir__() -> list[str]:
    return __all__
