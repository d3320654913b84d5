"""The work of the commands as functions: each reads a recording and writes a run folder."""

from typing import TYPE_CHECKING

# Its modules import each other: two threads that begin with two of them wait for each other.
import lidar_core.io  # noqa: F401
from lidar_core.util.lazy import first_use

if TYPE_CHECKING:
    from lidar_core.runs.batch_jobs import BatchResult as BatchResult
    from lidar_core.runs.batch_jobs import batch as batch
    from lidar_core.runs.circle_map import circles as circles
    from lidar_core.runs.flying import detect as detect
    from lidar_core.runs.fusion import fit_config as fit_config
    from lidar_core.runs.fusion import fuse as fuse
    from lidar_core.runs.result import RunResult as RunResult
    from lidar_core.runs.settings import ConfigChoice as ConfigChoice
    from lidar_core.runs.streams.live import LiveResult as LiveResult
    from lidar_core.runs.streams.live import live as live

_HOMES = {
    "BatchResult": "lidar_core.runs.batch_jobs",
    "ConfigChoice": "lidar_core.runs.settings",
    "LiveResult": "lidar_core.runs.streams.live",
    "RunResult": "lidar_core.runs.result",
    "batch": "lidar_core.runs.batch_jobs",
    "circles": "lidar_core.runs.circle_map",
    "detect": "lidar_core.runs.flying",
    "fit_config": "lidar_core.runs.fusion",
    "fuse": "lidar_core.runs.fusion",
    "live": "lidar_core.runs.streams.live",
}
"""What is imported when it is first used: one command does not need the modules of the others."""

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

if not TYPE_CHECKING:  # so that type checkers find misspelt names
    __getattr__ = first_use(__name__, _HOMES)


def __dir__() -> list[str]:
    return __all__
