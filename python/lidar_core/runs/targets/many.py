"""A run on many targets: tracker, summary, tables, picture."""

from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, field
from math import isnan
from time import perf_counter
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from lidar_core.config import Config
from lidar_core.fusion import (
    DetectionScan,
    MultiTargetConfig,
    MultiTargetTracker,
    ScanResult,
    TableOptions,
    TargetTracks,
    empty_gospa,
    mean_gospa,
    target_coverage,
)
from lidar_core.fusion.measurement import measured_place
from lidar_core.fusion.places import geographic_poses
from lidar_core.fusion.recordings.table import is_of_table
from lidar_core.fusion.states import state_names
from lidar_core.io.tables.covariance import covariance_columns
from lidar_core.io.tables.tracks import KIND_PROBABILITIES, write_trajectories
from lidar_core.messages import TrackKind
from lidar_core.run_folder import TRACKS_FOLDER, RunFolder
from lidar_core.runs.checkpoints import Checkpoints
from lidar_core.runs.result import Picture
from lidar_core.runs.targets.one import (
    TARGET_SENSORS,
    NisBySensor,
    nis_by_sensor,
    nis_ratios,
    nis_summary,
)
from lidar_core.runs.targets.planar import (
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

REACH, GAP, CUTOFF = 15.0, 3.0, 30.0
"""Of the score: furthest track, longest detection gap, GOSPA's c [m], [s], [m]."""


@dataclass(frozen=True, slots=True)
class ManyRun:
    """Run of a tracker of many targets, with its results.

    Attributes
    ----------
    scans : list of DetectionScan
    config : MultiTargetConfig
    reading : mapping of str to Config
        Options that they were read with, for run.toml.
    format : str
        Format of the recording.
    tracks : list of TargetTracks
        Confirmed ones after each scan.
    results : list of ScanResult
        Assignment of the measurements of each scan.
    seconds : list of float
        Time that each scan took [s].
    tracker : list of MultiTargetTracker
        The tracker; a run that continues replaces it.
    unused : str or None
        Columns of a table that give no detection, as text.
    """

    scans: list[DetectionScan]
    config: MultiTargetConfig
    reading: Mapping[str, Config]
    format: str
    KINDS: ClassVar[tuple[type, ...]] = (TargetTracks, ScanResult)
    """Classes of what a checkpoint keeps of a scan."""
    tracks: list[TargetTracks] = field(default_factory=list)
    results: list[ScanResult] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)
    tracker: list[MultiTargetTracker] = field(default_factory=list)
    unused: str | None = None

    @classmethod
    def of(
        cls,
        scans: list[DetectionScan],
        config: MultiTargetConfig,
        reading: Mapping[str, Config],
        *,
        source: str,
        unused: str | None,
        checkpoints: Checkpoints,
        begin: Callable[[], None],
    ) -> "ManyRun":
        """Track targets in scans; `source` is the kind of recording, `unused` its unread columns.

        Calls `begin` before the first checkpoint is written.
        """
        made = cls(scans, config, reading, source, unused=unused)
        made.tracker.append(MultiTargetTracker(config))
        done = checkpoints.resume(made)
        begin()
        for number, scan in enumerate(made.scans[done:], done + 1):
            (tracker,) = made.tracker
            start = perf_counter()
            result = tracker.process(scan.stamp_ns, scan.measurements, source=scan.source)
            made.seconds.append(perf_counter() - start)
            made.results.append(result)
            made.tracks.append(tracker.tracks_at(scan.stamp_ns))
            checkpoints.take(made, number)
        return made

    def checkpoint_state(self) -> dict[str, Any]:
        """Return the state without the rows, for a checkpoint."""
        (tracker,) = self.tracker
        return {"tracker": tracker.to_bytes()}

    def rows(self, since: int) -> list[Any]:
        """Return the permanent rows of the scans since then."""
        kept = (self.tracks, self.results, self.seconds)
        return [list(row) for row in zip(*(one[since:] for one in kept), strict=True)]

    def restore(self, kept: Mapping[str, Any], rows: list[Any]) -> None:
        """Take over the state of a run that was killed."""
        self.tracker[:] = [MultiTargetTracker.from_bytes(kept["tracker"])]
        for tracks, result, seconds in rows:
            self.tracks.append(tracks)
            self.results.append(result)
            self.seconds.append(seconds)

    @property
    def doubts(self) -> list[str]:
        """Return warnings about poses of the platform, times and columns, which may be right."""
        found = [
            geographic_poses([m for scan in self.scans for m in scan.measurements]),
            self._doubtful_times() if is_of_table(self.format) else None,
            self.unused,
        ]
        return [text for text in found if text]

    def _doubtful_times(self) -> str | None:
        seen: dict[str, list[int]] = {}
        for scan in self.scans:
            if scan.source in TARGET_SENSORS:
                seen.setdefault(scan.source, []).extend([scan.stamp_ns] * len(scan.measurements))
        known = {source: np.array(stamps, np.int64) for source, stamps in seen.items()}
        options = self.reading.get("fusion_table")
        told = options.time_unit if isinstance(options, TableOptions) else "ns"
        return doubtful_times(known, of_many=True, time_unit=told)

    @property
    def configs(self) -> dict[str, Config]:
        """Return the configurations for run.toml."""
        return {"fusion_many": self.config, **self.reading}

    @property
    def stamps(self) -> NDArray[np.int64]:
        """Times of the scans [ns]."""
        return np.array([scan.stamp_ns for scan in self.scans], np.int64)

    def nis(self) -> NisBySensor:
        """Return the NIS of all assigned measurements, by scanner."""
        counts = [len(scan.measurements) for scan in self.scans]
        return nis_by_sensor(
            np.repeat(np.array([scan.source for scan in self.scans], np.str_), counts),
            np.repeat(self.stamps, counts),
            np.concatenate([np.empty((0, 3)), *(result.innovations for result in self.results)]),
            np.concatenate([np.empty(0), *(result.nis for result in self.results)]),
        )

    def summary(self) -> dict[str, Any]:
        """Return the results of the run as plain values."""
        stamps, with_truth = self.stamps, [bool(scan.truth) for scan in self.scans]
        pairs = [
            (scan, state)
            for scan, state, known in zip(self.scans, self.tracks, with_truth, strict=True)
            if known
        ]
        scans, tracks = [scan for scan, _ in pairs], [state for _, state in pairs]
        coverage = target_coverage(scans, tracks, reach=REACH, gap=GAP)
        return {
            "format": self.format,
            "model": self.config.target.model,
            "method": self.config.target.method,
            "scans": dict(Counter(scan.source for scan in self.scans)),
            "measurements": sum(len(places) for places in self._places),
            "duration": float(stamps[-1] - stamps[0]) * 1e-9 if len(stamps) else 0.0,
            "association": self.config.association,
            "states": list(state_names(self.config.target)),
            "nis": nis_summary(self.nis()),
            "tracks": len({number for state in self.tracks for number in state.id.tolist()}),
            "kinds": self._last_kinds(),
            "targets": {str(number): _plain(asdict(item)) for number, item in coverage.items()},
            "gospa": mean_gospa(scans, tracks, cutoff=CUTOFF) or None,
            "gospa_empty": empty_gospa(scans, cutoff=CUTOFF) or None,
            "us_per_scan": 1e6 * sum(self.seconds) / max(1, len(self.scans)),
        }

    def write(self, folder: RunFolder) -> list[str]:
        """Write tables and trajectories; return their names."""
        numbers = np.concatenate([np.empty(0, np.int64), *(state.id for state in self.tracks)])
        counts = [len(state.id) for state in self.tracks]
        stamps, sensors = np.repeat(self.stamps, counts), np.repeat(self._sensors, counts, axis=0)
        velocity = np.concatenate([np.empty((0, 2)), *(state.velocity for state in self.tracks)])
        states, covariances = self._stacked()
        names = state_names(self.config.target)
        table = planar_table("track_id", stamps, states[:, :2], velocity, numbers)
        existence = [np.empty(0), *(state.existence for state in self.tracks)]
        table |= {"existence": np.concatenate(existence), **self._kinds()}
        files = [
            folder.write_table("tracks", table | covariance_columns("xy", covariances)),
            folder.write_table(
                "states",
                {
                    "t_ns": stamps,
                    "track_id": numbers,
                    **{name: states[:, n] for n, name in enumerate(names)},
                    **covariance_columns(names, covariances),
                    "sensor_x": sensors[:, 0],
                    "sensor_y": sensors[:, 1],
                },
            ),
            folder.write_table("detections", self._detections()),
        ]
        truth = self._truth_table()
        if truth:
            files.append(folder.write_table("truth", truth))
        write_trajectories(
            folder.path / TRACKS_FOLDER,
            ((state.stamp_ns, state.id, in_plane(state.position)) for state in self.tracks),
        )
        return [*(file.name for file in files), TRACKS_FOLDER]

    def _truth_table(self) -> dict[str, Any]:
        """Table of the true positions; empty without ground truth."""
        rows = [
            (scan.stamp_ns, number, place)
            for scan in self.scans
            for number, place in scan.truth.items()
        ]
        if not rows:
            return {}
        stamps, numbers, places = zip(*rows, strict=True)
        return planar_truth(
            np.array(stamps, np.int64), np.array(places), numbers=np.array(numbers, np.int64)
        )

    def _last_kinds(self) -> dict[str, int]:
        """Number of tracks of each kind, as they were reported last."""
        last = {
            number: kind
            for state in self.tracks
            for number, kind in zip(state.id.tolist(), state.kind.tolist(), strict=True)
        }
        counts = Counter(last.values())
        return {kind.name.lower(): counts[kind] for kind in TrackKind if counts[kind]}

    def _kinds(self) -> dict[str, Any]:
        """Columns of the kinds of the tracks, one row per track and scan."""
        kinds = [kind for state in self.tracks for kind in state.kind.tolist()]
        likely = [np.empty((0, len(TrackKind))), *(state.kind_probability for state in self.tracks)]
        columns = zip(KIND_PROBABILITIES, np.concatenate(likely).T, strict=True)
        return {"kind": [TrackKind(kind).name.lower() for kind in kinds], **dict(columns)}

    def _stacked(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        size = len(state_names(self.config.target))
        states = [np.empty((0, size)), *(state.states for state in self.tracks)]
        covariances = [np.empty((0, size, size)), *(state.covariances for state in self.tracks)]
        return np.concatenate(states), np.concatenate(covariances)

    def _detections(self) -> dict[str, Any]:
        """Table of the detections of targets in the world [m]."""
        is_target = np.array(
            [m.sensor in TARGET_SENSORS for scan in self.scans for m in scan.measurements], np.bool_
        )
        counts = [len(places) for places in self._places]
        places = np.concatenate([np.empty((0, 2)), *self._in_world()])
        numbers = [np.empty(0, np.int64), *(result.id for result in self.results)]
        nis = [np.empty(0), *(result.nis for result in self.results)]
        return {
            "t_ns": np.repeat(self.stamps, counts),
            "sensor": [
                scan.source
                for scan, count in zip(self.scans, counts, strict=True)
                for _ in range(count)
            ],
            "x": places[:, 0],
            "y": places[:, 1],
            "z": np.zeros(len(places)),
            "track_id": np.concatenate(numbers)[is_target],
            "nis": np.concatenate(nis)[is_target],
        }

    @property
    def _places(self) -> list[NDArray[np.float64]]:
        """Positions (M, 2) that each scan measured, relative to its sensor [m]."""
        return [
            np.array(
                [measured_place(m) for m in scan.measurements if m.sensor in TARGET_SENSORS]
            ).reshape(-1, 2)
            - scan.sensor
            for scan in self.scans
        ]

    @property
    def _sensors(self) -> NDArray[np.float64]:
        """Pose x, y [m], yaw [rad] (K, 3) of the sensor in the world at each scan."""
        told = [m for scan in self.scans for m in scan.measurements]
        poses = sensor_at(told, self.stamps, self.config.target.lever_arm)
        poses[:, :2] += np.array([scan.sensor for scan in self.scans]).reshape(-1, 2)
        return poses

    def _in_world(self) -> list[NDArray[np.float64]]:
        return [in_world(*pair) for pair in zip(self._places, self._sensors, strict=True)]

    def write_mcap(self, folder: RunFolder) -> str:
        """Write run.mcap; return its name."""
        return write_run_mcap(folder, self._steps())

    def _steps(self) -> Iterator[PlanarStep]:
        rows = zip(self._places, self._sensors, self.tracks, strict=True)
        for places, sensor, state in rows:
            yield PlanarStep(
                state.stamp_ns, places, sensor, state.id, state.position, state.velocity
            )

    def pictures(self, folder: RunFolder, name: str) -> list[Picture]:
        """Return the picture of a run on the recording `name`."""
        path = folder.path / "picture.png"
        return [(path, lambda _: draw_fusion(self.view(name), path))]

    def view(self, name: str) -> FusionView:
        """Return the content of a picture."""
        places = zip(self.scans, self._in_world(), strict=True)
        found: dict[str, list[NDArray[np.float64]]] = {}
        for scan, at in places:
            found.setdefault(scan.source, []).append(at[np.isfinite(at).all(axis=1)])
        seen = {source: np.concatenate(found[source]) for source in sorted(found)}
        ids = sorted({number for state in self.tracks for number in state.id.tolist()})
        targets = sorted({number for scan in self.scans for number in scan.truth})
        way = self._sensors[:, :2]
        return FusionView(
            title=f"{name}: {len(ids)} tracks",
            seen=seen,
            tracks={number: self._line(number) for number in ids},
            truth={number: self._truth(number) for number in targets},
            nis=nis_ratios(self.nis()),
            sensor=way if (way != way[:1]).any() else way[:0],
        )

    def _line(self, number: int) -> PlanarLine:
        rows = [
            (state, int(np.argmax(state.id == number)))
            for state in self.tracks
            if number in state.id
        ]
        return PlanarLine(
            np.array([state.stamp_ns for state, _ in rows], np.int64),
            np.array([state.position[row] for state, row in rows]),
            np.array([state.covariances[row, :2, :2] for state, row in rows]),
        )

    def _truth(self, number: int) -> PlanarLine:
        rows = [scan for scan in self.scans if number in scan.truth]
        stamps = np.array([scan.stamp_ns for scan in rows], np.int64)
        return PlanarLine(stamps, np.array([scan.truth[number] for scan in rows]))


def _plain(values: dict[str, Any]) -> dict[str, Any]:
    """Return the values with None for NaN, which JSON does not have."""
    return {
        name: None if isinstance(value, float) and isnan(value) else value
        for name, value in values.items()
    }
