"""Topics of poses: which hold transforms, and which the poses of one body."""

from lidar_core.io.messages.foxglove import POSE_IN_FRAME
from lidar_core.io.messages.ros import POSE_TYPES, ros_name
from lidar_core.io.records import Topic

NPZ_ODOMETRY = "npz odometry"
"""Type of a topic of an .npz file whose poses have no child frame."""
_TYPES = frozenset({*POSE_TYPES, POSE_IN_FRAME, NPZ_ODOMETRY})


def is_odometry(topic: Topic) -> bool:
    """Return whether the poses of a topic are those of one body, and no transforms."""
    return ros_name(topic.type) in _TYPES
