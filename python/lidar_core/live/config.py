"""Configuration of a live run: waiting times, memory of poses, reports."""

from collections.abc import Mapping
from typing import Annotated, ClassVar

from pydantic import Field

from lidar_core.config import Config

TopicName = Annotated[str, Field(min_length=1)]


REPORT_INTERVAL = 1.0
"""Time between two lines on the console [s]."""
POSE_HISTORY = 10.0
"""Poses this much older than the newest scan are forgotten [s]: no scan waits for so long."""
RETRY_INTERVAL = 1.0
"""Time between two attempts to connect again [s]."""
MAX_POSES = 10_000
"""Messages with poses that wait to be read. Source: limits table of SECURITY.md."""
MAX_FRAMES = 1000
"""Pairs of frames whose transforms are kept. Source: limits table of SECURITY.md."""
CONNECT_TIMEOUT = 10.0
"""How long the first connection may take [s]."""


class LiveConfig(Config):
    """Waiting times, memory and reports of `lidar-core live`. Source: tests on the loopback."""

    removed: ClassVar[Mapping[str, str]] = {
        "report_interval": "reports come every second",
        "pose_history": "poses are forgotten after 10 s",
        "retry_interval": "a connection is tried again after 1 s",
        "max_poses": "10,000 messages with poses may wait",
        "max_frames": "transforms of 1,000 pairs of frames are kept",
        "connect_timeout": "the first connection may take 10 s",
    }
    pose_wait: float = Field(
        default=0.2,
        ge=0,
        le=60,
        description="Time that a scan waits for the pose of its last point; after it the"
        " newest pose is used, if it is not older than `poses.max_extrapolation`"
        " [s].",
    )
    max_waiting: int = Field(
        default=8,
        ge=1,
        le=10_000,
        description="Scans of one LiDAR that wait for their poses (no unit).",
    )
    domain: int = Field(
        default=0, ge=0, le=232, description="Domain of ROS 2 over Zenoh (no unit)."
    )
    transform_topics: tuple[TopicName, ...] = Field(
        default=("/tf", "/tf_static"),
        description="Topics of transforms; those that end in tf_static never change (no unit).",
    )
    namespace: str = Field(
        default="/lidar_core",
        pattern=r"^(/[A-Za-z_][A-Za-z0-9_]*)+$",
        description="Before the topics that go out over Zenoh (no unit).",
    )
