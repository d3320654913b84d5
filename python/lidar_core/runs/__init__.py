"""The work of the commands as functions: each reads a recording and writes a run folder."""

from lidar_core.runs.batch_jobs import BatchResult, batch
from lidar_core.runs.circle_map import circles
from lidar_core.runs.flying import detect
from lidar_core.runs.fusion import fit_config, fuse
from lidar_core.runs.result import RunResult
from lidar_core.runs.settings import ConfigChoice
from lidar_core.runs.streams.live import LiveResult, live

__all__ = [
    "BatchResult",
    "ConfigChoice",
    "LiveResult",
    "RunResult",
    "batch",
    "circles",
    "detect",
    "fit_config",
    "fuse",
    "live",
]


def __dir__() -> list[str]:
    return __all__
