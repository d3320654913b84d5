"""Targets from the LiDAR and radar of a recording: the work of `fuse` and `config fit`."""

from collections.abc import Mapping, Sequence
from functools import partial
from os import PathLike
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from lidar_core.config import checked
from lidar_core.errors import InputError
from lidar_core.fusion import FusionConfig, MultiTargetConfig
from lidar_core.io import Span
from lidar_core.run_folder import RunFolder, fingerprint, remove_checkpoint
from lidar_core.runs.checkpoints import Checkpoints
from lidar_core.runs.recording import folder_to_write
from lidar_core.runs.result import RunResult, draw, no_mcap_of
from lidar_core.runs.settings import ConfigChoice, config_of_run
from lidar_core.runs.targets.job import FuseJob, with_ways
from lidar_core.runs.targets.many import ManyRun
from lidar_core.runs.targets.noise import fitted, names_told, text_of_fit
from lidar_core.runs.targets.one import TargetRun


@checked
def fuse(
    recording: str | PathLike[str],
    config: FusionConfig | MultiTargetConfig | ConfigChoice | None,
    output: str | PathLike[str],
    *,
    model: str | None = None,
    method: str | None = None,
    association: str | None = None,
    lag: float | None = None,
    columns: Mapping[str, str] | None = None,
    topics: Mapping[str, Sequence[str]] | None = None,
    time_unit: str | None = None,
    angle_unit: str | None = None,
    azimuth: Mapping[str, str] | None = None,
    clock: Mapping[str, float] | None = None,
    scale: Mapping[str, float] | None = None,
    span: Span | None = None,
    fit_noise: bool = False,
    force: bool = False,
    mcap: bool | None = None,
    picture: bool = True,
    overwrite: bool = False,
    checkpoint: Annotated[float, Field(gt=0)] | None = None,
    resume: bool = False,
) -> RunResult:
    """Track the target of a recording, or many, as `lidar-core fuse` does.

    Parameters
    ----------
    recording : str or Path
        L/R text, a table (CSV, TSV, Parquet, .npz), a ROS recording, detections of Autoferry,
        object lists of Delphi (CSV) or Continental radars (YAML), radar sweeps (PCD) or detections
        (JSON) of nuScenes; a folder of CSV, YAML or PCD files is one recording.
    config : FusionConfig, MultiTargetConfig, ConfigChoice or None
        Configuration of the filter of one target, or of the tracker of many; None is best mode.
    output : str or Path
        Folder to write: tables of states with covariances, innovations and NIS, and of tracks,
        SI units; trajectories, summary.json, run.toml, run.mcap, picture.png.
    model, method, association : str, optional
        These values of the configuration instead of its own; `association` is for many targets,
        also of a table.
    lag : float, optional
        Smooth the states of one target: each state also uses the measurements of this time after
        it [s].
    columns : mapping of str to str, optional
        Names of a table's columns, such as {"x": "pos_x"}.
    topics : mapping of str to sequence of str, optional
        Topics of a ROS recording, such as {"radar": ["/front"]}.
    time_unit, angle_unit : str, optional
        Units of a table: ns, us, ms or s; rad or deg.
    azimuth : mapping of str to str, optional
        Angles of a table that are not counter-clockwise from x, such as {"bearing": "clockwise"}.
    clock : mapping of str to float, optional
        Offset of the clock of a sensor in a table, positive if it is ahead [s], such as {"radar":
        0.5}.
    scale : mapping of str to float, optional
        Factors of a table's columns, by our names, such as {"range": 0.001}.
    span : Span, optional
        Part of the recording to use, from its first measurement [s].
    fit_noise : bool
        Find the noise of motion and sensors from the measurements first, as `fit_config` does.
    force : bool
        Continue with implausible measurements of one target, or times of a table that cannot be in
        their unit.
    mcap, picture, overwrite
        See `detect`.
    checkpoint, resume
        See `detect`. The run of one target is short: it starts again, with the same results.

    Returns
    -------
    RunResult

    Raises
    ------
    InputError
        No measurements in `span`, their NIS is beyond reason, or the times of a table cannot be in
        their unit; the text names likely causes.
    ConfigError
        A value that cannot be used, or that has no meaning for this recording.
    FormatError, FileExistsError, MissingExtraError
        See `detect`.
    """
    source = Path(recording)
    folder, writes_mcap = folder_to_write(
        output,
        mcap=mcap,
        overwrite=overwrite,
        reads=source,
        checkpoint=checkpoint,
        resume=resume,
    )
    keeps = checkpoint is not None or resume
    checkpoints = partial(_checkpoints, folder.path, checkpoint, source if keeps else None)
    ways = {"model": model, "method": method, "association": association}
    job = FuseJob(
        source,
        config,
        {name: value for name, value in ways.items() if value is not None},
        _given_values(
            columns=columns,
            topics=topics,
            time_unit=time_unit,
            angle_unit=angle_unit,
            azimuth=azimuth,
            clock=clock,
            scale=scale,
        ),
        span or Span(),
        lag,
        force,
        fit_noise,
    )
    run = job.run(checkpoints, folder.begin if keeps else lambda: None)
    is_kept = keeps and isinstance(run, ManyRun)
    if not is_kept:
        if resume:
            checkpoints({}).refuse("of another run: that of one target writes none")
        folder.begin()
    notes = _notes(job, run, wants_checkpoint=keeps)
    if writes_mcap and (lacks_mcap := no_mcap_of(run.stamps)) and not mcap:
        notes.append(lacks_mcap)
        writes_mcap = False
    return _write_run(run, folder, recording, notes, mcap=writes_mcap, picture=picture)


def _checkpoints(
    folder: Path, interval: float | None, source: Path | None, decides: Mapping[str, Any]
) -> Checkpoints:
    """Return the checkpoints of a run on many targets.

    `source` is the recording, whose hash they keep; None if no checkpoints are written.
    """
    inputs = {"command": "fuse", **decides}
    if source is not None:
        read = fingerprint(source)
        inputs |= {name: value for name, value in read.items() if name != "path"}
    return Checkpoints(folder, interval, inputs)


def _notes(job: FuseJob, run: TargetRun | ManyRun, *, wants_checkpoint: bool) -> list[str]:
    """Return what the user has to know about a finished run."""
    notes = [f"note: {doubt}" for doubt in run.doubts]
    if isinstance(run, TargetRun):
        if job.fit_noise:
            notes.append(f"note: {text_of_fit(run.config, names_told(job.config, job.ways))}")
        if wants_checkpoint:
            notes.append("note: one target: no checkpoint is written; a killed run starts again")
    return notes


def _write_run(
    run: TargetRun | ManyRun,
    folder: RunFolder,
    recording: str | PathLike[str],
    notes: list[str],
    *,
    mcap: bool,
    picture: bool,
) -> RunResult:
    """Write everything that a finished run leaves, and remove its checkpoint."""
    source = Path(recording)
    files = run.write(folder)
    summary = {"command": "fuse", "recording": str(recording), **run.summary()}
    folder.write_summary(summary)
    folder.write_note({"recording": fingerprint(source)}, run.configs)
    if mcap:
        files.append(run.write_mcap(folder))
    if picture:
        drawn, missing = draw(run.pictures(folder, source.name))
        files += drawn
        notes = [*notes, *missing]
    files = sorted([*files, "run.toml", "summary.json"])
    remove_checkpoint(folder.path)
    return RunResult(folder.path, summary, tuple(files), tuple(notes))


@checked
def fit_config(
    recordings: str | PathLike[str] | Sequence[str | PathLike[str]],
    config: FusionConfig | ConfigChoice | None = None,
    *,
    model: str | None = None,
    method: str | None = None,
    columns: Mapping[str, str] | None = None,
    topics: Mapping[str, Sequence[str]] | None = None,
    time_unit: str | None = None,
    angle_unit: str | None = None,
    azimuth: Mapping[str, str] | None = None,
    clock: Mapping[str, float] | None = None,
    scale: Mapping[str, float] | None = None,
    span: Span | None = None,
    force: bool = False,
) -> FusionConfig:
    """Find the noise of motion and sensors from recordings, as `lidar-core config fit` does.

    Parameters
    ----------
    recordings : str, Path, or sequence of them
        Measurements of one target each: L/R text, tables, ROS recordings. No truth is needed.
    config : FusionConfig, ConfigChoice or None
        Model and method, and where the search begins; None is best mode.
    model, method : str, optional
        These values of the configuration instead of its own.
    columns, topics, time_unit, angle_unit, azimuth, clock, scale, span
        See `fuse`; they apply to every recording.
    force : bool
        Fit the noise even if mistakes in the measurements, such as exchanged axes, are likely.

    Returns
    -------
    FusionConfig
        `config` with the noise under which the measurements are most likely. Without a given model
        or method, also the likelier model of ct and ctrv.

    Raises
    ------
    ConfigError
        A recording of many targets; model paper; a value that cannot be used.
    InputError
        Too few measurements, of one recording or of all; no noise makes them possible; or the
        noise would have to explain a mistake, which the text names.
    FormatError
        A recording cannot be read.

    See Also
    --------
    lidar_core.fusion.fit_noise : the same for measurements in memory.
    """
    places = [recordings] if isinstance(recordings, str | PathLike) else list(recordings)
    if not places:
        raise InputError("recordings: expected at least one, got none")
    read = _given_values(
        columns=columns,
        topics=topics,
        time_unit=time_unit,
        angle_unit=angle_unit,
        azimuth=azimuth,
        clock=clock,
        scale=scale,
    )
    within = span or Span()
    jobs = [FuseJob(Path(place), config, {}, read, within, force=force) for place in places]
    logs = [(job.recording, job.log()) for job in jobs]
    ways = _given_values(model=model, method=method)
    chosen = config_of_run(with_ways(config, ways), FusionConfig, "fusion")
    return fitted(logs, chosen, told=names_told(config, ways), force=force)


def _given_values(**values: Any) -> dict[str, Any]:
    """Return the values that are not None and not empty, by name."""
    return {name: value for name, value in values.items() if value}
