"""Run the jobs of a batch. Each job is a list of commands. All results go into one table."""

import hashlib
import json
import os
import re
import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath
from typing import Annotated, Any, Self

from pydantic import Field

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
from lidar_core.batch.executors import Executor
from lidar_core.batch.results import NOTE
from lidar_core.config import checked
from lidar_core.errors import ConfigError
from lidar_core.io.files.atomic import is_temporary, remove_stale
from lidar_core.io.remote import (
    file_versions,
    held_names,
    is_remote,
    joined,
    stored_file,
    texts,
)
from lidar_core.io.tables.long_table import write_long_table
from lidar_core.run_folder import build_digest, lock, unlock
from lidar_core.runs.catalogue import EVENTS
from lidar_core.runs.jobs.commands import check_commands
from lidar_core.runs.jobs.origin import ORIGIN, check_origin, write_origin
from lidar_core.runs.jobs.passage import passage
from lidar_core.runs.jobs.run import TRACKS, Workplace, run_job, told_error
from lidar_core.runs.result import OnProgress, RunResult
from lidar_core.util.threads import all_threads

RESULTS, EVENTS_TABLE = "results.parquet", "events.parquet"
KEY_LENGTH, NAME_LENGTH = 8, 80
"""Letters of the digest in the name of a job, and of the whole name at most."""


@dataclass(frozen=True, slots=True)
class BatchResult(RunResult):
    """Result of a batch.

    Attributes
    ----------
    records : tuple of JobRecord
        Records of the jobs that have ended, in the order of the file.
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
        Folder to write: results.parquet (or .csv) with a row per job, events.parquet with the
        events of all tracks, tracks/ with a table per job, a folder per job. An address such as
        s3://bucket/folder (extra `cloud`) gets the same.
    executor : str
        "local": processes of this machine. "ray": a Ray cluster (extra `cluster`).
    workers : int, optional
        Jobs at a time; None: as many as this process may use threads.
    fresh : bool
        Run every job again.
    on_progress : callable
        Called with "batch", the number of finished jobs, and the number of all jobs.
    on_job : callable
        Called with the `JobRecord` of every job that has ended.

    Returns
    -------
    BatchResult
        The summary counts jobs and names the failed ones. `ended_by` is a KeyboardInterrupt after
        Ctrl-C: the next run continues from there.

    Raises
    ------
    ConfigError
        The file cannot be used, or a command is unknown or cannot be a job.
    FileExistsError
        Another batch is being written there, or the folder holds finished jobs of another batch
        file.
    """
    file, target = Path(jobs), os.fspath(output)
    if isinstance(output, Path) and is_remote(target.replace(":/", "://", 1)):
        raise ConfigError(f"output: expected an address as text, got the path {target}")
    config = BatchConfig.read(file)
    made_jobs = jobs_of(config, file.parent)
    if not is_remote(target):
        work = Batch.of(Path(target), made_jobs, is_fresh=fresh)
        return _run_jobs(work, config, file, executor, workers, on_progress, on_job)
    with passage() as folder:
        work = Batch.of(folder, made_jobs, is_fresh=fresh, remote=target)
        return _run_jobs(work, config, file, executor, workers, on_progress, on_job)


def _run_jobs(
    work: "Batch",
    config: BatchConfig,
    file: Path,
    executor: Executor,
    workers: int | None,
    on_progress: OnProgress,
    on_job: Callable[[JobRecord], None],
) -> BatchResult:
    """Do the jobs that are left, and write the tables."""
    folder = work.folder
    if folder.is_file():
        raise FileExistsError(f"{folder}: expected a folder, got a file; choose another name")
    folder.mkdir(parents=True, exist_ok=True)
    lock(folder)
    try:
        work.begin(config, file)
    except FileExistsError:
        unlock(folder)
        raise
    done, ended_by = len(work.kept), None
    on_progress("batch", done, len(work.jobs))
    try:
        for record in work.run(executor=executor, workers=workers or all_threads()):
            done += 1
            on_progress("batch", done, len(work.jobs))
            on_job(record)
    except KeyboardInterrupt as interrupt:
        ended_by = interrupt
    files = work.write()
    unlock(folder)
    records = tuple(work.records())
    results = str(folder / files[0]) if work.remote is None else joined(work.remote, files[0])
    summary = {**work.summary(), "results": results}
    return BatchResult(folder, summary, files, (), ended_by, records)


@dataclass(slots=True)
class Batch:
    """Jobs and the folder of their results.

    Attributes
    ----------
    folder : Path
        Folder of the results on this machine.
    jobs : dict of str to BatchJob
        Jobs by the names of their folders.
    keys : dict of str to str
        Digests of everything that determines their results.
    kept : dict of str to JobRecord
        Jobs that an earlier run completed.
    made : dict of str to JobRecord
        Jobs that this run completed.
    remote : str or None
        Address that the results go to, if it is not the folder.
    held : frozenset of str
        Names of the jobs whose address contained files when the batch began.
    """

    folder: Path
    jobs: dict[str, BatchJob]
    keys: dict[str, str]
    kept: dict[str, JobRecord]
    made: dict[str, JobRecord]
    remote: str | None = None
    held: frozenset[str] = frozenset()

    @classmethod
    def of(
        cls, folder: Path, jobs: Sequence[BatchJob], *, is_fresh: bool, remote: str | None = None
    ) -> Self:
        """Make a batch: name the jobs and find those that an earlier run completed.

        Raises
        ------
        ConfigError
            A command is not known, or cannot be a job.
        """
        for job in jobs:
            check_commands(job)
        keys = [_key(job) for job in jobs]
        names = [_name(job, key) for job, key in zip(jobs, keys, strict=True)]
        key_of = dict(zip(names, keys, strict=True))
        found = {} if is_fresh else _found(folder, names, remote)
        kept = {
            name: record
            for name, record in found.items()
            if record.status == "done" and record.key == key_of[name]
            if remote is not None or _has_its_table(folder, record)
        }
        by_name = dict(zip(names, jobs, strict=True))
        return cls(folder, by_name, key_of, kept, {}, remote, _held(remote))

    def begin(self, config: BatchConfig, file: Path) -> None:
        """Write the note about the origin of the results: batch file, command, versions.

        Raises
        ------
        FileExistsError
            The folder holds finished jobs of another batch file, which this batch does not have.
        """
        check_origin(self.folder, file, set(self.jobs))
        write_origin(self.folder, file, config)

    def run(self, *, executor: Executor, workers: int) -> Iterator[JobRecord]:
        """Do the remaining jobs; yield each record as the job ends."""
        left = [name for name in self.jobs if name not in self.kept]
        threads = max(1, all_threads() // workers)
        # A folder that is passed through is new, and what an address holds says what is done.
        for name in left if self.remote is None else ():
            _begin(self.folder / name, self._record(name))
        tasks = [self._task(name, threads) for name in left]
        with closing(completed(tasks, workers=workers, executor=executor)) as ends:
            for number, outcome in ends:
                name = left[number]
                record = self._failed(name, outcome) if isinstance(outcome, Failure) else outcome
                self.made[name] = record
                yield record

    def records(self) -> list[JobRecord]:
        """Return the records of the jobs that have ended, in the order of the file.

        Records that Ctrl-C interrupted on their way are read from the folders of the jobs.
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

    def write(self) -> tuple[str, ...]:
        """Write the tables; return the names of the files of the batch, results first."""
        records = self.records()
        results = write_results(self.folder / RESULTS, records)
        rows = [[event[name] for name in EVENTS] for one in records for event in one.events]
        events = write_long_table(self.folder / EVENTS_TABLE, EVENTS, rows)
        files = (results.name, events.name, ORIGIN)
        if self.remote is None:
            _remove_others(self.folder / TRACKS, set(self.jobs))
        else:
            for name in files:
                stored_file(self.folder / name, joined(self.remote, name))
        return files

    def _failed(self, name: str, failure: Failure) -> JobRecord:
        error = told_error(failure.error)
        record = replace(self._record(name), status="failed", error=error)
        workplace = self._workplace(name)
        workplace.clear_tracks()
        workplace.deliver(record)
        return record

    def _record(self, name: str) -> JobRecord:
        job = self.jobs[name]
        return JobRecord(name, job.group, self.keys[name], "running", values=job.values)

    def _workplace(self, name: str) -> Workplace:
        return Workplace(self.folder.resolve(), name, self.remote, name in self.held)

    def _task(self, name: str, threads: int) -> Task:
        workplace = self._workplace(name)
        return Task(
            name,
            run_job,
            {
                "record": self._record(name),
                "commands": self.jobs[name].commands_into(workplace.folder),
                "workplace": workplace,
                "place": Path.cwd(),
                "threads": threads,
                "build": build_digest(),
            },
        )


def _found(folder: Path, names: Sequence[str], remote: str | None) -> dict[str, JobRecord]:
    """Records of jobs that an earlier run left."""
    if remote is None:
        read = {name: JobRecord.read(folder / name) for name in names}
    else:
        held = texts(joined(remote, f"*/{NOTE}"))
        by_name = {PurePosixPath(address).parent.name: data for address, data in held.items()}
        read = {name: JobRecord.parsed(by_name[name]) for name in names if name in by_name}
    return {name: record for name, record in read.items() if record is not None}


def _has_its_table(folder: Path, record: JobRecord) -> bool:
    """Return whether the objects of a job are in tracks/; another batch may have removed them."""
    table = Workplace(folder, record.job).tracks
    suffixes = (".parquet", ".csv")
    return not record.events or any(table.with_suffix(one).is_file() for one in suffixes)


def _held(remote: str | None) -> frozenset[str]:
    """Names of the jobs with a folder or table at the address; empty if `remote` is None."""
    if remote is None:
        return frozenset()
    tables = {Path(name).stem for name in held_names(joined(remote, TRACKS))}
    return frozenset(held_names(remote) | tables)


def _begin(folder: Path, record: JobRecord) -> None:
    """Make an empty folder for a job with its record in it; files of an earlier job are removed.

    The record is written first, so that an interruption leaves a folder that names its job.
    """
    if folder.exists() and not all(is_temporary(one.name) for one in folder.iterdir()):
        if not (folder / NOTE).is_file():
            raise FileExistsError(f"{folder}: holds files that no job wrote; choose another folder")
        record.write(folder)
        for one in folder.iterdir():
            if one.name != NOTE:
                shutil.rmtree(one) if one.is_dir() and not one.is_symlink() else one.unlink()
        return
    remove_stale(folder)
    folder.mkdir(parents=True, exist_ok=True)
    record.write(folder, is_first=True)


def _remove_others(folder: Path, names: set[str]) -> None:
    """Remove tables of jobs that the batch no longer has."""
    for table in folder.glob("*.*"):
        if table.stem not in names and table.suffix in {".parquet", ".csv"}:
            table.unlink()


def _name(job: BatchJob, key: str) -> str:
    """Readable name of a job's folder: group and values, then the beginning of the digest."""
    told = [_short(value) for value in job.values.values()]
    readable = "-".join([job.group, *(one for one in told if one)])
    return f"{readable[: NAME_LENGTH - KEY_LENGTH - 1].rstrip('-.')}-{key[:KEY_LENGTH]}"


def _short(value: Any) -> str:
    """Text of a value for a folder name; of a path or address the last part, without ending."""
    text = str(value).lower() if isinstance(value, bool) else str(value)
    if isinstance(value, str) and "/" in text:
        text = PurePosixPath(text.rstrip("/")).stem
    return re.sub(r"[^A-Za-z0-9._+=]+", "-", text).strip("-.")


def _key(job: BatchJob) -> str:
    """Digest of all that determines the result: build, commands, size and time of their files."""
    files: dict[str, Any] = {}
    for part in dict.fromkeys(part for command in job.commands for part in command):
        if is_remote(part):
            files[part] = file_versions(part)
        elif os.path.exists(part):
            files[part] = _file_versions(Path(part))
    made_of = json.dumps([build_digest(), job.commands, files], sort_keys=True)
    return hashlib.sha256(made_of.encode()).hexdigest()


def _file_versions(path: Path) -> list[tuple[str, int, int]]:
    found = [path] if path.is_file() else sorted(one for one in path.rglob("*") if one.is_file())
    return [(str(one), (at := one.stat()).st_size, at.st_mtime_ns) for one in found]
