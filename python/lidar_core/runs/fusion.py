"""Targets from the LiDAR and radar of a recording: one target, or many."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from os import PathLike
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from lidar_core.config import Config, checked
from lidar_core.errors import ConfigError, InputError
from lidar_core.fusion import (
    BagOptions,
    DetectionScan,
    FusionConfig,
    MeasurementLog,
    MultiTargetConfig,
    TableOptions,
    read_bag,
    read_measurements,
)
from lidar_core.fusion.plausibility import implausible
from lidar_core.fusion.recordings.lists import list_reader
from lidar_core.fusion.recordings.scans import TargetScans, scans_of
from lidar_core.fusion.recordings.table import is_table
from lidar_core.io import Span
from lidar_core.io.options import NS
from lidar_core.run_folder import fingerprint, remove_checkpoint
from lidar_core.runs.checkpoints import Checkpoints
from lidar_core.runs.recording import folder_to_write
from lidar_core.runs.result import RunResult, draw, no_mcap_of
from lidar_core.runs.settings import ConfigChoice, config_of_run, with_assignments
from lidar_core.runs.targets.many import ManyRun
from lidar_core.runs.targets.noise import fitted, tells_model
from lidar_core.runs.targets.one import TargetRun

BAGS = (".bag", ".db3", ".mcap")


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
        Smooth: every state uses what came up to this much later [s]; for one target.
    columns : mapping of str to str, optional
        Names of a table's columns, such as {"x": "pos_x"}.
    topics : mapping of str to sequence of str, optional
        Topics of a ROS recording, such as {"radar": ["/front"]}.
    time_unit, angle_unit : str, optional
        Of a table: ns, us, ms or s; rad or deg.
    azimuth : mapping of str to str, optional
        Of a table: what does not count counter-clockwise from x, such as {"bearing": "clockwise"}.
    clock : mapping of str to float, optional
        Of a table: how far the clock of a sensor is ahead [s], such as {"radar": 0.5}.
    span : Span, optional
        Part of the recording to use, from its first measurement [s].
    fit_noise : bool
        Find the noise of motion and sensors from the measurements first, as `fit_config` does.
    force : bool
        Go on with measurements of one target whose NIS is beyond reason.
    mcap, picture, overwrite
        As in `detect`.
    checkpoint, resume
        As in `detect`. The run of one target is short: it starts again, with the same results.

    Returns
    -------
    RunResult

    Raises
    ------
    InputError
        No measurements in `span`, or their NIS is beyond reason; the text names likely causes.
    ConfigError
        A value that cannot be used, or that says nothing about this recording.
    FormatError, FileExistsError, MissingExtraError
        As in `detect`.
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

    def checkpoints(decides: Mapping[str, Any]) -> Checkpoints:
        """What keeps a run on many targets, and finds it."""
        inputs = {"command": "fuse", **decides}
        if keeps:
            read = fingerprint(source)
            inputs |= {name: value for name, value in read.items() if name != "path"}
        return Checkpoints(folder.path, checkpoint, inputs)

    ways = {"model": model, "method": method, "association": association}
    job = _FuseJob(
        source,
        config,
        {name: value for name, value in ways.items() if value is not None},
        _given(
            columns=columns,
            topics=topics,
            time_unit=time_unit,
            angle_unit=angle_unit,
            azimuth=azimuth,
            clock=clock,
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
    files = run.write(folder)
    summary = {"command": "fuse", "recording": str(recording), **run.summary()}
    folder.write_summary(summary)
    folder.write_note({"recording": fingerprint(source)}, run.configs)
    notes = [f"note: {run.doubt}"] if run.doubt else []
    lacks_mcap = no_mcap_of(run.stamps)
    if writes_mcap and (mcap or not lacks_mcap):
        files.append(run.write_mcap(folder))
    elif writes_mcap and lacks_mcap:
        notes.append(lacks_mcap)
    if keeps and not is_kept:
        notes.append("note: one target: no checkpoint is written; a killed run starts again")
    if picture:
        drawn, missing = draw(run.pictures(folder, source.name))
        files += drawn
        notes += missing
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
    columns, topics, time_unit, angle_unit, azimuth, clock, span
        As in `fuse`, for every recording.
    force : bool
        Take mistakes in the measurements, such as exchanged axes, for noise.

    Returns
    -------
    FusionConfig
        `config` with the noise under which the measurements are most likely; where no model or
        method is told, also with the likelier model of ct and ctrv.

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
    read = _given(
        columns=columns,
        topics=topics,
        time_unit=time_unit,
        angle_unit=angle_unit,
        azimuth=azimuth,
        clock=clock,
    )
    jobs = [_FuseJob(Path(place), config, {}, read, span or Span()) for place in places]
    logs = [(job.recording, job.log()) for job in jobs]
    ways = _given(model=model, method=method)
    chosen = config_of_run(_with(config, ways), FusionConfig, "fusion")
    return fitted(logs, chosen, finds_model=not tells_model(config, ways), force=force)


@dataclass(frozen=True, slots=True)
class _FuseJob:
    """A recording of measurements, and how to fuse them."""

    recording: Path
    config: FusionConfig | MultiTargetConfig | ConfigChoice | None
    ways: Mapping[str, str]
    read: Mapping[str, Any]
    span: Span
    lag: float | None = None
    force: bool = False
    fit_noise: bool = False

    def run(
        self, checkpoints: Callable[[Mapping[str, Any]], Checkpoints], begin: Callable[[], None]
    ) -> TargetRun | ManyRun:
        """Read the recording, and filter or track; with many, `begin` comes before checkpoints."""
        found, reading = self._found()
        if isinstance(found, MeasurementLog):
            return self._one(found, reading)
        kept, chosen = self._many(found)
        reading = {**reading, "span": self.span}
        models = {"fusion_many": chosen, **reading}
        decides = {name: one.model_dump(mode="json") for name, one in models.items()}
        return ManyRun.of(
            kept,
            chosen,
            reading,
            source=found.source,
            checkpoints=checkpoints(decides),
            begin=begin,
        )

    def log(self) -> MeasurementLog:
        """The measurements of one target, within the span.

        Raises
        ------
        ConfigError
            The recording holds many targets.
        """
        found, _ = self._found()
        if not isinstance(found, MeasurementLog):
            raise ConfigError(f"{self.recording}: many targets; noise is found from one")
        return self._within(found)

    def _found(self) -> tuple[MeasurementLog | TargetScans, Mapping[str, Config]]:
        """What the recording holds, and how it was read."""
        recording = self.recording
        reader = list_reader(recording)
        if reader is not None:
            self._check_read(f"{reader[0]} recordings", ())
            return TargetScans(reader[1](recording), reader[0]), {}
        if recording.is_dir() or recording.suffix.lower() in BAGS:
            self._check_read("a ROS recording", ("topics",))
            return self._bag()
        of_tables = ("columns", "time_unit", "angle_unit", "azimuth", "clock")
        tabular = is_table(recording)
        self._check_read(*(("a table", of_tables) if tabular else ("L/R text", ())))
        options = TableOptions.load(dict(self.read))
        log, reading = read_measurements(recording, options), {"fusion_table": options}
        if tabular and self._of_many:
            return TargetScans(scans_of(log), log.format), reading
        return log, reading

    @property
    def _of_many(self) -> bool:
        """Whether many targets were asked for."""
        return "association" in self.ways or isinstance(self.config, MultiTargetConfig)

    def _bag(self) -> tuple[MeasurementLog | TargetScans, Mapping[str, Config]]:
        """One target, unless a message holds several or an association was asked for."""
        options = BagOptions.load(dict(self.read))
        scans, reading = read_bag(self.recording, options), {"fusion_bag": options}
        if self._of_many or any(len(scan.measurements) > 1 for scan in scans):
            return TargetScans(scans, "ROS"), reading
        measurements = [m for scan in scans for m in scan.measurements]
        return MeasurementLog(measurements, None, "ROS"), reading

    def _one(self, log: MeasurementLog, reading: Mapping[str, Config]) -> TargetRun:
        if self._of_many:
            raise ConfigError(f"{self.recording}: one target; association is for many")
        chosen = config_of_run(_with(self.config, self.ways), FusionConfig, "fusion")
        kept = self._within(log)
        if chosen.model == "ctrv-drone" and any(m.sensor == "pose" for m in kept.measurements):
            raise ConfigError(
                f"{self.recording}: model ctrv-drone is for measurements without poses"
                " of the platform, which are here; ctrv takes them in"
            )
        if self.fit_noise:
            finds_model = not tells_model(self.config, self.ways)
            logs = [(self.recording, kept)]
            chosen = fitted(logs, chosen, finds_model=finds_model, force=self.force)
        made = TargetRun.of(kept, chosen, {**reading, "span": self.span}, lag=self.lag)
        doubt = implausible(made.log.measurements, chosen)
        if doubt is not None and not self.force:
            raise InputError(f"{self.recording}: {doubt}. force=True goes on nevertheless")
        return made if doubt is None else replace(made, implausible=str(doubt))

    def _many(self, found: TargetScans) -> tuple[list[DetectionScan], MultiTargetConfig]:
        """Scans within the span, and the configuration."""
        choice = self.config
        is_paper = isinstance(choice, ConfigChoice) and choice.mode == "paper"
        of_one = self.lag is not None or self.fit_noise
        if of_one or is_paper or isinstance(choice, FusionConfig):
            told = "lag, fit_noise and mode paper are for one"
            raise ConfigError(f"{self.recording}: many targets; {told}")
        base = MultiTargetConfig.boats() if found.source == "Autoferry" else MultiTargetConfig()
        if "model" in self.ways and "method" not in self.ways and base.target.method == "imm":
            # Interacting models have models of their own: the one that was asked for would do
            # nothing.
            target = base.target.model_copy(update={"method": "ekf"})
            base = base.model_copy(update={"target": target})
        ways = {
            name if name == "association" else f"target.{name}": value
            for name, value in self.ways.items()
        }
        chosen = config_of_run(_with(choice, ways), MultiTargetConfig, "fusion_many", base=base)
        kept = [found.scans[row] for row in self._kept([one.stamp_ns for one in found.scans])]
        return kept, chosen

    def _within(self, log: MeasurementLog) -> MeasurementLog:
        return log.rows(self._kept([m.stamp_ns for m in log.measurements]))

    def _kept(self, stamps: Sequence[int]) -> list[int]:
        """Rows within the span, of those with these times.

        Raises
        ------
        InputError
            There are none.
        """
        first = min(stamps, default=0)
        rows = [row for row, stamp in enumerate(stamps) if self.span.holds(stamp, first)]
        if stamps and not rows:
            end = (max(stamps) - first) / NS
            raise InputError(
                f"{self.recording}: no measurements {self.span}; they end at {end:g} s"
            )
        return rows

    def _check_read(self, what: str, used: tuple[str, ...]) -> None:
        """Refuse options of reading that would do nothing."""
        for name in self.read:
            if name not in used:
                raise ConfigError(f"{self.recording}: {name} says nothing about {what}")


def _given(**values: Any) -> dict[str, Any]:
    """Values that are not None and not empty."""
    return {name: value for name, value in values.items() if value}


def _with(config: Any, ways: Mapping[str, str]) -> Any:
    """`config` with single values by their dotted names."""
    values = tuple(f'{name}="{value}"' for name, value in ways.items())
    if not isinstance(config, Config):
        choice = config or ConfigChoice()
        return ConfigChoice(choice.mode, choice.file, (*choice.values, *values))
    return config.load(with_assignments(config.model_dump(), values)) if values else config
