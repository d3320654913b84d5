"""Jobs of a batch, which are commands: which are done, how one is run, and the table of all."""

import hashlib
import json
import os
import shutil
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, redirect_stderr, redirect_stdout
from dataclasses import dataclass, replace
from pathlib import Path
from pkgutil import resolve_name
from time import perf_counter
from typing import Annotated, Any, Self, cast

from pydantic import Field
from typer import BadParameter
from typer.main import get_command

from lidar_core.batch import (
    BatchConfig,
    BatchJob,
    Failure,
    JobRecord,
    Task,
    completed,
    jobs_of,
    write_results,
)
from lidar_core.batch.config import OUTPUT
from lidar_core.batch.executors import Executor
from lidar_core.batch.results import NOTE, flat
from lidar_core.config import Config, checked
from lidar_core.errors import ConfigError, LidarCoreError
from lidar_core.io.files.atomic import is_temporary, remove_stale, written_whole
from lidar_core.run_folder import build_digest, lock, note_of, unlock
from lidar_core.runs.result import OnProgress, RunResult
from lidar_core.util.threads import all_threads

COMMAND_LINE = "lidar_core.cli:app"
"""Runs the commands of a job. Found by name: the command line is built on `lidar_core.runs`."""
LOG, RESULTS = "log.txt", "results.parquet"
KEY_LENGTH = 12
OVERFLIGHT = "overflight"
"""Scene of `simulate` that takes no threads."""
WITHOUT = ("batch", "view")
"""Commands that are no jobs: they do not end by themselves, or would start jobs of their own."""
UsageError = cast("type[Exception]", BadParameter.__base__)
"""What a parser raises; typer hands out this one of its errors alone."""
WRITTEN = {("export", "model")}
"""Arguments, besides those called output, that name what a command writes."""


@dataclass(frozen=True, slots=True)
class BatchResult(RunResult):
    """Result of a batch.

    Attributes
    ----------
    records : tuple of JobRecord
        Of the jobs that have ended, in the order of the file.
    """

    records: tuple[JobRecord, ...] = ()


@checked
def batch(
    jobs: str | os.PathLike[str],
    output: str | os.PathLike[str],
    *,
    executor: Executor = "local",
    workers: Annotated[int, Field(ge=1)] | None = None,
    fresh: bool = False,
    on_progress: OnProgress = lambda what, done, total: None,
    on_job: Callable[[JobRecord], None] = lambda record: None,
) -> BatchResult:
    """Run commands over many recordings, seeds and values, as `lidar-core batch` does.

    Jobs that an earlier run finished are kept, unless something changed.

    Parameters
    ----------
    jobs : str or Path
        Batch file (TOML), as `BatchConfig` describes it.
    output : str or Path
        Folder to write: results.parquet (or .csv) with a row per job, a folder per job.
    executor : str
        "local": processes of this machine. "ray": a Ray cluster (extra `cluster`).
    workers : int, optional
        Jobs at a time; None: as many as this process may use threads.
    fresh : bool
        Run every job again.
    on_progress : callable
        Is called with "batch", how many jobs are done, and of how many.
    on_job : callable
        Is called with the `JobRecord` of every job that has ended.

    Returns
    -------
    BatchResult
        Its summary counts jobs and names those that failed; `ended_by` is a KeyboardInterrupt
        after Ctrl-C: the next run goes on from there.

    Raises
    ------
    ConfigError
        The file cannot be used, or a command is unknown or cannot be a job.
    FileExistsError
        Another batch is being written there.
    """
    file, folder = Path(jobs), Path(output)
    config = BatchConfig.read(file)
    made = Batch.of(folder, jobs_of(config, file.parent), is_fresh=fresh)
    folder.mkdir(parents=True, exist_ok=True)
    lock(folder)
    done, ended_by = len(made.kept), None
    on_progress("batch", done, len(made.jobs))
    try:
        for record in made.run(executor=executor, workers=workers or all_threads()):
            done += 1
            on_progress("batch", done, len(made.jobs))
            on_job(record)
    except KeyboardInterrupt as interrupt:
        ended_by = interrupt
    table = made.write({"batch": config}, file)
    unlock(folder)
    files = (table.name, "batch.toml")
    records = tuple(made.records())
    summary = {**made.summary(), "results": str(table)}
    return BatchResult(folder, summary, files, (), ended_by, records)


@dataclass(slots=True)
class Batch:
    """Jobs and the folder of their results.

    Attributes
    ----------
    folder : Path
        Of the results.
    jobs : dict of str to BatchJob
        By the names of their folders.
    kept : dict of str to JobRecord
        Those that an earlier run did.
    """

    folder: Path
    jobs: dict[str, BatchJob]
    kept: dict[str, JobRecord]
    made: dict[str, JobRecord]

    @classmethod
    def of(cls, folder: Path, jobs: Sequence[BatchJob], *, is_fresh: bool) -> Self:
        """Name the jobs, and see which are done.

        Raises
        ------
        ConfigError
            A command is not known, or cannot be a job.
        """
        for job in jobs:
            _check(job)
        named = {f"{job.group}-{_key(job)[:KEY_LENGTH]}": job for job in jobs}
        kept = (
            {}
            if is_fresh
            else {
                name: record
                for name, job in named.items()
                if (record := JobRecord.read(folder / name)) is not None
                and record.status == "done"
                and record.key == _key(job)
            }
        )
        return cls(folder, named, kept, {})

    def run(self, *, executor: Executor, workers: int) -> Iterator[JobRecord]:
        """Do what is left; yield each record as the job ends."""
        left = [name for name in self.jobs if name not in self.kept]
        threads = max(1, all_threads() // workers)
        for name in left:
            _begin(self.folder / name, self._record(name))
        tasks = [self._task(name, threads) for name in left]
        with closing(completed(tasks, workers=workers, executor=executor)) as ends:
            for number, outcome in ends:
                name = left[number]
                record = self._failed(name, outcome) if isinstance(outcome, Failure) else outcome
                self.made[name] = record
                yield record

    def records(self) -> list[JobRecord]:
        """Of the jobs that have ended, in the order of the file.

        What an end by Ctrl-C kept from being told is read from the folders of the jobs.
        """
        known = {**self.kept, **self.made}
        found = (known.get(name) or JobRecord.read(self.folder / name) for name in self.jobs)
        return [record for record in found if record is not None and record.status != "running"]

    def summary(self) -> dict[str, Any]:
        """Counts of jobs, and the errors of those that failed."""
        records = self.records()
        failed = {record.job: record.error for record in records if record.status == "failed"}
        done = sum(record.status == "done" for record in records)
        return {"jobs": len(self.jobs), "done": done, "kept": len(self.kept), "failed": failed}

    def write(self, config: Mapping[str, Config], file: Path) -> Path:
        """Write the table and what made it; return the table."""
        self.folder.mkdir(parents=True, exist_ok=True)
        with written_whole(self.folder / "batch.toml") as temporary:
            temporary.write_text(note_of({"jobs": str(file)}, config), encoding="utf-8")
        return write_results(self.folder / RESULTS, self.records())

    def _failed(self, name: str, failure: Failure) -> JobRecord:
        error = _told(failure.error)
        record = replace(self._record(name), status="failed", error=error)
        record.write(self.folder / name)
        return record

    def _record(self, name: str) -> JobRecord:
        job = self.jobs[name]
        return JobRecord(name, job.group, _key(job), "running", values=job.values)

    def _task(self, name: str, threads: int) -> Task:
        folder = (self.folder / name).resolve()
        return Task(
            name,
            run_job,
            {
                "record": self._record(name),
                "commands": self.jobs[name].commands_into(folder),
                "folder": folder,
                "place": Path.cwd(),
                "threads": threads,
                "build": build_digest(),
            },
        )


def run_job(
    *,
    record: JobRecord,
    commands: Sequence[Sequence[str]],
    folder: Path,
    place: Path,
    threads: int,
    build: str,
) -> JobRecord:
    """Do the commands of a job in `folder`, seen from `place`; return how it ended.

    What they print goes into log.txt.
    """
    start = perf_counter()
    numbers: dict[str, Any] = {}
    try:
        if build != build_digest():
            raise ConfigError("batch: this worker has another build of lidar_core")
        os.chdir(place)
        with (
            (folder / LOG).open("w", encoding="utf-8") as log,
            redirect_stdout(log),
            redirect_stderr(log),
        ):
            for number, command in enumerate(commands, start=1):
                told = folder / f"{number}-{command[0]}.json"
                numbers |= flat(_told_by(command, told, threads), _prefix(commands, number - 1))
    except Exception as error:  # whatever it is, it is what the record is for
        ended = replace(record, status="failed", error=_told(error))
    else:
        ended = replace(record, status="done", numbers=numbers)
    ended = replace(ended, seconds=round(perf_counter() - start, 3))
    ended.write(folder)
    return ended


def _prefix(commands: Sequence[Sequence[str]], index: int) -> str:
    """What the numbers of a command begin with: its name; counted, if the job has it again."""
    names = [command[0] for command in commands]
    name = names[index]
    return f"{name}-{names[: index + 1].count(name)}" if names.count(name) > 1 else name


def _told_by(command: Sequence[str], told: Path, threads: int) -> Any:
    """Do one command; return what it told as JSON in the file `told`, if it can."""
    options = _options(command[0])
    more = ["--json", str(told)] if "--json" in options and "--json" not in command else []
    if "--threads" in options and not {"--threads", OVERFLIGHT} & set(command):
        more += ["--threads", str(threads)]
    arguments = [*command, *more]
    sys.argv = ["lidar-core", *arguments]
    status = resolve_name(COMMAND_LINE)(arguments, standalone_mode=False)
    if status:
        raise ChildProcessError(f"lidar-core {' '.join(command)}: exit status {status}, see {LOG}")
    if not told.is_file():
        return {}
    return json.loads(told.read_text(encoding="utf-8"))


def _options(command: str) -> set[str]:
    """Options of a command that take a value."""
    parameters = _commands()[command].params
    return {name for one in parameters if not getattr(one, "is_flag", False) for name in one.opts}


def _commands() -> Mapping[str, Any]:
    known: Mapping[str, Any] = vars(get_command(resolve_name(COMMAND_LINE)))["commands"]
    return known


def _check(job: BatchJob) -> None:
    known = sorted(set(_commands()) - set(WITHOUT))
    for command in job.commands:
        if not command or command[0] not in known:
            named = command[0] if command else ""
            raise ConfigError(
                f"jobs.{job.group}.commands: expected one of {', '.join(known)}, got {named!r}"
            )
        outside = [where for where, value in _written(command) if not _is_inside(value)]
        if outside:
            raise ConfigError(
                f"jobs.{job.group}.commands: expected {{{OUTPUT}}} in {' '.join(command)!r}, as the"
                f" beginning of {outside[0]}: what it writes elsewhere is no part of the job"
            )


def _written(command: Sequence[str]) -> list[tuple[str, str | None]]:
    """Options and arguments of a command that name what it writes, with their values.

    An option that is not there has its default, which is no place of the job: None.
    """
    known, name, arguments = _commands()[command[0]], command[0], list(command[1:])
    below: Mapping[str, Any] = getattr(known, "commands", {})
    if arguments and arguments[0] in below:
        known, name, arguments = below[arguments[0]], arguments[0], arguments[1:]
    context = known.make_context(name, [], resilient_parsing=True)
    context.resilient_parsing = False
    try:
        values = known.make_parser(context).parse_args(arguments)[0]
    except UsageError:
        return []  # the job itself says what is wrong with its options
    found = []
    for one in known.params:
        value = values.get(one.name)
        if one.name == "output" or (command[0], one.name) in WRITTEN:
            found.append((max(one.opts, key=len), None if value is None else str(value)))
        elif "--json" in one.opts and value not in (None, False, True) and str(value) != "-":
            found.append(("--json", str(value)))
    return found


def _is_inside(value: str | None) -> bool:
    """Whether a place is in the folder of the job."""
    if value is None or not value.startswith(f"{{{OUTPUT}}}"):
        return False
    folder = Path(os.sep) / "job"
    place = Path(os.path.normpath(value.replace(f"{{{OUTPUT}}}", str(folder))))
    return place.is_relative_to(folder)


def _begin(folder: Path, record: JobRecord) -> None:
    """An empty folder that says whose it is."""
    if folder.exists() and not all(is_temporary(one.name) for one in folder.iterdir()):
        if not (folder / NOTE).is_file():
            raise FileExistsError(f"{folder}: holds files that no job wrote")
        shutil.rmtree(folder)
    remove_stale(folder)
    folder.mkdir(parents=True, exist_ok=True)
    record.write(folder)


def _key(job: BatchJob) -> str:
    """Digest of what makes the result: build, commands, and size and time of the files named."""
    files = {
        part: _seen(Path(part))
        for command in job.commands
        for part in command
        if os.path.exists(part)
    }
    made_of = json.dumps([build_digest(), job.commands, files], sort_keys=True)
    return hashlib.sha256(made_of.encode()).hexdigest()


def _seen(path: Path) -> list[tuple[str, int, int]]:
    found = [path] if path.is_file() else sorted(one for one in path.rglob("*") if one.is_file())
    return [(str(one), (at := one.stat()).st_size, at.st_mtime_ns) for one in found]


def _told(error: Exception) -> str:
    text = (
        str(error)
        if isinstance(error, LidarCoreError | OSError)
        else (f"{type(error).__name__}: {error}")
    )
    return text.strip() or type(error).__name__
