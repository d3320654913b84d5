"""Circles in 2D scans: data that a run keeps for its tables, trajectories and pictures."""

from collections import Counter
from collections.abc import Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from pathlib import Path
from time import perf_counter
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from lidar_core.circles import CircleElements, CircleFrame, CirclePipeline, ShapeElements
from lidar_core.circles.movers import moving_at_end
from lidar_core.io import (
    McapWriter,
    PosedScan,
    write_circles_table,
    write_circles_tum,
    write_shapes_table,
)
from lidar_core.io.tables.circles import map_columns
from lidar_core.io.tables.covariance import covariance_columns
from lidar_core.messages import LaserScan
from lidar_core.run_folder import TRACKS_FOLDER, RunFolder
from lidar_core.runs.result import MCAP, OnProgress, Picture
from lidar_core.runs.scans.times import ScanTimes
from lidar_core.sensors import LONGEST_2D, far_text
from lidar_core.viz import CirclesView, animate_circles, draw_circles
from lidar_core.viz.film import film_ending
from lidar_core.viz.scan_log import log_circles

MOST_POINTS = 4_000_000  # kept for the pictures; beyond, points of every other scan are dropped
FILM_FRAMES, FILM_RATE = 120, 10.0
NOTED_OFFSET_S = 0.01  # of poses that a run is told about
NOTED_STUCK = 5  # scans whose pose stayed the same while the scanner moved
NOTED_RATIO = 1.5  # of the noise of ranges to the configured one
PERSON, PERSON_NS = 0.5, 10**9  # probability of a person, and time for which it is exceeded [ns]


@dataclass(frozen=True, slots=True)
class _Found:
    """Circles of one scan that were used for the map: the part of a frame that tables need."""

    scanner: str
    time_ns: NDArray[np.int64]
    circles: NDArray[np.float64]
    covariance: NDArray[np.float64]
    n_hits: NDArray[np.int64]
    is_fallback: NDArray[np.bool_]
    element: NDArray[np.int64]

    @classmethod
    def of(cls, frame: CircleFrame) -> Self:
        in_map, circles = frame.element >= 0, frame.circles_world
        return cls(
            frame.scanner,
            frame.time_ns[in_map],
            circles.parameters[in_map],
            circles.covariance[in_map],
            circles.n_hits[in_map],
            circles.is_fallback[in_map],
            frame.element[in_map],
        )


class CirclesRun:
    """Passes 2D scans to a pipeline and keeps the data for summary, tables and pictures.

    Parameters
    ----------
    pipeline : CirclePipeline
        Pipeline that gets every scan.
    picture, film : bool
        True if `pictures` has the picture, the film.
    allow_untrusted : bool
        Setting of the pipeline that a checkpoint restores.
    """

    KINDS: tuple[type, ...] = (_Found, CircleElements, ShapeElements)

    def __init__(
        self,
        pipeline: CirclePipeline,
        *,
        picture: bool = True,
        film: bool = False,
        allow_untrusted: bool = False,
    ) -> None:
        self.pipeline = pipeline
        self._allow_untrusted = allow_untrusted
        self.frame_id, self.is_whole = "world", True
        self.maps: list[CircleElements] = []
        self.shapes: list[ShapeElements] = []
        self._picture, self._film = picture, film
        self._times = ScanTimes()
        self._mcap: McapWriter | None = None
        self._found: list[_Found] = []
        self._sensor: list[NDArray[np.float64]] = []
        self._points: list[NDArray[np.float64]] = []
        self._last_points = np.empty((0, 2))
        self._kept, self._stride = 0, 1
        self._too_near = 0

    @property
    def n_received(self) -> int:
        """Number of scans so far, including rejected ones."""
        return self.pipeline.health().received

    @property
    def notes(self) -> list[str]:
        """Return properties that the scans show and that differ from recording or configuration."""
        health, told = self.pipeline.health(), self.pipeline.config.fit.range_std
        offset, noise = health.pose_offset_s, health.range_std_estimated
        notes = []
        if 2 * health.far_scans > health.processed:
            notes.append(f"{health.far_scans} scans: {far_text(LONGEST_2D, is_planar=True)}")
        if offset is not None and abs(offset) >= NOTED_OFFSET_S:
            when = "late" if offset > 0 else "early"
            notes.append(
                f"poses are {abs(offset) * 1e3:.0f} ms {when}: what stands turns with the scanner;"
                " the map moves them on, check the clocks"
            )
        if health.stuck_poses >= NOTED_STUCK:
            notes.append(
                f"at least {health.stuck_poses} scans have a pose that stays the same while the"
                " scanner moves: the source of the poses stopped there, and what stands seems to"
                " move"
            )
        if noise is not None and not 1 / NOTED_RATIO < noise / told < NOTED_RATIO:
            notes.append(
                f"ranges have a standard deviation of {noise:.3f} m, not {told:g} m as in"
                " fit.range_std; the map uses it"
            )
        return notes

    @property
    def element_ids(self) -> list[int]:
        """IDs of the elements that were reported."""
        return sorted({number for state in self.maps for number in state.id.tolist()})

    @property
    def person_ids(self) -> list[int]:
        """IDs of the elements that were probably persons for at least a second in total."""
        times_ns = Counter[int]()
        for state, later in pairwise(self.maps):
            for number in state.id[state.person_probability > PERSON].tolist():
                times_ns[number] += min(later.stamp_ns - state.stamp_ns, PERSON_NS)
        return sorted(number for number, time_ns in times_ns.items() if time_ns >= PERSON_NS)

    def take(self, item: PosedScan[LaserScan]) -> None:
        """Process one scan."""
        start = perf_counter()
        frame = self.pipeline.process(item)
        wall_ms = (perf_counter() - start) * 1e3
        if frame.rejected is None:
            self.keep(item, frame, wall_ms)

    def keep(self, item: PosedScan[LaserScan], frame: CircleFrame, wall_ms: float) -> None:
        """Keep the results of a scan that took `wall_ms`, and write them to run.mcap."""
        pose = item.world_from_lidar.reshape(-1, 4, 4)[0]
        self._last_points = _points_world(frame, pose)
        self._too_near += int(frame.too_near.sum())
        maps, found = (frame.map, frame.map_shapes), _Found.of(frame)
        self._append(*maps, found, pose[:3, 3], self._last_points, wall_ms, frame.timing_ms)
        if self._mcap is not None:
            log_circles(self._mcap, item, frame, frame_id=self.frame_id)

    def open_mcap(self, folder: RunFolder) -> AbstractContextManager[Any]:
        """Open run.mcap for the results of the scans from here on."""
        self._mcap = McapWriter(folder.path / MCAP, tracks_frame=self.frame_id)
        return self._mcap

    def summary(self) -> dict[str, Any]:
        """Return the results of the run as plain values."""
        health = self.pipeline.health()
        return {
            "scans": {
                "received": health.received,
                "processed": health.processed,
                "rejected": dict(health.reasons),
            },
            "circles": sum(len(item.element) for item in self._found),
            "too_near": self._too_near,
            "elements": len(self.element_ids),
            "elements_at_end": len(self.maps[-1].id) if self.maps else 0,
            "moving_at_end": [
                {"id": number, "speed": speed} for number, speed in moving_at_end(self.maps).items()
            ],
            "persons": len(self.person_ids),
            "shapes": len({number for state in self.shapes for number in state.id.tolist()}),
            "shapes_at_end": len(self.shapes[-1].id) if self.shapes else 0,
            "ms_per_scan": self._times.ms_per_scan,
            "range_std_estimated": health.range_std_estimated,
            "pose_offset_s": health.pose_offset_s,
            "no_return": health.no_return,
            "stuck_poses": health.stuck_poses,
        }

    def write(self, folder: RunFolder) -> list[str]:
        """Write tables and trajectories; return their names."""
        table = write_circles_table(
            folder.path / "circles.parquet", self.maps, frame_id=self.frame_id
        )
        shapes = write_shapes_table(
            folder.path / "shapes.parquet", self.shapes, frame_id=self.frame_id
        )
        whole = folder.write_table("map", map_columns(self.maps, self.frame_id))
        found = folder.write_table("detections", self._detections())
        timing = folder.write_table("timing", self._times.table())
        write_circles_tum(folder.path / TRACKS_FOLDER, self.maps)
        return [table.name, shapes.name, whole.name, found.name, timing.name, TRACKS_FOLDER]

    def pictures(self, folder: RunFolder, name: str) -> list[Picture]:
        """Return the picture of a run on the recording `name` and the film, as far as wanted."""
        view = self.view(f"{name}: {len(self.maps)} scans, {len(self.element_ids)} elements")
        picture, film = folder.path / "picture.png", folder.path / f"film{film_ending()}"
        found: list[Picture] = []
        if self._picture:
            found.append((picture, lambda _: draw_circles(view, picture)))
        if self._film:
            found.append((film, lambda on_progress: _draw_film(view, film, on_progress)))
        return found

    def view(self, title: str, **more: Any) -> CirclesView:
        """Return the content of pictures of the run; `more` are further fields of `CirclesView`."""
        counts = [len(item.element) for item in self._found]
        return CirclesView(
            title=title,
            points=[*self._points[:-1], self._last_points] if self._points else [],
            sensor=np.array(self._sensor).reshape(-1, 2),
            stamp_ns=np.array([state.stamp_ns for state in self.maps], np.int64),
            maps=self.maps,
            shapes=self.shapes,
            n_circles=np.array(counts, np.int64),
            **more,
        )

    def checkpoint_state(self) -> dict[str, Any]:
        """Return the state without the rows, for a checkpoint."""
        last, near = self._last_points, self._too_near
        return {"pipeline": self.pipeline.to_bytes(), "last_points": last, "too_near": near}

    def rows(self, since: int) -> list[Any]:
        """Return the permanent rows of the scans since then."""
        kept = (self.maps, self.shapes, self._found, self._times.places, self._points)
        times = (self._times.wall_ms, self._times.stages_ms)
        return [list(row) for row in zip(*(one[since:] for one in (*kept, *times)), strict=True)]

    def restore(self, kept: Mapping[str, Any], rows: list[Any]) -> None:
        """Take over the state of a run that was killed."""
        content = kept["pipeline"]
        self.pipeline = CirclePipeline.from_bytes(content, allow_untrusted=self._allow_untrusted)
        self._last_points, self._too_near = kept["last_points"], kept["too_near"]
        for row in rows:
            self._append(*row)
        self._thin_points()

    def _append(
        self,
        elements: CircleElements,
        shapes: ShapeElements,
        found: _Found,
        place: NDArray[np.float64],
        points: NDArray[np.float64],
        wall_ms: float,
        timing_ms: Mapping[str, float],
    ) -> None:
        """Keep what tables and pictures need of a scan."""
        self.maps.append(elements)
        self.shapes.append(shapes)
        self._found.append(found)
        self._sensor.append(place[:2])
        self._times.add(elements.stamp_ns, wall_ms, timing_ms, place)
        is_kept = (len(self._points)) % self._stride == 0
        self._points.append(points if is_kept else np.empty((0, 2)))
        self._kept += len(self._points[-1])
        while self._kept > MOST_POINTS:
            self._stride *= 2
            self._thin_points()

    def _thin_points(self) -> None:
        for number in range(len(self._points)):
            if number % self._stride:
                self._points[number] = np.empty((0, 2))
        self._kept = sum(map(len, self._points))

    def _detections(self) -> dict[str, Any]:
        """Circles of all scans that went into the map, as columns; SI units, world frame."""
        found = self._found
        circles = np.concatenate([np.empty((0, 3)), *(item.circles for item in found)])
        covariance = np.concatenate([np.empty((0, 3, 3)), *(item.covariance for item in found)])
        counts = [len(item.element) for item in found]
        stamps = np.array([state.stamp_ns for state in self.maps], np.int64)
        no_rows = np.empty(0, np.int64)
        names = ("x", "y", "radius")
        return {
            "t_ns": np.repeat(stamps, counts),
            "time_ns": np.concatenate([no_rows, *(item.time_ns for item in found)]),
            "sensor": [item.scanner for item in found for _ in item.element],
            "frame_id": [self.frame_id] * sum(counts),
            **{name: circles[:, axis] for axis, name in enumerate(names)},
            "n_points": np.concatenate([no_rows, *(item.n_hits for item in found)]),
            "is_fallback": np.concatenate(
                [np.empty(0, np.bool_), *(item.is_fallback for item in found)]
            ),
            "element": np.concatenate([no_rows, *(item.element for item in found)]),
            **covariance_columns(names, covariance),
        }


def _draw_film(view: CirclesView, path: Path, on_progress: OnProgress) -> None:
    animate_circles(
        view, path, frames=FILM_FRAMES, rate=FILM_RATE, on_frame=partial(on_progress, "film")
    )


def _points_world(frame: CircleFrame, pose: NDArray[np.float64]) -> NDArray[np.float64]:
    """Transform the points of the level frame into the world; return x and y [m]."""
    hit = np.isfinite(frame.ranges)
    angles = frame.bearings[hit] + np.arctan2(pose[1, 0], pose[0, 0])
    away = frame.ranges[hit, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    points: NDArray[np.float64] = pose[:2, 3] + away
    return points
