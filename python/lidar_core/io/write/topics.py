"""Topics of messages without a topic, and of poses that are no transforms."""

from collections.abc import Collection

from lidar_core.messages import Pose

SCAN_TOPIC, LASER_TOPIC = "/lidar/points", "/laser/scan"
POSE_TOPIC, STATIC_TOPIC, ODOMETRY_TOPIC = "/tf", "/tf_static", "/odom"
NAMELESS_TOPIC = "/pose"
"""Of poses without child frame: as transforms, those of two bodies would be one."""
TRANSFORMS = ("tf", "tf_static")
"""Ends of the names of topics with transforms."""


def own_topic(pose: Pose, odometry: Collection[str]) -> str | None:
    """Topic of a pose that must not become a transform; None for one that may.

    Parameters
    ----------
    pose : Pose
        Pose to write.
    odometry : collection of str
        Topics whose poses are no transforms in the recording that they come from.
    """
    if pose.is_static or (pose.child_frame_id and pose.topic not in odometry):
        return None
    name = pose.topic.rstrip("/")
    return NAMELESS_TOPIC if not name or name.endswith(TRANSFORMS) else pose.topic
