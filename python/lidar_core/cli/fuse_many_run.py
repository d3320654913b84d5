"""The run of `lidar-core fuse` on many targets: tracker, summary, tables, picture."""

from collections import Counter
from dataclasses import asdict, dataclass, field
from math import isnan
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from lidar_core.cli.common import draw
from lidar_core.cli.fuse_run import planar_table
from lidar_core.config import Config
from lidar_core.fusion import (
    AutoferryOptions,
    DetectionScan,
    MultiTargetConfig,
    MultiTargetTracker,
    TargetTracks,
    mean_gospa,
    read_autoferry,
    target_coverage,
)
from lidar_core.fusion.states import state_names
from lidar_core.io.tracks import write_trajectories
from lidar_core.run_folder import TRACKS_FOLDER, RunFolder
from lidar_core.viz import FusionView, PlanarLine, draw_fusion

REACH, GAP, CUTOFF = 15.0, 5.0, 30.0
"""Of the score: nearest track, longest detection gap, GOSPA's c [m], [s], [m]."""


@dataclass(frozen=True, slots=True)
class ManyRun:
    """Many targets tracked, and what is told about them.

    Attributes
    ----------
    scans : list of DetectionScan
    config : MultiTargetConfig
    options : AutoferryOptions
    tracks : list of TargetTracks
        Confirmed ones after each scan.
    numbers : list of ndarray
        Track of every measurement of each scan.
    seconds : list of float
        Time that each scan took [s].
    """

    scans: list[DetectionScan]
    config: MultiTargetConfig
    options: AutoferryOptions
    tracks: list[TargetTracks] = field(default_factory=list)
    numbers: list[NDArray[np.int64]] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)

    @classmethod
    def of(cls, path: Path, config: MultiTargetConfig, options: AutoferryOptions) -> "ManyRun":
        """Track the boats of an Autoferry scenario."""
        made = cls(read_autoferry(path, options), config, options)
        tracker = MultiTargetTracker(config)
        for scan in made.scans:
            start = perf_counter()
            numbers = tracker.process(scan.stamp_ns, scan.measurements, source=scan.source)
            made.seconds.append(perf_counter() - start)
            made.numbers.append(numbers)
            made.tracks.append(tracker.tracks_at(scan.stamp_ns))
        return made

    @property
    def configs(self) -> dict[str, Config]:
        """What run.toml keeps."""
        return {"fusion_many": self.config, "fusion_autoferry": self.options}

    @property
    def stamps(self) -> NDArray[np.int64]:
        """Times of the scans [ns]."""
        return np.array([scan.stamp_ns for scan in self.scans], np.int64)

    def summary(self) -> dict[str, Any]:
        """What the run gave, as plain values."""
        stamps, with_truth = self.stamps, [bool(scan.truth) for scan in self.scans]
        pairs = [(scan, state) for scan, state, known in
                 zip(self.scans, self.tracks, with_truth, strict=True) if known]  # fmt: skip
        scans, tracks = [scan for scan, _ in pairs], [state for _, state in pairs]
        coverage = target_coverage(scans, tracks, reach=REACH, gap=GAP)
        return {
            "format": "Autoferry",
            "model": self.config.target.model,
            "method": self.config.target.method,
            "scans": dict(Counter(scan.source for scan in self.scans)),
            "measurements": sum(len(scan.measurements) for scan in self.scans),
            "duration": float(stamps[-1] - stamps[0]) * 1e-9 if len(stamps) else 0.0,
            "states": list(state_names(self.config.target)),
            "tracks": len({number for state in self.tracks for number in state.id.tolist()}),
            "targets": {str(number): _plain(asdict(item)) for number, item in coverage.items()},
            "gospa": mean_gospa(scans, tracks, cutoff=CUTOFF) or None,
            "us_per_scan": 1e6 * sum(self.seconds) / max(1, len(self.scans)),
        }

    def write(self, folder: RunFolder) -> list[str]:
        """Write tables and trajectories; return their names."""
        numbers = np.concatenate([np.empty(0, np.int64), *(state.id for state in self.tracks)])
        stamps = np.repeat(self.stamps, [len(state.id) for state in self.tracks])
        velocity = np.concatenate([np.empty((0, 2)), *(state.velocity for state in self.tracks)])
        states, covariances = self._stacked()
        files = [
            folder.write_table("tracks", planar_table("track_id", stamps, states[:, :2], velocity,
                                                      numbers)),
            folder.write_table("states", {"t_ns": stamps, "track_id": numbers,
                                          **_columns(self.config, states, covariances)}),
            folder.write_table("detections", self._detections()),
        ]  # fmt: skip
        rows = [(scan.stamp_ns, number, place) for scan in self.scans
                for number, place in scan.truth.items()]  # fmt: skip
        if rows:
            place = np.array([row[2] for row in rows])
            table = planar_table("target_id", np.array([row[0] for row in rows], np.int64), place,
                                 place, np.array([row[1] for row in rows], np.int64))  # fmt: skip
            table = {name: column for name, column in table.items() if name[0] != "v"}
            files.append(folder.write_table("truth", table))
        write_trajectories(folder.path / TRACKS_FOLDER, (
            (state.stamp_ns, state.id, np.pad(state.position, ((0, 0), (0, 1))))
            for state in self.tracks
        ))  # fmt: skip
        return [*(file.name for file in files), TRACKS_FOLDER]

    def _stacked(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        size = len(state_names(self.config.target))
        states = [np.empty((0, size)), *(state.states for state in self.tracks)]
        covariances = [np.empty((0, size, size)), *(state.covariances for state in self.tracks)]
        return np.concatenate(states), np.concatenate(covariances)

    def _detections(self) -> dict[str, Any]:
        counts = [len(scan.measurements) for scan in self.scans]
        places = np.array([m.values for scan in self.scans for m in scan.measurements])
        places = places.reshape(-1, 2)
        sources = [scan.source for scan in self.scans]
        return {
            "t_ns": np.repeat(self.stamps, counts),
            "sensor": [name for name, count in zip(sources, counts, strict=True)
                       for _ in range(count)],
            "x": places[:, 0], "y": places[:, 1], "z": np.zeros(len(places)),
            "track_id": np.concatenate([np.empty(0, np.int64), *self.numbers]),
        }  # fmt: skip

    def draw(self, folder: RunFolder, name: str, console: Console) -> list[str]:
        """Draw picture.png; return the names of what was drawn."""
        path = folder.path / "picture.png"
        return draw([(path, lambda: draw_fusion(self.view(name), path))], console)

    def view(self, name: str) -> FusionView:
        """What a picture shows."""
        seen = {source: np.array([m.values for scan in self.scans if scan.source == source
                                  for m in scan.measurements]).reshape(-1, 2)
                for source in sorted({scan.source for scan in self.scans})}  # fmt: skip
        ids = sorted({number for state in self.tracks for number in state.id.tolist()})
        targets = sorted({number for scan in self.scans for number in scan.truth})
        return FusionView(
            title=f"{name}: {len(ids)} tracks",
            seen=seen,
            tracks={number: self._line(number) for number in ids},
            truth={number: self._truth(number) for number in targets},
            nis={},
        )

    def _line(self, number: int) -> PlanarLine:
        rows = [(state, int(np.argmax(state.id == number))) for state in self.tracks
                if number in state.id]  # fmt: skip
        return PlanarLine(
            np.array([state.stamp_ns for state, _ in rows], np.int64),
            np.array([state.position[row] for state, row in rows]),
            np.array([state.covariances[row, :2, :2] for state, row in rows]),
        )

    def _truth(self, number: int) -> PlanarLine:
        rows = [scan for scan in self.scans if number in scan.truth]
        stamps = np.array([scan.stamp_ns for scan in rows], np.int64)
        return PlanarLine(stamps, np.array([scan.truth[number] for scan in rows]))


def _columns(
    config: MultiTargetConfig, states: NDArray[np.float64], covariances: NDArray[np.float64]
) -> dict[str, Any]:
    names = state_names(config.target)
    return {name: states[:, n] for n, name in enumerate(names)} | {
        f"cov_{names[row]}_{names[column]}": covariances[:, row, column]
        for row in range(len(names)) for column in range(row, len(names))
    }  # fmt: skip


def _plain(values: dict[str, Any]) -> dict[str, Any]:
    """The same with None for NaN, which JSON does not have."""
    return {name: None if isinstance(value, float) and isnan(value) else value
            for name, value in values.items()}  # fmt: skip
