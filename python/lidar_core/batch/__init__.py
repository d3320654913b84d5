"""Independent work over several processes or machines, and commands over many inputs."""

from lidar_core.batch.config import BatchConfig, BatchGroup, BatchJob, jobs_of
from lidar_core.batch.executors import Failure, Task, completed
from lidar_core.batch.results import JobRecord, write_results

__all__ = [
    "BatchConfig",
    "BatchGroup",
    "BatchJob",
    "Failure",
    "JobRecord",
    "Task",
    "completed",
    "jobs_of",
    "write_results",
]


def __dir__() -> list[str]:
    return __all__
