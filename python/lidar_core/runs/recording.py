"""Runs on recordings: scans through a pipeline, into a run folder."""

from collections.abc import Mapping
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field
from itertools import chain
from os import PathLike
from pathlib import Path
from typing import Any, Generic, Protocol

from lidar_core.config import Config
from lidar_core.errors import ConfigError, LidarCoreError
from lidar_core.io import PoseOptions, ReadOptions
from lidar_core.messages import PosedScan, ScanT
from lidar_core.run_folder import RunFolder, fingerprint, remove_checkpoint
from lidar_core.runs.checkpoints import Checkpoints, Resumable
from lidar_core.runs.result import (
    MCAP,
    OnProgress,
    Picture,
    RunResult,
    count_unposed,
    draw,
    wants_mcap,
)
from lidar_core.runs.scans.source import ScanSource


class ScanRun(Resumable, Protocol[ScanT]):
    """A pipeline with its results so far."""

    frame_id: str
    is_whole: bool
    """False if an error or Ctrl-C ended the run early."""

    @property
    def n_received(self) -> int:
        """Number of scans so far, including rejected ones."""

    @property
    def notes(self) -> list[str]:
        """Return warnings about the scans so far, in words."""

    def take(self, item: PosedScan[ScanT]) -> object:
        """Process one scan."""

    def open_mcap(self, folder: RunFolder) -> AbstractContextManager[object]:
        """Open run.mcap for the results of the scans from here on."""

    def summary(self) -> dict[str, Any]:
        """Return the results as plain values."""

    def write(self, folder: RunFolder) -> list[str]:
        """Write tables and trajectories; return their names."""

    def pictures(self, folder: RunFolder, name: str) -> list[Picture]:
        """Return the pictures of a run on the recording `name`."""


@dataclass(frozen=True, slots=True)
class RecordingJob(Generic[ScanT]):
    """A recording, the options for reading it, and the files to write.

    Attributes
    ----------
    command : str
        Name of the command.
    sort : type
        `Scan` or `LaserScan`: the kind of scans to read.
    recording : Path
        File or folder.
    folder : RunFolder
        Folder to write.
    config : mapping of str to Config
        Configurations that run.toml keeps, by name.
    read : ReadOptions
        Options for reading the recording.
    pose : PoseOptions
        Source of the poses, and part of the recording that is used.
    topics : tuple of str
        Topics of the sensors; empty for the only one.
    repeat : int
        Number of times that the recording is played.
    inputs : mapping of str to Path or None
        Further files that run.toml names with their hashes.
    note : mapping of str to Any
        Further values that run.toml keeps.
    checkpoint : float or None
        Time between two checkpoints [s]; None writes none.
    resume : bool
        Continue from the last checkpoint in the folder.
    mcap : bool
        Write run.mcap.
    picture : bool
        Draw pictures.
    on_progress : callable
        Called with the progress of the run.
    """

    command: str
    sort: type[ScanT]
    recording: Path
    folder: RunFolder
    config: Mapping[str, Config]
    read: ReadOptions
    pose: PoseOptions
    topics: tuple[str, ...]
    mcap: bool
    picture: bool
    on_progress: OnProgress
    repeat: int = 1
    inputs: Mapping[str, Path | None] = field(default_factory=dict)
    note: Mapping[str, Any] = field(default_factory=dict)
    checkpoint: float | None = None
    resume: bool = False

    def run(self, run: ScanRun[ScanT]) -> RunResult:
        """Process the recording and write the folder.

        Ctrl-C and errors during the run end it early; the folder then holds the scans so far.
        Errors before the first scan are raised, and no folder is written.
        """
        source = ScanSource(
            self.recording, self.read, self.pose, self.topics, self.repeat, self.sort
        )
        with source:
            ended_by = self._process(source, run)
            run.is_whole = ended_by is None
            if not run.n_received:
                self.folder.begin()
            summary: dict[str, Any] = {
                "command": self.command,
                "recording": str(self.recording),
                "format": source.format,
                "poses": source.pose_source,
                "frame_id": source.frame_id,
                **run.summary(),
                "without_pose": source.without_pose,
                "notes": source.notes + run.notes,
                "ended_early": None if ended_by is None else str(ended_by) or "interrupted",
            }
        count_unposed(summary)
        files = [*run.write(self.folder), "run.toml", "summary.json"]
        self.folder.write_summary(summary)
        self._write_note()
        notes: list[str] = []
        if self.picture:
            drawn, notes = draw(run.pictures(self.folder, self.recording.name), self.on_progress)
            files += drawn
        if (self.folder.path / MCAP).exists():
            files.append(MCAP)
        if ended_by is None:
            remove_checkpoint(self.folder.path)
        return RunResult(self.folder.path, summary, tuple(sorted(files)), tuple(notes), ended_by)

    def _process(
        self, source: ScanSource[ScanT], run: ScanRun[ScanT]
    ) -> KeyboardInterrupt | LidarCoreError | OSError | None:
        """Pass every scan through the pipeline; return what ended it early."""
        scans = iter(source)
        try:
            first = next(scans, None)
            if first is None:
                return None
            checkpoints = self._checkpoints()
            done = checkpoints.resume(run) if self.resume else 0
            run.frame_id = source.frame_id
            self.folder.begin()
            total = source.total
            with run.open_mcap(self.folder) if self.mcap else nullcontext():
                for number, item in enumerate(chain((first,), scans)):
                    if number:
                        self.on_progress(self.command, number, total)
                    if number >= done:  # read, but used by the run that goes on
                        run.take(item)
                        if self.checkpoint is not None:
                            checkpoints.take(run, number + 1)
        except KeyboardInterrupt as interrupt:
            return interrupt
        except (LidarCoreError, OSError) as error:  # OSError: also a run.mcap that filled the disk
            if not run.n_received:
                raise
            return error
        return None

    def _checkpoints(self) -> Checkpoints:
        """Return the object that writes checkpoints and finds the last one."""
        if self.checkpoint is None and not self.resume:
            return Checkpoints(self.folder.path, None, {})
        contents = {
            name: {key: value for key, value in found.items() if key != "path"}
            for name, found in self._fingerprints().items()
        }
        models = {name: one.model_dump(mode="json") for name, one in self._configs().items()}
        decides = {"command": self.command, **contents, **models, **self.note}
        return Checkpoints(self.folder.path, self.checkpoint, decides)

    def _fingerprints(self) -> dict[str, dict[str, Any]]:
        """Hashes of all files that the run reads, by name."""
        files = {"recording": self.recording, "poses": Path(self.pose.pose), **self.inputs}
        self.on_progress("hashing the recording", 0, None)
        return {
            name: fingerprint(path)
            for name, path in files.items()
            if path is not None and path.exists()
        }

    def _configs(self) -> dict[str, Config]:
        return {**self.config, "read": self.read, "pose": self.pose}

    def _write_note(self) -> None:
        """Write run.toml, with the hashes of everything that was read."""
        self.folder.write_note(self._fingerprints(), self._configs(), **self.note)


def folder_to_write(
    output: str | PathLike[str],
    *,
    mcap: bool | None,
    overwrite: bool,
    reads: Path | None,
    checkpoint: float | None = None,
    resume: bool = False,
) -> tuple[RunFolder, bool]:
    """Return the folder of a run, and whether it gets a run.mcap; raise errors before any work.

    Runs with checkpoints get no run.mcap: an interrupted file cannot be continued.

    Raises
    ------
    ConfigError
        `mcap` or `overwrite` is true beside options that it contradicts.
    FileExistsError
        The folder holds other files, or an earlier run and `overwrite` is not given.
    MissingExtraError
        `mcap` is true, and the package for it is not installed.
    """
    if overwrite and resume:
        raise ConfigError(
            "resume=True continues a run, overwrite=True replaces it; give one of them"
        )
    if checkpoint is not None or resume:
        if mcap:
            raise ConfigError(
                "mcap=True: an interrupted run.mcap cannot be continued; leave out"
                " mcap=True, or checkpoint and resume"
            )
        mcap = False
    writes_mcap = wants_mcap(mcap)
    folder = RunFolder(Path(output), overwrite=overwrite, reads=reads, resume=resume)
    return folder, writes_mcap
