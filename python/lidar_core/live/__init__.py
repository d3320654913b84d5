"""Live streams: scans as they arrive, through a pipeline, to viewers and other programs."""

from lidar_core.live.config import LiveConfig
from lidar_core.live.loop import LiveLoop
from lidar_core.live.outputs.output import Output
from lidar_core.live.outputs.update import Update
from lidar_core.live.sources.inbox import Inbox
from lidar_core.live.sources.source import Source

__all__ = ["Inbox", "LiveConfig", "LiveLoop", "Output", "Source", "Update"]


def __dir__() -> list[str]:
    return __all__
