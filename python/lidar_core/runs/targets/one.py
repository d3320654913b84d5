"""A run on one target: filter, summary, tables, picture."""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from time import perf_counter
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from lidar_core.config import Config
from lidar_core.errors import InputError, NumericalError
from lidar_core.estimation import chi2_quantile
from lidar_core.evaluation import nees
from lidar_core.fusion import (
    FusionConfig,
    Measurement,
    MeasurementLog,
    Run,
    run,
    smooth,
)
from lidar_core.fusion.measurement import measured_place, measured_values
from lidar_core.fusion.places import geographic_poses
from lidar_core.fusion.recordings.table import is_of_table
from lidar_core.fusion.states import dimensions, state_names, told_stds, velocities
from lidar_core.fusion.unusable import reasons
from lidar_core.io.tables.covariance import covariance_columns
from lidar_core.io.tables.tracks import write_trajectories
from lidar_core.run_folder import TRACKS_FOLDER, RunFolder
from lidar_core.runs.result import Picture
from lidar_core.runs.targets.planar import (
    YAWS,
    PlanarStep,
    in_plane,
    in_world,
    planar_table,
    planar_truth,
    sensor_at,
    write_run_mcap,
)
from lidar_core.runs.targets.times import doubtful_times
from lidar_core.viz import FusionView, PlanarLine, draw_fusion

LIMIT = 0.95
"""Share of the NIS of a consistent filter that is below its limit."""
TARGET_SENSORS = ("lidar", "radar")
COORDINATES = ("x", "y", "vx", "vy")


@dataclass(frozen=True, slots=True)
class TargetRun:
    """Run of a filter of one target, with its results.

    Attributes
    ----------
    log : MeasurementLog
        Sorted by time, the truth along with it.
    result : Run
        Row for row as the log.
    config : FusionConfig
    reading : mapping of str to Config
        Options that it was read with, for run.toml.
    lag : float or None
        Lag of the smoother [s].
    seconds : float
        Time that the filter took [s].
    implausible : str or None
        Implausible properties of the measurements, in a run that was forced to continue.
    """

    log: MeasurementLog
    result: Run
    config: FusionConfig
    reading: Mapping[str, Config]
    lag: float | None
    seconds: float
    implausible: str | None = None

    @classmethod
    def of(
        cls,
        log: MeasurementLog,
        config: FusionConfig,
        reading: Mapping[str, Config],
        *,
        lag: float | None,
    ) -> "TargetRun":
        """Filter a log, or smooth it with a lag [s]."""
        ordered = _in_order(log)
        start = perf_counter()
        if lag is None:
            result = run(ordered.measurements, config)
        else:
            result = smooth(ordered.measurements, config, lag=lag)
        return cls(ordered, result, config, reading, lag, perf_counter() - start)

    @property
    def doubts(self) -> list[str]:
        """Return warnings about suspicious measurements, which may be right."""
        found = [
            self.implausible or geographic_poses(self.log.measurements),
            self.doubtful_times,
            self.log.unused,
        ]
        return [text for text in found if text]

    @property
    def doubtful_times(self) -> str | None:
        """Return what is wrong with the times of a table."""
        sensors, stamps = self.sensors, self.stamps
        seen = {one: stamps[sensors == one] for one in TARGET_SENSORS if one in sensors}
        told = self.log.options.time_unit
        return doubtful_times(seen, time_unit=told) if is_of_table(self.log.format) else None

    @property
    def configs(self) -> dict[str, Config]:
        """Return the configurations for run.toml."""
        return {"fusion": self.config, **self.reading}

    @property
    def sensors(self) -> NDArray[np.str_]:
        """Sensor of every measurement."""
        return np.array([m.sensor for m in self.log.measurements], np.str_)

    @property
    def stamps(self) -> NDArray[np.int64]:
        """Times of the measurements [ns]."""
        return np.array([m.stamp_ns for m in self.log.measurements], np.int64)

    @property
    def seen(self) -> NDArray[np.bool_]:
        """Return which measurements (K,) have a state: those since the target was first seen."""
        states = self.result.states
        known = states.shape[1] > 0
        return np.array([known and bool(row.all()) for row in np.isfinite(states)], np.bool_)

    @property
    def states(self) -> NDArray[np.float64]:
        """States of the measurements that have one (see `seen`)."""
        rows = self.seen
        width = len(state_names(self.config))
        return self.result.states[rows] if rows.any() else np.empty((0, width))

    @property
    def errors(self) -> NDArray[np.float64] | None:
        """Estimate minus truth, (K, 4) of x, y, vx, vy, rows with a state; None without truth.

        NaN for velocities that are not known.
        """
        truth, rows = self.log.truth, self.seen
        if truth is None:
            return None
        states = self.states
        return np.hstack(
            [
                states[:, :2] - truth.position[rows],
                velocities(states, self.config)[:, :2] - truth.velocity[rows],
            ]
        )

    def nis(self) -> "NisBySensor":
        """Return the NIS by sensor, as `nis_by_sensor`."""
        result = self.result
        return nis_by_sensor(self.sensors, result.stamps_ns, result.innovations, result.nis)

    def summary(self) -> dict[str, Any]:
        """Return the results of the run as plain values."""
        sensors, stamps = self.sensors, self.result.stamps_ns
        duration = float(stamps[-1] - stamps[0]) * 1e-9 if len(stamps) else 0.0
        errors = self.errors
        return {
            "format": self.log.format,
            "model": self.config.model,
            "method": self.config.method,
            "lag": self.lag,
            "measurements": dict(Counter(sensors.tolist())),
            "measured": measured_values(self.log.measurements),
            "outcomes": dict(Counter(self.result.outcomes.tolist())),
            "invalid": reasons(self.log.measurements, self.result.outcomes, self.config),
            "duration": duration,
            "states": list(state_names(self.config)),
            "nis": nis_summary(self.nis()),
            "sensor_noise": self._sensor_noise(),
            "rmse": None if errors is None else self._rmse(errors),
            **({} if self.log.origin is None else {"origin": list(self.log.origin)}),
            "us_per_measurement": 1e6 * self.seconds / max(1, len(stamps)),
        }

    def _sensor_noise(self) -> dict[str, list[float]]:
        """Standard deviations as configured and as estimated, SI units."""
        return {
            "lidar_std": told_stds(self.config)[0].tolist(),
            "lidar_std_estimated": self.result.lidar_std_estimated.tolist(),
            "radar_std": told_stds(self.config)[1].tolist(),
            "radar_std_estimated": self.result.radar_std_estimated.tolist(),
        }

    def _rmse(self, errors: NDArray[np.float64]) -> dict[str, float | None] | None:
        if not len(errors):
            return None
        rmse = np.sqrt((errors**2).mean(axis=0))
        position = self.result.covariances[self.seen][:, :2, :2]
        try:
            consistency = float(nees(errors[:, :2], position).mean())
        except (InputError, NumericalError):  # the published filter's are no covariances
            consistency = None
        return {
            **{
                name: value if np.isfinite(value) else None
                for name, value in zip(COORDINATES, rmse.tolist(), strict=True)
            },
            "position_2d": float(np.hypot(*rmse[:2])),
            "position_nees": consistency,
        }

    def states_table(self) -> dict[str, Any]:
        """A row per measurement: state, covariance, innovation, NIS, truth; SI units."""
        result, names = self.result, state_names(self.config)
        table: dict[str, Any] = {
            "t_ns": result.stamps_ns,
            "sensor": self.sensors.tolist(),
            "outcome": result.outcomes.tolist(),
        }
        if result.states.shape[1]:
            table |= {name: result.states[:, n] for n, name in enumerate(names)}
            table |= covariance_columns(names, result.covariances)
        width = result.innovations.shape[1]
        table |= {f"innovation_{n + 1}": result.innovations[:, n] for n in range(width)}
        table["nis"] = result.nis
        truth = self.log.truth
        if truth is not None:
            values = np.hstack([truth.position, truth.velocity])
            table |= {
                f"true_{name}": column
                for name, column in zip(COORDINATES, values.T, strict=True)
                if np.isfinite(column).all()
            }
        return table

    @property
    def last(self) -> NDArray[np.bool_]:
        """Return which measurements (K,) are the last ones of their time."""
        return np.append(np.diff(self.stamps) > 0, True)

    def write(self, folder: RunFolder) -> list[str]:
        """Write tables and trajectory; return their names."""
        last, stamps = self.last, self.stamps
        chosen, rows = last[self.seen], last & self.seen
        size = dimensions(self.config)
        place, speed = self.states[chosen, :size], velocities(self.states[chosen], self.config)
        table = planar_table("track_id", stamps[rows], place, speed)
        if rows.any():
            table |= covariance_columns("xyz"[:size], self.result.covariances[rows])
        files = [
            folder.write_table("states", self.states_table()),
            folder.write_table("tracks", table),
        ]
        truth = self.log.truth
        if truth is not None:
            files.append(
                folder.write_table(
                    "truth",
                    planar_truth(stamps[last], truth.position[last], truth.velocity[last]),
                )
            )
        steps = zip(stamps[rows].tolist(), place, strict=True)
        write_trajectories(
            folder.path / TRACKS_FOLDER,
            ((stamp, np.zeros(1, np.int64), in_plane(at[None])) for stamp, at in steps),
        )
        return [*(file.name for file in files), TRACKS_FOLDER]

    def write_mcap(self, folder: RunFolder) -> str:
        """Write run.mcap; return its name."""
        return write_run_mcap(folder, self._steps())

    def _steps(self) -> Iterator[PlanarStep]:
        """Yield for every time the positions measured then and the last state of that time."""
        known, ends = self.seen, np.flatnonzero(self.last)
        place, speed = np.zeros((len(known), 2)), np.zeros((len(known), 2))
        place[known] = self.states[:, :2]
        speed[known] = velocities(self.states, self.config)[:, :2]
        sensors = sensor_at(self.log.measurements, self.stamps[ends], self.config.lever_arm)
        first = 0
        for end, sensor in zip(ends.tolist(), sensors, strict=True):
            places = measured_places(self.log.measurements[first : end + 1]).values()
            tracks = np.flatnonzero(known[end : end + 1])
            yield PlanarStep(
                int(self.stamps[end]),
                np.concatenate([np.empty((0, 2)), *places]),
                sensor,
                tracks,
                place[end + tracks],
                speed[end + tracks],
            )
            first = end + 1

    def pictures(self, folder: RunFolder, name: str) -> list[Picture]:
        """Return the picture of a run on the recording `name`."""
        path = folder.path / "picture.png"
        return [(path, lambda _: draw_fusion(self.view(name), path))]

    def view(self, name: str) -> FusionView:
        """Return the content of a picture."""
        rows, truth, result = self.seen, self.log.truth, self.result
        stamps = result.stamps_ns
        line = PlanarLine(stamps[rows], self.states[:, :2], result.covariances[rows][:, :2, :2])
        moving = {m.sensor for m in self.log.measurements} & YAWS.keys()
        return FusionView(
            title=f"{name}: {self.config.model}, {self.config.method}{self._restarts()}",
            seen=self._seen_in_world(),
            tracks={0: line} if rows.any() else {},
            truth={} if truth is None else {0: PlanarLine(stamps, truth.position)},
            nis=nis_ratios(self.nis()),
            sensor=self._sensor_poses()[self.last, :2] if moving else np.empty((0, 2)),
        )

    def _restarts(self) -> str:
        """Text for a title: how often the filter had lost the target."""
        count = int((self.result.outcomes == "restarted").sum())
        return f", {count} restart{'s' * (count > 1)}" if count else ""

    def _sensor_poses(self) -> NDArray[np.float64]:
        """Pose x, y [m], yaw [rad] (K, 3) of the sensor at every measurement."""
        return sensor_at(self.log.measurements, self.stamps, self.config.lever_arm)

    def _seen_in_world(self) -> dict[str, NDArray[np.float64]]:
        """Measured positions (M, 2) in the world by sensor [m], by the pose at their time."""
        found: dict[str, list[NDArray[np.float64]]] = {}
        for m, pose in zip(self.log.measurements, self._sensor_poses(), strict=True):
            for sensor, places in measured_places([m]).items():
                found.setdefault(sensor, []).append(in_world(places, pose))
        return {sensor: np.concatenate(places) for sensor, places in found.items()}


NisBySensor: TypeAlias = dict[
    str, tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]
]
"""Times [ns], NIS, and the limit that `LIMIT` of them are below."""


def nis_by_sensor(
    sensors: NDArray[np.str_],
    stamps: NDArray[np.int64],
    innovations: NDArray[np.float64],
    nis: NDArray[np.float64],
) -> NisBySensor:
    """Return the NIS by sensor, of the measurements that were compared with a prediction."""
    degrees = np.isfinite(innovations).sum(axis=1)
    limit = np.array([np.inf, *(chi2_quantile(LIMIT, degrees=n) for n in (1, 2, 3, 4))])[degrees]
    compared = np.isfinite(nis) & (degrees > 0)
    found = {}
    for sensor in sorted(set(sensors[compared].tolist())):
        rows = compared & (sensors == sensor)
        found[sensor] = (stamps[rows], nis[rows], limit[rows])
    return found


def nis_summary(found: NisBySensor) -> dict[str, dict[str, float]]:
    """Mean NIS and share below the limit, by sensor."""
    return {
        sensor: {
            "mean": float(values.mean()),
            "share_below_limit": float((values <= limit).mean()),
        }
        for sensor, (_, values, limit) in found.items()
    }


def nis_ratios(found: NisBySensor) -> dict[str, tuple[NDArray[np.int64], NDArray[np.float64]]]:
    """Times [ns] and NIS divided by its limit, by sensor, as pictures show them."""
    return {sensor: (times, values / limit) for sensor, (times, values, limit) in found.items()}


def measured_places(measurements: Iterable[Measurement]) -> Mapping[str, NDArray[np.float64]]:
    """Positions (M, 2) of LiDAR and radar in the frame of the sensor, where they are finite."""
    found: dict[str, list[list[float]]] = {}
    for m in measurements:
        if m.sensor in TARGET_SENSORS:
            place = measured_place(m)
            if np.isfinite(place).all():
                found.setdefault(m.sensor, []).append(place)
    return {sensor: np.array(places) for sensor, places in found.items()}


def _in_order(log: MeasurementLog) -> MeasurementLog:
    """Return the log sorted by time, as for the filter; rows of one time keep their order."""
    stamps = [m.stamp_ns for m in log.measurements]
    return log.rows(np.argsort(stamps, kind="stable").tolist())
