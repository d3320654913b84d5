"""Live streams: scans as they arrive, through a pipeline, to viewers and other programs."""

from lidar_core.live.config import LiveConfig
from lidar_core.live.inbox import Inbox
from lidar_core.live.loop import LiveLoop
from lidar_core.live.outputs import Output
from lidar_core.live.source import Source
from lidar_core.live.update import Update

__all__ = ["Inbox", "LiveConfig", "LiveLoop", "Output", "Source", "Update"]
