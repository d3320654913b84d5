"""A run of the flying-object detector: what it gave, scan by scan, and the files about it."""

from collections import Counter
from dataclasses import replace
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_core.cli.scan_times import ScanTimes
from lidar_core.evaluation import Latency
from lidar_core.flying import FlyingFrame, FlyingObjectDetector, Tracks
from lidar_core.io import PosedScan, write_tracks_table, write_tum
from lidar_core.io.write.covariance import covariance_columns
from lidar_core.messages import Scan
from lidar_core.run_folder import TRACKS_FOLDER, RunFolder
from lidar_core.scan_processing import detect
from lidar_core.viz import FlyingView

CLASSES = ("invalid", "background", "flying", "unknown")
FLYING = CLASSES.index("flying")


class FlyingRun:
    """Passes scans to a detector and keeps what a summary, tables and a picture need.

    Parameters
    ----------
    detector : FlyingObjectDetector
        Gets every scan.
    """

    def __init__(self, detector: FlyingObjectDetector) -> None:
        self.detector = detector
        self.tracks: list[Tracks] = []
        self.gate_reason = "no scan was processed"
        self.gate_is_open = False
        self.gate_opened_at: int | None = None
        self.sky = "unknown"
        self._shares: list[tuple[float, float]] = []
        self.rejected: Counter[str] = Counter()
        self.frame_id = "world"
        self._class_counts = np.zeros(len(CLASSES), np.int64)
        self._times = ScanTimes()
        self.frames: list[FlyingFrame] = []
        self._sensors: list[str] = []
        self._path: list[NDArray[np.float64]] = []
        self._flying: list[NDArray[np.float64]] = []
        self._cloud = np.empty((0, 3))
        self._cloud_class = np.empty(0, np.uint8)

    def process(self, item: PosedScan[Scan], *, sensor: str = "lidar") -> FlyingFrame:
        """Process one scan, with everything the recording knows about it."""
        start = perf_counter()
        frame = detect(self.detector, item, sensor=sensor)
        wall_ms = (perf_counter() - start) * 1e3
        if frame.rejected is not None:
            self.rejected[frame.rejected] += 1
            return frame
        self.keep(item, frame, wall_ms, sensor=sensor)
        return frame

    def keep(
        self, item: PosedScan[Scan], frame: FlyingFrame, wall_ms: float, *, sensor: str
    ) -> None:
        """Keep what a scan gave that took `wall_ms`."""
        self._times.add(frame.stamp_ns, wall_ms, frame.timing_ms)
        self._note(frame, sensor)
        poses = item.world_from_lidar.reshape(-1, 4, 4)
        self._path.append(poses[0, :3, 3])
        self._cloud = _placed(item.scan, poses, item.pose_stamps_ns)
        self._cloud_class = frame.point_class
        self._flying.append(self._cloud[frame.point_class == FLYING])

    def _note(self, frame: FlyingFrame, sensor: str) -> None:
        status = frame.status
        self.gate_reason, self.gate_is_open = status.reason, status.gate_open
        if status.gate_open and self.gate_opened_at is None:
            self.gate_opened_at = len(self.frames)
        self.sky = status.sky if status.sky != "unknown" else self.sky
        self._shares.append((status.sky_share, status.own_body))
        self._class_counts += np.bincount(frame.point_class, minlength=len(CLASSES))
        # Classes of every point of every scan would fill the memory on a long recording.
        self.frames.append(replace(frame, point_class=frame.point_class[:0]))
        self._sensors.append(sensor)
        self.tracks.append(frame.tracks)

    @property
    def n_received(self) -> int:
        """Scans so far, rejected ones included."""
        return len(self.frames) + self.rejected.total()

    @property
    def n_scans(self) -> int:
        """Scans that were processed or held."""
        return len(self.frames)

    @property
    def latency(self) -> Latency | None:
        """Time per processed scan, in all and per stage [ms]; None without scans."""
        return self._times.latency

    @property
    def class_shares(self) -> dict[str, float]:
        """Share of each class among the points with information."""
        counts = self._class_counts[1:]
        return dict(zip(CLASSES[1:], (counts / max(1, counts.sum())).tolist(), strict=True))

    @property
    def sky_share(self) -> float:
        """Share of the sensor's rays that went into the sky, mean of all scans."""
        return float(np.mean([sky for sky, _ in self._shares])) if self._shares else 0.0

    @property
    def own_body(self) -> float:
        """Share of the returns that were on the robot itself, in the last scan."""
        return self._shares[-1][1] if self._shares else 0.0

    @property
    def track_ids(self) -> list[int]:
        """Numbers of the tracks that were reported."""
        return sorted({number for tracks in self.tracks for number in tracks.id.tolist()})

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
            "points": int(self._class_counts[1:].sum()),
            "class_shares": self.class_shares,
            "gate": {
                "open": self.gate_is_open,
                "reason": self.gate_reason,
                "opened_at_scan": self.gate_opened_at,
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
        write_tum(folder.path / TRACKS_FOLDER, self.tracks)
        self.detector.save_map(folder.path / "map.lcvm")
        return [tracks.name, table.name, timing.name, TRACKS_FOLDER, "map.lcvm"]

    def view(self, title: str, **more: Any) -> FlyingView:
        """What a picture of the run shows; `more` are further fields of `FlyingView`."""
        return FlyingView(
            title=title,
            cloud=self._cloud,
            cloud_class=self._cloud_class,
            flying=np.concatenate([*self._flying, np.empty((0, 3))]),
            occupied=self.detector.occupied_points(),
            voxel_size=self.detector.config.voxel_map.voxel_size,
            sensor=np.array(self._path).reshape(-1, 3),
            stamp_ns=np.array([frame.stamp_ns for frame in self.frames], np.int64),
            tracks=self.tracks,
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
