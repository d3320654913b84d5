"""ROS 2 messages of an update, independent of the transport."""

from collections.abc import Iterator
from typing import Any

from lidar_core.io.messages.ros_types import DETECTIONS_TYPE
from lidar_core.io.write.ros import RosMessages
from lidar_core.io.write.ros_obstacles import ObstacleArrays
from lidar_core.live.outputs.update import Update

__all__ = ["TYPES", "ros_messages"]


TRACKS, ODOMETRY = "tracks", "odometry"
TYPES = {TRACKS: DETECTIONS_TYPE, ODOMETRY: "nav_msgs/msg/Odometry"}
"""Types of the messages, by the last part of the topic."""


def ros_messages(update: Update, messages: RosMessages) -> Iterator[tuple[str, Any]]:
    """Yield topic ending and message: the detections of all objects, then the odometry of each."""
    make = ObstacleArrays(messages, frame_id=update.frame_id, name=update.capability)
    stamp_ns, objects = update.stamp_ns, update.objects
    yield TRACKS, make.message(DETECTIONS_TYPE, stamp_ns, objects)
    for odometry in make.odometry(stamp_ns, objects, update.covariance):
        yield ODOMETRY, odometry


def __dir__() -> list[str]:
    return __all__
