"""A recording of LiDAR and radar, and the way its targets are tracked: one target, or many."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from lidar_core.config import Config
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
from lidar_core.fusion.unusable import lacks_heights
from lidar_core.io import Span
from lidar_core.io.options import NS
from lidar_core.runs.checkpoints import Checkpoints
from lidar_core.runs.settings import ConfigChoice, config_of_run, with_assignments
from lidar_core.runs.targets.many import ManyRun
from lidar_core.runs.targets.noise import fitted, names_told
from lidar_core.runs.targets.one import TARGET_SENSORS, TargetRun
from lidar_core.runs.targets.times import wrong_unit

BAGS = (".bag", ".db3", ".mcap")


@dataclass(frozen=True, slots=True)
class FuseJob:
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
        """Read the recording. Filter one target, or track many.

        For many, call `begin` before the first checkpoint is written.
        """
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
            unused=found.unused,
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
            raise ConfigError(
                f"{self.recording}: holds many targets; noise can be fitted only to one target"
            )
        return self._within(found)

    def _found(self) -> tuple[MeasurementLog | TargetScans, Mapping[str, Config]]:
        """Read the recording; return its measurements and the options with which it was read."""
        recording = self.recording
        reader = list_reader(recording)
        if reader is not None:
            self._check_read(f"{reader[0]} recordings", ())
            return TargetScans(reader[1](recording), reader[0]), {}
        if recording.is_dir() or recording.suffix.lower() in BAGS:
            self._check_read("a ROS recording", ("topics",))
            return self._bag()
        of_tables = ("columns", "time_unit", "angle_unit", "azimuth", "clock", "scale")
        tabular = is_table(recording)
        self._check_read(*(("a table", of_tables) if tabular else ("L/R text", ())))
        options = TableOptions.load(dict(self.read))
        log, reading = read_measurements(recording, options), {"fusion_table": options}
        if tabular and not self.force:
            self._check_times(log)
        if tabular and self._of_many:
            return TargetScans(scans_of(log), log.format, log.unused), reading
        return log, reading

    def _check_times(self, log: MeasurementLog) -> None:
        """Refuse times of a table that cannot be in the stated unit."""
        stamps = {
            sensor: np.array([m.stamp_ns for m in log.measurements if m.sensor == sensor])
            for sensor in TARGET_SENSORS
        }
        known = {sensor: own for sensor, own in stamps.items() if len(own)}
        if wrong := wrong_unit(known, log.options.time_unit):
            raise InputError(f"{self.recording}: {wrong}. force=True continues anyway")

    @property
    def _of_many(self) -> bool:
        """Whether the options or the configuration ask for many targets."""
        return "association" in self.ways or isinstance(self.config, MultiTargetConfig)

    def _bag(self) -> tuple[MeasurementLog | TargetScans, Mapping[str, Config]]:
        """Read a ROS recording: one target, or many if a message or the options require it."""
        options = BagOptions.load(dict(self.read))
        scans, reading = read_bag(self.recording, options), {"fusion_bag": options}
        if self._of_many or any(len(scan.measurements) > 1 for scan in scans):
            return TargetScans(scans, "ROS"), reading
        measurements = [m for scan in scans for m in scan.measurements]
        return MeasurementLog(measurements, None, "ROS"), reading

    def _one(self, log: MeasurementLog, reading: Mapping[str, Config]) -> TargetRun:
        if self._of_many:
            raise ConfigError(
                f"{self.recording}: holds one target; association applies only to many targets"
            )
        chosen = config_of_run(with_ways(self.config, self.ways), FusionConfig, "fusion")
        kept = self._within(log)
        if chosen.model == "ctrv-drone" and any(m.sensor == "pose" for m in kept.measurements):
            raise ConfigError(
                f"{self.recording}: model ctrv-drone does not use poses of the platform, which"
                " this recording holds; use model ctrv"
            )
        if flat := lacks_heights(kept.measurements, chosen):
            raise InputError(f"{self.recording}: {flat}")
        if self.fit_noise:
            told = names_told(self.config, self.ways)
            chosen = fitted([(self.recording, kept)], chosen, told=told, force=self.force)
        made = TargetRun.of(kept, chosen, {**reading, "span": self.span}, lag=self.lag)
        doubt = implausible(made.log.measurements, chosen, log.options)
        if doubt is not None and not self.force:
            found = [made.doubtful_times, str(doubt)]
            text = "; ".join(one for one in found if one)
            raise InputError(f"{self.recording}: {text}. force=True continues anyway")
        return made if doubt is None else replace(made, implausible=str(doubt))

    def _many(self, found: TargetScans) -> tuple[list[DetectionScan], MultiTargetConfig]:
        """Return the scans within the span, and the configuration of the tracker."""
        choice = self.config
        is_paper = isinstance(choice, ConfigChoice) and choice.mode == "paper"
        of_one = self.lag is not None or self.fit_noise
        if of_one or is_paper or isinstance(choice, FusionConfig):
            told = "lag, fit_noise and mode paper apply only to one target"
            raise ConfigError(f"{self.recording}: holds many targets; {told}")
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
        chosen = config_of_run(with_ways(choice, ways), MultiTargetConfig, "fusion_many", base=base)
        kept = [
            found.scans[row] for row in self._rows_in_span([one.stamp_ns for one in found.scans])
        ]
        return kept, chosen

    def _within(self, log: MeasurementLog) -> MeasurementLog:
        return log.rows(self._rows_in_span([m.stamp_ns for m in log.measurements]))

    def _rows_in_span(self, stamps: Sequence[int]) -> list[int]:
        """Return the rows whose times `stamps` [ns] lie within the span.

        Raises
        ------
        InputError
            No time lies within the span.
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
        """Refuse read options that have no effect on this kind of recording."""
        for name in self.read:
            if name not in used:
                raise ConfigError(f"{self.recording}: {name} does not apply to {what}")


def with_ways(config: Any, ways: Mapping[str, str]) -> Any:
    """Return `config` with single values set by their dotted names."""
    values = tuple(f'{name}="{value}"' for name, value in ways.items())
    if not isinstance(config, Config):
        choice = config or ConfigChoice()
        return ConfigChoice(choice.mode, choice.file, (*choice.values, *values))
    return config.load(with_assignments(config.model_dump(), values)) if values else config
