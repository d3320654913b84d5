"""Independent tasks, spread over the processes of a machine or of a Ray cluster."""

import os
from collections import Counter, deque
from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

from lidar_core.batch.worker import Worker, called, ended, first_done
from lidar_core.errors import ConfigError
from lidar_core.extras import require

Executor: TypeAlias = Literal["local", "ray"]
ATTEMPTS = 3
"""Number of starts of a task whose process dies: it may die because other programs need memory."""


@dataclass(frozen=True, slots=True)
class Task:
    """Call `function(**arguments)`: a function of a module, arguments that can be pickled.

    Attributes
    ----------
    name : str
        Name of the task in messages.
    function : callable
        Function that does the work; equal arguments always give an equal result.
    arguments : mapping
        Arguments of the function.
    """

    name: str
    function: Callable[..., Any]
    arguments: Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Failure:
    """Reason why a task has no result: an exception, or the end of its process."""

    error: Exception


def completed(
    tasks: Sequence[Task], *, workers: int, executor: Executor = "local"
) -> Generator[tuple[int, Any], None, None]:
    """Do all tasks; yield the index of each and its result, or a `Failure`, as they end.

    A task that fails, or whose process dies `ATTEMPTS` times, does not affect the others. Closing
    the iterator, as Ctrl-C does, ends the running tasks.

    Parameters
    ----------
    tasks : sequence of Task
        Started in this order.
    workers : int
        Tasks at a time, >= 1.
    executor : str
        "local": new processes of this machine, each used for several tasks. "ray": the cluster that
        `RAY_ADDRESS` names, else one on this machine (extra `cluster`).

    Raises
    ------
    ConfigError
        Unknown executor.
    MissingExtraError
        Ray is not installed.
    """
    if executor not in EXECUTORS:
        raise ConfigError(f"executor: expected one of {', '.join(EXECUTORS)}, got {executor!r}")
    return EXECUTORS[executor](tasks, workers)


def _local(tasks: Sequence[Task], workers: int) -> Generator[tuple[int, Any], None, None]:
    left, idle = deque(range(len(tasks))), list[Worker]()
    busy: dict[Worker, int] = {}
    deaths: Counter[int] = Counter()
    try:
        while left or busy:
            while left and len(busy) < workers:
                worker = idle.pop() if idle else Worker()
                number = left.popleft()
                busy[worker] = number
                worker.begin(tasks[number].function, tasks[number].arguments)
            for worker in first_done(busy):
                number = busy.pop(worker)
                is_result, value = worker.outcome()
                if worker.is_alive:
                    idle.append(worker)
                else:
                    deaths[number] += 1
                    if deaths[number] < ATTEMPTS:
                        left.append(number)
                        continue
                yield number, value if is_result else Failure(value)
    finally:
        for worker in (*idle, *busy):
            worker.stop(now=worker in busy)


def _ray(tasks: Sequence[Task], workers: int) -> Generator[tuple[int, Any], None, None]:
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    ray = require("ray", extra="cluster", purpose="work on several machines")
    is_ours = not ray.is_initialized()
    if is_ours:
        ours = {"address": "local", "num_cpus": workers}
        where: dict[str, Any] = {} if "RAY_ADDRESS" in os.environ else ours
        ray.init(include_dashboard=False, log_to_driver=False, logging_level="ERROR", **where)
    remote = ray.remote(max_retries=0)(called)
    left, busy = deque(range(len(tasks))), dict[Any, int]()
    deaths: Counter[int] = Counter()
    try:
        while left or busy:
            while left and len(busy) < workers:
                number = left.popleft()
                task = tasks[number]
                busy[remote.remote(task.function, dict(task.arguments))] = number
            for reference in ray.wait(list(busy))[0]:
                number = busy.pop(reference)
                try:
                    is_result, value = ray.get(reference)
                except ray.exceptions.RayError as error:
                    deaths[number] += 1
                    if deaths[number] < ATTEMPTS:
                        left.append(number)
                        continue
                    is_result, value = False, ended(str(error).strip().splitlines()[0])
                yield number, value if is_result else Failure(value)
    finally:
        for reference in busy:
            ray.cancel(reference, force=True)
        if is_ours:
            ray.shutdown()


EXECUTORS: Mapping[str, Callable[[Sequence[Task], int], Generator[tuple[int, Any], None, None]]] = {
    "local": _local,
    "ray": _ray,
}
"""Where tasks run, by name."""
