"""One job of a batch, in the process of a worker: its commands, one after the other."""

import json
import os
import shutil
import sys
from collections.abc import Mapping, Sequence
from contextlib import nullcontext, redirect_stderr, redirect_stdout
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from lidar_core.batch import JobRecord
from lidar_core.batch.results import NOTE, flat
from lidar_core.errors import ConfigError, FormatError, LidarCoreError
from lidar_core.io.child.trust import trusted_files
from lidar_core.io.files.atomic import synced_together, unsynced
from lidar_core.io.remote import fetched, is_remote, joined, removed, stored, stored_file
from lidar_core.io.tables.long_table import write_long_table
from lidar_core.run_folder import RUN_FILE, build_digest
from lidar_core.runs.catalogue import EVENTS, OBJECTS, has_objects, objects_and_events
from lidar_core.runs.jobs.commands import OVERFLIGHT, command_line, options_of

LOG, TRACKS = "log.txt", "tracks"
INPUT = "input"
"""Folder of a job for the files that it fetches; it is gone when the job has ended."""


@dataclass(frozen=True, slots=True)
class Workplace:
    """Folder that a job writes to, and destination of its results.

    Attributes
    ----------
    batch : Path
        Folder of the batch on this machine.
    job : str
        Name of the job, and of its folder there.
    remote : str or None
        Address that the results go to; they do not stay on this machine then.
    is_held : bool
        True if the address may contain old files of the job, which must be removed first.
    """

    batch: Path
    job: str
    remote: str | None = None
    is_held: bool = True

    @property
    def folder(self) -> Path:
        """Folder of the job on this machine."""
        return self.batch / self.job

    @property
    def tracks(self) -> Path:
        """Table of the objects of the job: .parquet, or .csv without pyarrow."""
        return self.batch / TRACKS / f"{self.job}.parquet"

    def clear_tracks(self) -> None:
        """Remove the table of an earlier attempt."""
        for suffix in (".parquet", ".csv"):
            self.tracks.with_suffix(suffix).unlink(missing_ok=True)

    def deliver(self, record: JobRecord) -> None:
        """Write the outcome of the job. Files for an address are copied first, job.json last."""
        if self.remote is None:
            record.write(self.folder)
            return
        # An attempt that was cut may have stored files; those of a job that is done replace them.
        is_replaced = self.is_held or record.status != "done"
        for suffix in (".parquet", ".csv"):
            table = self.tracks.with_suffix(suffix)
            address = joined(self.remote, f"{TRACKS}/{table.name}")
            if table.is_file():
                stored_file(table, address)
            elif is_replaced:
                removed(address)
        self.folder.mkdir(parents=True, exist_ok=True)
        record.write(self.folder)
        target = joined(self.remote, self.job)
        stored(self.folder, target, last=(NOTE,), is_replaced=is_replaced)
        self.clear_tracks()
        for one in self.folder.iterdir():
            if one.name != NOTE:
                shutil.rmtree(one) if one.is_dir() else one.unlink()


def run_job(
    *,
    record: JobRecord,
    commands: Sequence[Sequence[str]],
    workplace: Workplace,
    place: Path,
    threads: int,
    build: str,
) -> JobRecord:
    """Run the commands of a job, one after the other, and return the record of the job.

    Files on other machines are fetched first. The output of the commands is written to log.txt, and
    the objects of all runs to one table. An error of a command does not raise: the record then has
    the status "failed" and the text of the error.

    Parameters
    ----------
    record : JobRecord
        The job before its start.
    commands : sequence of sequence of str
        Commands with their arguments, without `lidar-core`.
    workplace : Workplace
        Folder of the results.
    place : Path
        Folder that becomes the working directory.
    threads : int
        Threads of each command.
    build : str
        Build that the job is for; with another build of this package, the job fails.
    """
    # What goes to another machine is only passed through the disk of this one.
    with nullcontext() if workplace.remote is None else unsynced():
        return _run_and_deliver(record, commands, workplace, place, threads, build)


def _run_and_deliver(
    record: JobRecord,
    commands: Sequence[Sequence[str]],
    workplace: Workplace,
    place: Path,
    threads: int,
    build: str,
) -> JobRecord:
    start = perf_counter()
    folder = workplace.folder
    numbers: dict[str, Any] = {}
    events: list[dict[str, Any]] = []
    try:
        if build != build_digest():
            raise ConfigError("batch: this worker has another build of lidar_core")
        folder.mkdir(parents=True, exist_ok=True)
        os.chdir(place)
        local, names = _with_fetched(commands, folder / INPUT)
        with synced_together():  # nothing of it counts before job.json says that the job is done
            with (
                (folder / LOG).open("w", encoding="utf-8") as log,
                redirect_stdout(log),
                redirect_stderr(log),
            ):
                for number, command in enumerate(local, start=1):
                    told = folder / f"{number}-{command[0]}.json"
                    numbers |= flat(_told_by(command, told, threads), _prefix(commands, number - 1))
            events = _tabled(workplace, names)
        numbers = {path: _anywhere(value, workplace, names) for path, value in numbers.items()}
    except Exception as error:  # whatever it is, it is what the record is for
        ended = replace(record, status="failed", error=told_error(error))
        workplace.clear_tracks()
    else:
        ended = replace(record, status="done", numbers=numbers, events=events)
    shutil.rmtree(folder / INPUT, ignore_errors=True)
    ended = replace(ended, seconds=round(perf_counter() - start, 3))
    workplace.deliver(ended)
    return ended


def told_error(error: Exception) -> str:
    """Return the error message of a job as one text."""
    text = (
        str(error)
        if isinstance(error, LidarCoreError | OSError)
        else (f"{type(error).__name__}: {error}")
    )
    return text.strip() or type(error).__name__


def _with_fetched(
    commands: Sequence[Sequence[str]], folder: Path
) -> tuple[list[list[str]], dict[str, str]]:
    """Fetch remote files; return the commands with local paths, and the address of each path."""
    addresses = dict.fromkeys(part for one in commands for part in one if is_remote(part))
    # Each in a folder of its own: files of different folders may have one name.
    places = {
        address: str(fetched(address, folder / str(number)))
        for number, address in enumerate(addresses)
    }
    local = [[places.get(part, part) for part in command] for command in commands]
    return local, {place: address for address, place in places.items()}


def _tabled(workplace: Workplace, names: Mapping[str, str]) -> list[dict[str, Any]]:
    """Write the objects of all runs of a job into its table; return their events as rows.

    Raises
    ------
    FormatError
        The tables of a run cannot be read as objects.
    """
    rows: list[Sequence[Any]] = []
    events: list[dict[str, Any]] = []
    for note in sorted(workplace.folder.rglob(RUN_FILE)):
        if not has_objects(note.parent):
            continue  # such as a training
        run = f"{workplace.job}/{note.parent.relative_to(workplace.folder).as_posix()}"
        try:
            with trusted_files():  # this process has just written them
                objects, happened = objects_and_events(note.parent, run=run)
        except (LidarCoreError, KeyError) as error:  # a table of all jobs must not lack this one
            raise FormatError(
                f"{run}: the commands ended, but the objects of this run cannot be collected:"
                f" {told_error(error)}"
            ) from error
        for table in (objects, happened):
            told = [_named(str(one), workplace, names) for one in table["recording"].tolist()]
            table["recording"] = np.array(told, np.str_)
        rows += zip(*(objects[name].tolist() for name in OBJECTS), strict=True)
        values = zip(*(happened[name].tolist() for name in EVENTS), strict=True)
        events += [dict(zip(EVENTS, row, strict=True)) for row in values]
    workplace.clear_tracks()
    if rows:
        workplace.tracks.parent.mkdir(exist_ok=True)
        write_long_table(workplace.tracks, OBJECTS, rows)
    return events


def _anywhere(value: Any, workplace: Workplace, names: Mapping[str, str]) -> Any:
    """Return a text without paths of this machine, so that it is the same on every machine."""
    if not isinstance(value, str):
        return value
    for place, address in names.items():
        value = value.replace(place, address)
    return value.replace(f"{workplace.folder}{os.sep}", f"{workplace.job}/")


def _named(recording: str, workplace: Workplace, names: Mapping[str, str]) -> str:
    """Name of a recording that does not depend on the machine, if it has one; else its path."""
    if recording in names:
        return names[recording]
    folder = f"{workplace.folder}{os.sep}"
    if recording.startswith(folder):
        return f"{workplace.job}/{Path(recording).relative_to(folder).as_posix()}"
    return recording


def _prefix(commands: Sequence[Sequence[str]], index: int) -> str:
    """Prefix of the names of a command's results: its name, numbered if the job repeats it."""
    names = [command[0] for command in commands]
    name = names[index]
    return f"{name}-{names[: index + 1].count(name)}" if names.count(name) > 1 else name


def _told_by(command: Sequence[str], told: Path, threads: int) -> Any:
    """Run one command; return its JSON result, written to the file `told`; empty without one."""
    options = options_of(command[0])
    more = ["--json", str(told)] if "--json" in options and "--json" not in command else []
    if "--threads" in options and not {"--threads", OVERFLIGHT} & set(command):
        more += ["--threads", str(threads)]
    arguments = [*command, *more]
    sys.argv = ["lidar-core", *arguments]
    status = command_line()(arguments, standalone_mode=False)
    if status:
        raise ChildProcessError(f"lidar-core {' '.join(command)}: exit status {status}, see {LOG}")
    if not told.is_file():
        return {}
    return json.loads(told.read_text(encoding="utf-8"))
