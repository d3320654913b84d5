"""Flying objects in scans: data that a run keeps for its tables, trajectories, map and picture.

Longer than other files: it is one class, and every output of a run reads what it keeps.
"""

from collections import Counter
from collections.abc import Mapping
from contextlib import AbstractContextManager
from dataclasses import replace
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_core.evaluation import Latency
from lidar_core.flying import (
    FlyingDetections,
    FlyingFrame,
    FlyingObjectDetector,
    FlyingStatus,
    Tracks,
)
from lidar_core.io import McapWriter, PosedScan, write_tracks_table, write_tum
from lidar_core.io.tables.covariance import covariance_columns
from lidar_core.messages import PointClass, Scan, TrackKind
from lidar_core.run_folder import TRACKS_FOLDER, RunFolder
from lidar_core.runs.result import MCAP, Picture
from lidar_core.runs.scans.standing import StandingCheck
from lidar_core.runs.scans.times import ScanTimes
from lidar_core.sensors import LONGEST_3D, far_median, far_text
from lidar_core.util.reasons import first_of_kind
from lidar_core.viz import FlyingView, draw_flying
from lidar_core.viz.drawing.thinning import spread
from lidar_core.viz.scan_log import log_flying

CLASSES = (PointClass.BACKGROUND, PointClass.FLYING, PointClass.UNKNOWN, PointClass.MOVING)
"""Classes of points with information that the detector gives."""
FEWEST_SCANS, MOVING_SHARE = 5, 0.2
"""Scans with one pose, and share of their points that move, from which on the pose is in doubt.

Measured: 0.1 to 2.3 % with sensors at rest, 36 % in the scans of a car whose poses are left out.
"""
MOST_MOVING = 100  # points on the ground kept of a scan, evenly in space: a street has thousands


class FlyingRun:
    """Passes scans to a detector and keeps the data for summary, tables, run.mcap and picture.

    Parameters
    ----------
    detector : FlyingObjectDetector
        Detector that gets every scan.
    threads : int
        Number of threads of the detector that a checkpoint restores.
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
        self.frame_id, self.is_whole = "world", True
        self._class_counts = np.zeros(len(PointClass), np.int64)
        self.frames: list[FlyingFrame] = []
        self._wall_ms: list[float] = []
        self._sensors: list[str] = []
        self._path: list[NDArray[np.float64]] = []
        self._flying: list[NDArray[np.float64]] = []
        self._moving: list[NDArray[np.float64]] = []
        self._cloud = np.empty((0, 3))
        self._last: FlyingFrame | None = None
        self._mcap: McapWriter | None = None
        self._standing = StandingCheck()

    def take(self, item: PosedScan[Scan]) -> FlyingFrame:
        """Process one scan with all information of the recording about it."""
        start = perf_counter()
        frame = self.detector.process(item)
        if frame.rejected is not None:
            self.rejected[first_of_kind(self.rejected, frame.rejected)] += 1
        else:
            self.keep(item, frame, (perf_counter() - start) * 1e3)
        return frame

    def open_mcap(self, folder: RunFolder) -> AbstractContextManager[Any]:
        """Open run.mcap for the results of the scans from here on."""
        self._mcap = McapWriter(folder.path / MCAP, tracks_frame=self.frame_id)
        return self._mcap

    def pictures(self, folder: RunFolder, name: str) -> list[Picture]:
        """Return the picture of a run on the recording `name`."""
        view = self.view(f"{name}: {self.n_scans} scans, {self._told_tracks}")
        path = folder.path / "picture.png"
        return [(path, lambda _: draw_flying(view, path))]

    def keep(self, item: PosedScan[Scan], frame: FlyingFrame, wall_ms: float) -> None:
        """Keep the results of a scan that took `wall_ms`, and write them to run.mcap."""
        poses = item.world_from_lidar.reshape(-1, 4, 4)
        self._cloud = _points_in_world(item.scan, poses, item.pose_stamps_ns)
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
        moving = self._cloud[frame.point_class == PointClass.MOVING]
        moving = moving[spread(moving, MOST_MOVING)]
        kept = replace(frame, point_class=none, own_rows=no_rows)
        sensor = item.scan.topic or item.scan.frame_id
        self._standing.add(item.scan.points, poses)
        self._append(kept, sensor, poses[0, :3, 3], flying, moving, wall_ms)
        if self._mcap is not None:
            log_flying(self._mcap, item, frame, frame_id=self.frame_id)

    def _append(
        self,
        frame: FlyingFrame,
        sensor: str,
        place: NDArray[np.float64],
        flying: NDArray[np.float64],
        moving: NDArray[np.float64],
        wall_ms: float,
    ) -> None:
        """Keep what tables and pictures need of a scan."""
        self.frames.append(frame)
        self.tracks.append(frame.tracks)
        self._sensors.append(sensor)
        self._path.append(place)
        self._flying.append(flying)
        self._moving.append(moving)
        self._shares.append((frame.status.sky_share, frame.status.own_body))
        self._wall_ms.append(wall_ms)

    def checkpoint_state(self) -> dict[str, Any]:
        """Return the state without the rows, for a checkpoint."""
        kept = {"detector": self.detector.to_bytes(), "standing": self._standing.state()}
        return kept | {name: getattr(self, name) for name in self._KEPT}

    def rows(self, since: int) -> list[Any]:
        """Return the permanent rows of the scans since then."""
        found = (self._flying, self._moving)
        lists = (self.frames, self._sensors, self._path, *found, self._wall_ms)
        return [list(row) for row in zip(*(one[since:] for one in lists), strict=True)]

    def restore(self, kept: Mapping[str, Any], rows: list[Any]) -> None:
        """Take over the state of a run that was killed."""
        content = kept["detector"]
        self.detector = FlyingObjectDetector.from_bytes(content, threads=self._threads)
        self._standing.restore(kept["standing"])
        for name in self._KEPT:
            setattr(self, name, kept[name])
        for row in rows:
            self._append(*row)

    @property
    def n_received(self) -> int:
        """Number of scans so far, including rejected ones."""
        return len(self.frames) + self.rejected.total()

    @property
    def notes(self) -> list[str]:
        """Return warnings: a full map, a closed gate, lengths not in metres, wrong poses."""
        forgotten = self.detector.health().n_voxels_forgotten
        budget = self.detector.config.voxel_map.max_voxels
        found = []
        if forgotten:
            found.append(
                f"the map reached its budget of {budget:,} voxels and forgot {forgotten:,}, those"
                f" farthest from the sensor first; set voxel_map.max_voxels={4 * budget} keeps"
                " more, set forget_distance=METRES keeps less"
            )
        if self.is_whole and self.frames and self.frames[-1].status.is_burn_in:
            found.append(
                f"{self.gate_reason}: the run ended before detections are reported; repeat=N plays"
                " a short recording N times, so that it completes the burn-in"
            )
        return found + self._doubts()

    def _doubts(self) -> list[str]:
        """Warnings about impossible ranges, and about a static pose of a moving sensor."""
        found = []
        here = self._path[-1] if self._path else np.zeros(3)
        far = far_median(self._cloud - here, LONGEST_3D)
        if far is not None:
            found.append(f"last scan: {far_text(far, is_planar=False)}")
        after = self.n_scans - self.burn_in_scans  # before, nothing is moving
        moving = self.class_shares["moving"] * self.n_scans / max(after, 1)
        stands = len(self._path) >= FEWEST_SCANS and not np.ptp(self._path, axis=0).any()
        if stands and after >= FEWEST_SCANS and moving > MOVING_SHARE:
            why = f"{100 * moving:.0f} % of the points move, and the sensor has one place: if the"
        elif stands and self._standing.has_moved:
            why = (
                "the scans fit each other only if the sensor moves, or all that is upright does,"
                " and it has one place: if the"
            )
        else:
            return found
        found.append(
            f"{why} sensor moved, its tracks are wrong; give its poses with"
            ' pose="kiss" (poses from the scans) or pose=FILE'
        )
        return found

    @property
    def n_scans(self) -> int:
        """Number of scans that were processed or held."""
        return len(self.frames)

    @property
    def burn_in_scans(self) -> int:
        """Number of scans so far that belong to the burn-in, in which nothing is reported."""
        return sum(frame.status.is_burn_in for frame in self.frames)

    @property
    def latency(self) -> Latency | None:
        """Time per processed scan, in all and per stage [ms]; None without scans."""
        return self._times().latency

    def _times(self) -> ScanTimes:
        """Times per scan, collected from the frames on request."""
        times = ScanTimes()
        for frame, wall_ms, place in zip(self.frames, self._wall_ms, self._path, strict=True):
            times.add(frame.stamp_ns, wall_ms, frame.timing_ms, place)
        return times

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
    def point_times(self) -> str:
        """Source of the times of points: "estimated" if it is that of any scan, else the last one.

        A sensor that stands for a while needs no times.
        """
        found = [frame.status.point_times for frame in self.frames]
        return "estimated" if "estimated" in found else self.detector.health().point_times

    @property
    def flying(self) -> list[Tracks]:
        """Tracks of kind FLYING, scan by scan."""
        return [tracks.flying for tracks in self.tracks]

    @property
    def track_ids(self) -> list[int]:
        """IDs of the flying tracks that were reported."""
        return sorted({number for one in self.flying for number in one.id.tolist()})

    @property
    def ground_ids(self) -> list[int]:
        """IDs of the tracks that end as GROUND and were never FLYING."""
        last = {
            number: kind
            for one in self.tracks
            for number, kind in zip(one.id.tolist(), one.kind.tolist(), strict=True)
        }
        walks = {number for number, kind in last.items() if kind == TrackKind.GROUND}
        return sorted(walks - set(self.track_ids))

    @property
    def moving_scans(self) -> int:
        """Number of scans with points that move on the ground."""
        return sum(len(points) > 0 for points in self._moving)

    @property
    def _told_tracks(self) -> str:
        """Text for a title: numbers of flying and ground tracks, of scans with moving points."""
        count, scans = len(self.track_ids), self.moving_scans
        text = (
            f"{count} flying track{'' if count == 1 else 's'}, {len(self.ground_ids)} on the ground"
        )
        return text + (f", movers in {scans} scan{'' if scans == 1 else 's'}" if scans else "")

    @property
    def n_detections(self) -> int:
        """Number of detections of all scans."""
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
        """Return the results of the run as plain values."""
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
            "point_times": self.point_times,
            "detections": self.n_detections,
            "tracks": len(self.track_ids),
            "tracks_ground": len(self.ground_ids),
            "scans_moving": self.moving_scans,
            "ms_per_scan": self._times().ms_per_scan,
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
        timing = folder.write_table("timing", self._times().table())
        write_tum(folder.path / TRACKS_FOLDER, self.flying)
        self.detector.save_map(folder.path / "map.lcvm")
        return [tracks.name, table.name, timing.name, TRACKS_FOLDER, "map.lcvm"]

    def view(self, title: str, **more: Any) -> FlyingView:
        """Return the content of a picture of the run; `more` are further fields of `FlyingView`."""
        return FlyingView(
            title=title,
            cloud=self._cloud,
            cloud_class=np.empty(0, np.uint8) if self._last is None else self._last.shown_class,
            flying=np.concatenate([*self._flying, np.empty((0, 3))]),
            moving=np.concatenate([*self._moving, np.empty((0, 3))]),
            moving_scan=np.repeat(np.arange(self.n_scans), [len(one) for one in self._moving]),
            occupied=self.detector.occupied_points(),
            voxel_size=self.detector.config.voxel_map.voxel_size,
            sensor=np.array(self._path).reshape(-1, 3),
            stamp_ns=np.array([frame.stamp_ns for frame in self.frames], np.int64),
            tracks=self.flying,
            n_detections=np.array([len(frame.detections) for frame in self.frames], np.int64),
            **more,
        )


def _points_in_world(
    scan: Scan, poses: NDArray[np.float64], pose_stamps_ns: NDArray[np.int64] | None
) -> NDArray[np.float64]:
    """Points in the world [m], each by the last pose before it: accurate enough for a picture."""
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
