"""Flying objects in a recording: the run, its tables, trajectories, map and picture."""

from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import replace
from os import PathLike
from pathlib import Path
from time import perf_counter
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from lidar_core.config import checked
from lidar_core.evaluation import Latency
from lidar_core.flying import (
    FlyingConfig,
    FlyingDetections,
    FlyingFrame,
    FlyingObjectDetector,
    FlyingStatus,
    Tracks,
)
from lidar_core.io import (
    McapWriter,
    PosedScan,
    PoseOptions,
    ReadOptions,
    read_cloud,
    write_tracks_table,
    write_tum,
)
from lidar_core.io.tables.covariance import covariance_columns
from lidar_core.messages import PointClass, Scan
from lidar_core.run_folder import TRACKS_FOLDER, RunFolder
from lidar_core.runs.recording import RecordingJob, folder_to_write, no_progress
from lidar_core.runs.result import MCAP, OnProgress, Picture, RunResult
from lidar_core.runs.scan_times import ScanTimes
from lidar_core.runs.settings import ConfigChoice, config_of_run
from lidar_core.runs.static_map import check_static_map, write_static_map
from lidar_core.viz import FlyingView, draw_flying
from lidar_core.viz.scan_log import log_flying

CLASSES = (PointClass.BACKGROUND, PointClass.FLYING, PointClass.UNKNOWN, PointClass.MOVING)
"""Classes of points with information that the detector gives."""


@checked
def detect(
    recording: str | PathLike[str],
    config: FlyingConfig | ConfigChoice | None,
    output: str | PathLike[str],
    *,
    pose: PoseOptions | None = None,
    read: ReadOptions | None = None,
    clouds: Sequence[str] = (),
    repeat: Annotated[int, Field(ge=1)] = 1,
    known_map: str | PathLike[str] | None = None,
    static_map: str | PathLike[str] | None = None,
    threads: int = 1,
    mcap: bool | None = None,
    picture: bool = True,
    overwrite: bool = False,
    checkpoint: Annotated[float, Field(gt=0)] | None = None,
    resume: bool = False,
    on_progress: OnProgress = no_progress,
) -> RunResult:
    """Find and track flying objects in a recording, as `lidar-core detect` does.

    Parameters
    ----------
    recording : str or Path
        File or folder of any format that `lidar_core.io.open_recording` reads.
    config : FlyingConfig, ConfigChoice or None
        Configuration of the detector; None is best mode. Scans that cannot be used are counted,
        unless it sets `on_bad_scan`.
    output : str or Path
        Folder to write: tables of tracks and detections in SI units in the world frame,
        trajectories, the map, summary.json, run.toml, run.mcap, picture.png.
    pose : PoseOptions, optional
        Where the poses come from, and the part of the recording to use [s].
    read : ReadOptions, optional
        How the recording is read.
    clouds : sequence of str
        Topics of the LiDARs; empty for the only one.
    repeat : int
        How often the recording is played: opens the burn-in gate on short recordings.
    known_map : str or Path, optional
        Map of an earlier run (.lcvm), or a cloud or mesh in the fixed frame [m].
    static_map : str or Path, optional
        File to write: the map without all that moved, as voxels of 0.1 m (.lcvm) or as points in
        the world frame (.pcd, .ply) [m]. An earlier file is replaced. Scans take longer.
    threads : int
        Threads used, >= 1; results do not depend on it.
    mcap : bool, optional
        Whether to write run.mcap for viewers; None: if the extra `viz` is installed.
    picture : bool
        Whether to draw picture.png (extra `plot`).
    overwrite : bool
        Whether to replace an earlier run in the folder.
    checkpoint : float, optional
        Write what it takes to go on into the folder, this often [s]; then there is no run.mcap.
    resume : bool
        Go on from the last checkpoint of a run with the same inputs that was killed or ended
        early; the results are those of a run that was not. Without a checkpoint it starts again.
    on_progress : callable
        Is called with what is done, how many scans of it, and of how many or None.

    Returns
    -------
    RunResult
        Ctrl-C and errors after the first scan end the run early: the folder then holds the scans
        so far, and `ended_by` says what ended it; `raise_if_failed` raises that.

    Raises
    ------
    ConfigError
        A value or topic that cannot be used, or a `static_map` that cannot be written.
    FormatError
        The recording cannot be read, or has no poses; no folder is left. Or a checkpoint is
        damaged.
    InputError
        The checkpoint is one of another recording, configuration or build.
    FileExistsError
        The folder holds an earlier run, or files that no run wrote.
    MissingExtraError
        The format, or run.mcap, needs an extra that is not installed.

    Examples
    --------
    >>> from pathlib import Path
    >>> from tempfile import mkdtemp
    >>> import lidar_core as lc
    >>> folder = Path(mkdtemp())
    >>> made = lc.sim.record(lc.sim.scenes.demo(0, scans=2), folder / "street.npz", seed=0)
    >>> result = lc.runs.detect(made.recording, None, folder / "run", mcap=False, picture=False)
    >>> result.summary["scans"]["processed"], "tracks_tum" in result.files
    (2, True)
    """
    source = Path(recording)
    known = None if known_map is None else Path(known_map)
    cleaned = None if static_map is None else Path(static_map)
    if cleaned is not None:
        check_static_map(cleaned, reads=(source, known))
    folder, writes_mcap = folder_to_write(
        output,
        mcap=mcap,
        overwrite=overwrite,
        reads=source,
        checkpoint=checkpoint,
        resume=resume,
    )
    chosen = config_of_run(config, FlyingConfig, "flying")
    job = RecordingJob(
        command="detect",
        sort=Scan,
        recording=source,
        folder=folder,
        config={"flying": chosen},
        read=read or ReadOptions(),
        pose=pose or PoseOptions(),
        topics=tuple(clouds),
        mcap=writes_mcap,
        picture=picture,
        on_progress=on_progress,
        repeat=repeat,
        inputs={"map": known},
        note={"clouds": list(clouds), "repeat": repeat}
        | ({} if cleaned is None else {"static_map": str(cleaned)}),
        checkpoint=checkpoint,
        resume=resume,
    )
    run = FlyingRun(FlyingObjectDetector(chosen, threads=threads), threads=threads)
    if known is not None:
        load_known_map(run.detector, known)
    if cleaned is None:
        return job.run(run)
    run.detector.make_static_map()
    result = job.run(run)
    write_static_map(run.detector, cleaned)
    return result


def load_known_map(detector: FlyingObjectDetector, path: Path) -> None:
    """Load a map of an earlier run, or make occupied for good what another file holds."""
    if path.suffix.lower() == ".lcvm":
        detector.load_map(path)
        return
    spacing = detector.config.voxel_map.voxel_size / 2
    detector.set_occupied(read_cloud(path, spacing=spacing).points)


class FlyingRun:
    """Passes scans to a detector and keeps what summary, tables, run.mcap and picture need.

    Parameters
    ----------
    detector : FlyingObjectDetector
        Gets every scan.
    threads : int
        Threads of the detector that a checkpoint brings back.
    """

    _KEPT = (
        "gate_reason",
        "gate_is_open",
        "gate_opened_at",
        "sky",
        "rejected",
        "_class_counts",
        "_cloud",
        "_last",
    )
    KINDS: tuple[type, ...] = (FlyingFrame, FlyingDetections, FlyingStatus, Tracks)

    def __init__(self, detector: FlyingObjectDetector, *, threads: int = 1) -> None:
        self.detector = detector
        self._threads = threads
        self.tracks: list[Tracks] = []
        self.gate_reason = "no scan was processed"
        self.gate_is_open = False
        self.gate_opened_at: int | None = None
        self.sky = "unknown"
        self._shares: list[tuple[float, float]] = []
        self.rejected: Counter[str] = Counter()
        self.frame_id = "world"
        self._class_counts = np.zeros(len(PointClass), np.int64)
        self._times = ScanTimes()
        self.frames: list[FlyingFrame] = []
        self._sensors: list[str] = []
        self._path: list[NDArray[np.float64]] = []
        self._flying: list[NDArray[np.float64]] = []
        self._cloud = np.empty((0, 3))
        self._last: FlyingFrame | None = None
        self._mcap: McapWriter | None = None

    def take(self, item: PosedScan[Scan]) -> FlyingFrame:
        """Process one scan, with everything the recording knows about it."""
        start = perf_counter()
        frame = self.detector.process(item)
        if frame.rejected is not None:
            self.rejected[frame.rejected] += 1
        else:
            self.keep(item, frame, (perf_counter() - start) * 1e3)
        return frame

    def open_mcap(self, folder: RunFolder) -> AbstractContextManager[Any]:
        """Open run.mcap for the results of the scans from here on."""
        self._mcap = McapWriter(folder.path / MCAP, tracks_frame=self.frame_id)
        return self._mcap

    def pictures(self, folder: RunFolder, name: str) -> list[Picture]:
        """The picture of a run on the recording `name`."""
        view = self.view(f"{name}: {self.n_scans} scans, {len(self.track_ids)} tracks")
        path = folder.path / "picture.png"
        return [(path, lambda: draw_flying(view, path))]

    def keep(self, item: PosedScan[Scan], frame: FlyingFrame, wall_ms: float) -> None:
        """Keep the results of a scan that took `wall_ms`, and write them to run.mcap."""
        poses = item.world_from_lidar.reshape(-1, 4, 4)
        self._cloud = _placed(item.scan, poses, item.pose_stamps_ns)
        self._last = frame
        status = frame.status
        self.gate_reason, self.gate_is_open = status.reason, status.gate_open
        if status.gate_open and self.gate_opened_at is None:
            self.gate_opened_at = len(self.frames)
        self.sky = status.sky if status.sky != "unknown" else self.sky
        self._class_counts += np.bincount(frame.point_class, minlength=len(PointClass))
        # Classes of every point of every scan would fill the memory on a long recording.
        none, no_rows = frame.point_class[:0], frame.own_rows[:0]
        flying = self._cloud[frame.point_class == PointClass.FLYING]
        kept = replace(frame, point_class=none, own_rows=no_rows)
        self._append(kept, item.scan.topic or item.scan.frame_id, poses[0, :3, 3], flying, wall_ms)
        if self._mcap is not None:
            log_flying(self._mcap, item, frame, frame_id=self.frame_id)

    def _append(
        self,
        frame: FlyingFrame,
        sensor: str,
        place: NDArray[np.float64],
        flying: NDArray[np.float64],
        wall_ms: float,
    ) -> None:
        """Keep what tables and pictures need of a scan."""
        self.frames.append(frame)
        self.tracks.append(frame.tracks)
        self._sensors.append(sensor)
        self._path.append(place)
        self._flying.append(flying)
        self._shares.append((frame.status.sky_share, frame.status.own_body))
        self._times.add(frame.stamp_ns, wall_ms, frame.timing_ms, place)

    def kept(self) -> dict[str, Any]:
        """All state but the rows, for a checkpoint."""
        return {"detector": self.detector.to_bytes()} | {
            name: getattr(self, name) for name in self._KEPT
        }

    def rows(self, since: int) -> list[Any]:
        """What the scans left that were kept since then."""
        lists = (self.frames, self._sensors, self._path, self._flying, self._times.wall_ms)
        return [list(row) for row in zip(*(one[since:] for one in lists), strict=True)]

    def restore(self, kept: Mapping[str, Any], rows: list[Any]) -> None:
        """Take over the state of a run that was killed."""
        content = kept["detector"]
        self.detector = FlyingObjectDetector.from_bytes(content, threads=self._threads)
        for name in self._KEPT:
            setattr(self, name, kept[name])
        for row in rows:
            self._append(*row)

    @property
    def n_received(self) -> int:
        """Scans so far, rejected ones included."""
        return len(self.frames) + self.rejected.total()

    @property
    def notes(self) -> list[str]:
        """That the map was full, if it was."""
        forgotten = self.detector.health().n_voxels_forgotten
        budget = self.detector.config.voxel_map.max_voxels
        if not forgotten:
            return []
        return [
            f"the map reached its budget of {budget:,} voxels and forgot {forgotten:,}, those"
            f" farthest from the sensor first; set voxel_map.max_voxels={4 * budget} keeps more,"
            " set forget_distance=METRES keeps less"
        ]

    @property
    def n_scans(self) -> int:
        """Scans that were processed or held."""
        return len(self.frames)

    @property
    def burn_in_scans(self) -> int:
        """Scans so far in which nothing was reported yet."""
        return sum(frame.status.is_burn_in for frame in self.frames)

    @property
    def latency(self) -> Latency | None:
        """Time per processed scan, in all and per stage [ms]; None without scans."""
        return self._times.latency

    @property
    def class_shares(self) -> dict[str, float]:
        """Share of each class among the points with information."""
        counts = self._class_counts
        total = max(1, int(counts[PointClass.BACKGROUND :].sum()))
        return {kind.name.lower(): float(counts[kind] / total) for kind in CLASSES}

    @property
    def sky_share(self) -> float:
        """Share of the sensor's rays that went into the sky, mean of all scans."""
        return float(np.mean([sky for sky, _ in self._shares])) if self._shares else 0.0

    @property
    def own_body(self) -> float:
        """Share of the sensor's rays that ended on the robot itself, in the last scan."""
        return self._shares[-1][1] if self._shares else 0.0

    @property
    def flying(self) -> list[Tracks]:
        """Tracks of kind FLYING, scan by scan."""
        return [tracks.flying for tracks in self.tracks]

    @property
    def track_ids(self) -> list[int]:
        """Numbers of the flying tracks that were reported."""
        return sorted({number for one in self.flying for number in one.id.tolist()})

    @property
    def n_detections(self) -> int:
        """Detections of all scans."""
        return sum(len(frame.detections) for frame in self.frames)

    def detections_table(self) -> dict[str, Any]:
        """Detections as columns, one row per detection; SI units, world frame."""
        frames, sensors = self.frames, self._sensors
        counts = [len(frame.detections) for frame in frames]
        found = [frame.detections for frame in frames]
        position = np.concatenate([item.position for item in found] or [np.empty((0, 3))])
        extent = np.concatenate([item.extent for item in found] or [np.empty((0, 3))])
        covariance = np.concatenate([item.covariance for item in found] or [np.empty((0, 3, 3))])
        stamps = np.array([frame.stamp_ns for frame in frames], np.int64)
        table: dict[str, Any] = {
            "t_ns": np.repeat(stamps, counts),
            "time_ns": np.array([t for item in found for t in item.time_ns], np.int64),
            "sensor": [s for s, count in zip(sensors, counts, strict=True) for _ in range(count)],
            "frame_id": [self.frame_id] * sum(counts),
        }
        table |= {name: position[:, axis] for axis, name in enumerate("xyz")}
        table |= {f"extent_{name}": extent[:, axis] for axis, name in enumerate("xyz")}
        table["radius"] = np.array([r for item in found for r in item.radius], np.float64)
        table["n_points"] = np.array([n for item in found for n in item.n_points], np.int64)
        table["confidence"] = np.array([c for item in found for c in item.confidence], np.float64)
        return table | covariance_columns("xyz", covariance)

    def summary(self) -> dict[str, Any]:
        """What the run gave, as plain values."""
        health = self.detector.health()
        return {
            "scans": {
                "received": health.received,
                "processed": health.processed,
                "held": health.held,
                "rejected": dict(self.rejected),
            },
            "points": int(self._class_counts[PointClass.BACKGROUND :].sum()),
            "class_shares": self.class_shares,
            "gate": {
                "open": self.gate_is_open,
                "reason": self.gate_reason,
                "opened_at_scan": self.gate_opened_at,
                "burn_in_scans": self.burn_in_scans,
            },
            "sky": self.sky,
            "sky_share": self.sky_share,
            "own_body": self.own_body,
            "detections": self.n_detections,
            "tracks": len(self.track_ids),
            "ms_per_scan": self._times.ms_per_scan,
            "map": {
                "observed_voxels": self.detector.n_observed,
                "occupied_voxels": len(self.detector.occupied_points()),
                "memory_bytes": self.detector.map_memory_bytes,
            },
        }

    def write(self, folder: RunFolder) -> list[str]:
        """Write tables, trajectories and map; return their names."""
        tracks = write_tracks_table(
            folder.path / "tracks.parquet", self.tracks, frame_id=self.frame_id
        )
        table = folder.write_table("detections", self.detections_table())
        timing = folder.write_table("timing", self._times.table())
        write_tum(folder.path / TRACKS_FOLDER, self.flying)
        self.detector.save_map(folder.path / "map.lcvm")
        return [tracks.name, table.name, timing.name, TRACKS_FOLDER, "map.lcvm"]

    def view(self, title: str, **more: Any) -> FlyingView:
        """What a picture of the run shows; `more` are further fields of `FlyingView`."""
        return FlyingView(
            title=title,
            cloud=self._cloud,
            cloud_class=np.empty(0, np.uint8) if self._last is None else self._last.shown_class,
            flying=np.concatenate([*self._flying, np.empty((0, 3))]),
            occupied=self.detector.occupied_points(),
            voxel_size=self.detector.config.voxel_map.voxel_size,
            sensor=np.array(self._path).reshape(-1, 3),
            stamp_ns=np.array([frame.stamp_ns for frame in self.frames], np.int64),
            tracks=self.flying,
            n_detections=np.array([len(frame.detections) for frame in self.frames], np.int64),
            **more,
        )


def _placed(
    scan: Scan, poses: NDArray[np.float64], pose_stamps_ns: NDArray[np.int64] | None
) -> NDArray[np.float64]:
    """Points in the world, each by the last pose before it: near enough for a picture."""
    points = scan.points.reshape(-1, 3).astype(np.float64)
    if pose_stamps_ns is None or scan.point_time_ns is None:
        return points @ poses[0, :3, :3].T + poses[0, :3, 3]
    before = np.searchsorted(pose_stamps_ns, scan.point_time_ns.reshape(-1), side="right") - 1
    before = np.clip(before, 0, len(poses) - 1)
    placed = np.empty_like(points)
    for number in np.unique(before):
        rows = before == number
        placed[rows] = points[rows] @ poses[number, :3, :3].T + poses[number, :3, 3]
    return placed
