"""Independent parts of a long run, which use several processes and are kept for later runs.

A part is a mapping of names to arrays, so that a finished part can be stored as .npz.
"""

import json
import zlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from tokenize import TokenError
from typing import Any, TypeAlias
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from lidar_core.batch import Failure, Task, completed
from lidar_core.config import Config
from lidar_core.io.files.atomic import written_whole
from lidar_core.reproduce.types import Request
from lidar_core.run_folder import build_digest

Part: TypeAlias = dict[str, NDArray[Any]]
DAMAGED = (OSError, ValueError, EOFError, RuntimeError, BadZipFile, zlib.error, TokenError)
"""What reading a part raises that is cut short, has flipped bytes, or is not ours."""
STAMP = "stamp"
"""Entry of a part on the disk that says what made it."""


@dataclass(frozen=True, slots=True)
class Job:
    """One part: `function(**arguments)`, a function of a module, with plain arguments.

    Attributes
    ----------
    name : str
        Unique among the jobs of a run; names the file of the part.
    function : callable
        Returns the part; with the same arguments always the same one.
    arguments : mapping
        Numbers, texts, tuples of them and configurations.
    scans : int
        Number of scans, its share of the progress.
    """

    name: str
    function: Callable[..., Part]
    arguments: Mapping[str, Any]
    scans: int

    @property
    def stamp(self) -> str:
        """Return the origin of the part; parts with another stamp are not used."""
        plain = {
            name: value.model_dump(mode="json") if isinstance(value, Config) else value
            for name, value in self.arguments.items()
        }
        return json.dumps([build_digest(), self.function.__qualname__, plain])


def run(jobs: Sequence[Job], request: Request) -> list[Part]:
    """Do all jobs and return their parts, in the order of the jobs.

    With `request.parts` every finished part is stored there. Parts of an earlier run of the same
    build with the same arguments are reused, unless the run is fresh.
    """
    parts: dict[str, Part] = {}
    for job in jobs:
        kept = None if request.is_fresh else _load_part(job, request.parts)
        if kept is not None:
            parts[job.name] = kept
            request.advance(job.scans)
    left = [job for job in jobs if job.name not in parts]
    if request.threads == 1 or len(left) <= 1:
        for job in left:
            parts[job.name] = _finished(job, job.function(**job.arguments), request)
    else:
        parts |= _in_processes(left, request)
    return [parts[job.name] for job in jobs]


def flights(
    name: str, function: Callable[..., Part], request: Request, *, longest: int
) -> list[Job]:
    """Return jobs that call `function(seed=, number=, scans=)`, about `request.scans` scans in all.

    Every job has `longest` scans. A run shorter than that is one job with `request.scans` scans.
    """
    scans = min(request.scans, longest)
    return [
        Job(
            f"{name}-{request.seed}-{number}-{scans}",
            function,
            {"seed": request.seed, "number": number, "scans": scans},
            scans,
        )
        for number in range(max(1, round(request.scans / longest)))
    ]


def grouped(
    jobs: Sequence[Job], parts: Sequence[Part], argument: str, values: Iterable[str]
) -> dict[str, list[Part]]:
    """Group the parts by the value of `argument` of their jobs, in the order of `values`."""
    return {
        value: [
            part for job, part in zip(jobs, parts, strict=True) if job.arguments[argument] == value
        ]
        for value in values
    }


def _in_processes(jobs: Sequence[Job], request: Request) -> dict[str, Part]:
    parts: dict[str, Part] = {}
    tasks = [Task(job.name, job.function, job.arguments) for job in jobs]
    with closing(completed(tasks, workers=request.threads)) as ends:
        for number, outcome in ends:
            if isinstance(outcome, Failure):
                raise outcome.error
            parts[jobs[number].name] = _finished(jobs[number], outcome, request)
    return parts


def _finished(job: Job, part: Part, request: Request) -> Part:
    """Store a finished part in `request.parts` if given, report its scans as done; return it."""
    if request.parts is not None:
        request.parts.mkdir(parents=True, exist_ok=True)
        save: Callable[..., None] = np.savez_compressed
        with (
            written_whole(request.parts / f"{job.name}.npz") as temporary,
            temporary.open("wb") as file,
        ):
            save(file, **part, **{STAMP: np.array(job.stamp)})
    request.advance(job.scans)
    return part


def _load_part(job: Job, folder: Path | None) -> Part | None:
    """Return the stored part of an earlier run with the same stamp; None without one."""
    path = folder / f"{job.name}.npz" if folder is not None else None
    if path is None or not path.is_file():
        return None
    try:
        with path.open("rb") as opened, np.load(opened, allow_pickle=False) as file:
            part = {name: file[name] for name in file.files}
    except DAMAGED:
        return None  # made again
    return part if str(part.pop(STAMP, "")) == job.stamp else None
