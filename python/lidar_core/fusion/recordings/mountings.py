"""Mounting of sensors on their platform, from the static transforms of a recording."""

import numpy as np
from numpy.typing import NDArray

from lidar_core.io.messages.ros import POSE_TYPES, ros_name
from lidar_core.io.poses.tf_buffer import NoTransformError, TransformBuffer
from lidar_core.io.recording import Recording
from lidar_core.messages import Pose

STATIC = "tf_static"
"""End of the name of the topic with transforms that do not change."""
BODIES = ("base_link", "base_footprint", "base")
"""Names of the frame of a platform, where no odometry tells it."""


class Mountings:
    """Rotations from the axes of sensors to those of their platform.

    Parameters
    ----------
    body : str
        Frame of the platform; empty if unknown.
    transforms : TransformBuffer
        Static transforms.
    """

    def __init__(self, body: str, transforms: TransformBuffer) -> None:
        self._body, self._transforms = body, transforms
        self._known: dict[str, NDArray[np.float64] | None] = {}

    @classmethod
    def of(cls, recording: Recording) -> "Mountings":
        """Read the mountings of a recording; its odometry gives the motion of the platform."""
        transforms = TransformBuffer(max_gap=1.0, max_extrapolation=0.0)
        names = {topic.name for topic in recording.topics() if topic.kind == "pose"}
        static = {name for name in names if name.rstrip("/").endswith(STATIC)}
        # A transform of /tf may be of a wheel; odometry is of the platform.
        carriers = {t.name for t in recording.topics() if ros_name(t.type) in POSE_TYPES}
        body = ""
        if not static:
            return cls(body, transforms)
        for record in recording.records(frozenset({"pose"})):
            name = record.topic.name
            if name not in static and body:
                continue
            for pose in record.decode():
                if not isinstance(pose, Pose):
                    continue
                if pose.is_static:
                    transforms.add(pose)
                elif not body and name in carriers:
                    body = pose.child_frame_id
        frames = {frame for edge in transforms.edges() for frame in edge}
        known = (name for name in BODIES if name in frames)
        return cls(body if body in frames else next(known, ""), transforms)

    def rotation(self, frame: str) -> NDArray[np.float64] | None:
        """Matrix (3, 3) from the axes of a sensor's frame to the platform's; None for the same."""
        frame = frame.lstrip("/")
        if frame not in self._known:
            self._known[frame] = self._found(frame)
        return self._known[frame]

    def _found(self, frame: str) -> NDArray[np.float64] | None:
        if not self._body or frame == self._body:
            return None
        try:
            if not self._transforms.is_static(self._body, frame):
                return None
            matrix = self._transforms.lookup(self._body, frame, [0])[0, :3, :3]
        except NoTransformError:
            return None
        return None if np.array_equal(matrix, np.eye(3)) else matrix
