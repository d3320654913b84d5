"""How a live run waits, forgets and reports."""

from collections.abc import Mapping
from typing import Annotated, ClassVar

from pydantic import Field

from lidar_core.config import Config

TopicName = Annotated[str, Field(min_length=1)]


REPORT_INTERVAL = 1.0
"""Time between two lines on the console [s]."""


class LiveConfig(Config):
    """How `lidar-core live` waits, forgets and reports. Source: tests on the loopback."""

    removed: ClassVar[Mapping[str, str]] = {
        "report_interval": "reports come every second",
    }
    pose_wait: float = Field(
        0.2,
        ge=0,
        description="How long a scan waits for the pose of its last point; after it the newest"
        " pose counts, if it is not older than `poses.max_extrapolation` [s].",
    )
    pose_history: float = Field(
        10.0, gt=0, description="Poses this much older than the newest scan are forgotten [s]."
    )
    max_waiting: int = Field(
        8, ge=1, description="Scans of one LiDAR that wait for their poses (no unit)."
    )
    max_poses: int = Field(
        10_000, ge=1, description="Messages with poses that wait to be read (no unit)."
    )
    max_frames: int = Field(
        1000, ge=1, description="Pairs of frames whose transforms are kept (no unit)."
    )
    connect_timeout: float = Field(
        10.0, gt=0, description="How long the first connection may take [s]."
    )
    retry_interval: float = Field(
        1.0, gt=0, description="Time between two attempts to connect again [s]."
    )
    domain: int = Field(0, ge=0, le=232, description="Domain of ROS 2 over Zenoh (no unit).")
    transform_topics: tuple[TopicName, ...] = Field(
        ("/tf", "/tf_static"),
        description="Topics of transforms; those that end in tf_static never change (no unit).",
    )
    namespace: str = Field(
        "/lidar_core",
        pattern=r"^(/[A-Za-z_][A-Za-z0-9_]*)+$",
        description="Before the topics that go out over Zenoh (no unit).",
    )
