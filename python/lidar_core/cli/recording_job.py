"""The work that commands on recordings share: scans through a pipeline, into a run folder."""

from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Generic, Protocol

import typer
from rich.console import Console
from rich.table import Table

from lidar_core.cli.common import INTERRUPTED, consoles, progress_on, write_json
from lidar_core.cli.run_options import RunOptions
from lidar_core.cli.scan_source import ScanSource
from lidar_core.config import Config
from lidar_core.errors import FormatError, LidarCoreError
from lidar_core.io import PosedScan, PoseOptions, ReadOptions
from lidar_core.io.poses.posed import ScanT
from lidar_core.run_folder import RunFolder, fingerprint

MCAP = "run.mcap"
REASONS = 3  # that a summary tells for rejected scans


class RecordingRun(Protocol[ScanT]):
    """A pipeline, and what it gave."""

    frame_id: str

    @property
    def n_received(self) -> int:
        """Scans so far, rejected ones included."""

    def take(self, item: PosedScan[ScanT]) -> None:
        """Process one scan."""

    def mcap(self, folder: RunFolder) -> AbstractContextManager[object]:
        """Open run.mcap for what `take` gives from here on."""

    def summary(self) -> dict[str, Any]:
        """What the run gave, as plain values."""

    def write(self, folder: RunFolder) -> list[str]:
        """Write tables and trajectories; return their names."""

    def draw(self, folder: RunFolder, name: str, console: Console) -> list[str]:
        """Draw the pictures of a run on the recording `name`; return their names."""


@dataclass(frozen=True, slots=True)
class RecordingJob(Generic[ScanT]):
    """What to read, how, and what to write.

    Attributes
    ----------
    command : str
        Name of the command.
    sort : type
        `Scan` or `LaserScan`: what is read.
    options : RunOptions
        What all commands are told.
    config : mapping of str to Config
        What run.toml keeps, by name.
    topics : tuple of str
        Topics of the sensors; empty for the only one.
    inputs : mapping of str to Path or None
        Further files that run.toml names with their hashes.
    note : mapping of str to Any
        Further values that run.toml keeps.
    """

    command: str
    sort: type[ScanT]
    options: RunOptions
    folder: RunFolder
    config: Mapping[str, Config]
    read: ReadOptions
    topics: tuple[str, ...]
    repeat: int = 1
    inputs: Mapping[str, Path | None] = field(default_factory=dict)
    note: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class JobResult:
    """What came out, as plain values, and what ended it early, if anything did."""

    summary: dict[str, Any]
    files: tuple[str, ...]
    end: KeyboardInterrupt | LidarCoreError | OSError | None


def do(job: RecordingJob[ScanT], run: RecordingRun[ScanT], console: Console) -> JobResult:
    """Process a recording and write the folder.

    Ctrl-C and errors on the way end it early; the folder then holds the scans so far. Errors
    before the first scan are raised, and leave no folder.
    """
    recording, poses = job.options.recording, job.options.poses()
    source = ScanSource(recording, job.read, poses, job.topics, job.repeat, job.sort)
    with source:
        end = _pass_through(job, source, run, console)
        if not run.n_received:
            job.folder.begin()
        summary = {
            "command": job.command,
            "recording": str(recording),
            "format": source.format,
            "poses": source.pose_source,
            "frame_id": source.frame_id,
            **run.summary(),
            "without_pose": source.without_pose,
            "notes": source.notes,
            "ended_early": None if end is None else str(end) or "interrupted",
        }
    files = [*run.write(job.folder), "run.toml", "summary.json"]
    job.folder.write_summary(summary)
    _write_note(job, poses, console)
    if job.options.picture:
        files += run.draw(job.folder, recording.name, console)
    if (job.folder.path / MCAP).exists():
        files.append(MCAP)
    return JobResult(summary, tuple(sorted(files)), end)


def report(result: JobResult, table: Table, job: RecordingJob[ScanT], out: Console) -> None:
    """Print what came out, and end the command as the job ended.

    Raises
    ------
    FormatError
        More than half of the scans were rejected.
    """
    json = job.options.json
    out.print(table)
    for note in result.summary["notes"]:
        out.print(f"note: {note}", markup=False, highlight=False, soft_wrap=True)
    out.print(f"{job.folder.path}: {', '.join(result.files)}", highlight=False, soft_wrap=True)
    write_json({**result.summary, "files": result.files}, json)
    if isinstance(result.end, KeyboardInterrupt):
        consoles(json)[1].print("interrupted: the files hold the scans up to here")
        raise typer.Exit(INTERRUPTED)
    if result.end is not None:
        raise result.end
    scans = result.summary["scans"]
    rejected = Counter(scans["rejected"])
    if 2 * rejected.total() > scans["received"]:
        raise FormatError(
            f"{rejected.total()} of {scans['received']} scans were rejected, most of them:"
            f" {rejected.most_common(1)[0][0]}; the files hold the others"
        )


def left_out(summary: Mapping[str, Any]) -> Iterator[str]:
    """Say which scans of a summary were not processed, and why, in words."""
    scans = summary["scans"]
    for count, what in (
        (sum(summary["without_pose"].values()), "without pose"),
        (scans.get("held", 0), "held for their pose"),
    ):
        if count:
            yield f"{count} {what}"
    rejected = Counter(scans["rejected"])
    if rejected:
        told = [f"{count} x {reason}" for reason, count in rejected.most_common(REASONS)]
        more = [f"{len(rejected) - REASONS} more reasons"] if len(rejected) > REASONS else []
        yield f"{rejected.total()} rejected: {'; '.join(told + more)}"


def _write_note(job: RecordingJob[ScanT], poses: PoseOptions, console: Console) -> None:
    """Write run.toml, with the hashes of everything that was read."""
    files = {"recording": job.options.recording, "poses": Path(poses.pose), **job.inputs}
    with console.status("hashing the recording"):
        inputs = {
            name: fingerprint(path)
            for name, path in files.items()
            if path is not None and path.exists()
        }
    config = {**job.config, "read": job.read, "pose": poses}
    job.folder.write_note(inputs, config, **job.note)


def _pass_through(
    job: RecordingJob[ScanT],
    source: ScanSource[ScanT],
    run: RecordingRun[ScanT],
    console: Console,
) -> KeyboardInterrupt | LidarCoreError | OSError | None:
    """Every scan through the pipeline; returns what ended it early."""
    scans = iter(source)
    try:
        first = next(scans, None)
        if first is None:
            return None
        run.frame_id = source.frame_id
        job.folder.begin()
        mcap = run.mcap(job.folder) if job.options.writes_mcap else nullcontext()
        with progress_on(console) as progress, mcap:
            task = progress.add_task(job.command, total=source.total)
            run.take(first)
            progress.advance(task)
            for item in scans:
                run.take(item)
                progress.advance(task)
    except KeyboardInterrupt as interrupt:
        return interrupt
    except (LidarCoreError, OSError) as error:  # OSError: also a run.mcap that filled the disk
        if not run.n_received:
            raise
        return error
    return None
