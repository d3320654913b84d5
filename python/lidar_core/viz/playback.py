"""Playback of a run from its files: scans in the world frame, objects and outlines over time."""

from bisect import bisect_left, bisect_right
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from lidar_core.errors import FormatError
from lidar_core.io.opening import open_recording
from lidar_core.io.poses.posed import posed_laser_scans, posed_scans
from lidar_core.io.recording import Recording
from lidar_core.io.records import SCAN_KINDS
from lidar_core.io.tables.columns import Columns, read_columns
from lidar_core.io.tables.covariance import covariance_titles, symmetric
from lidar_core.io.tables.shapes import outline, outline_of_row
from lidar_core.messages import LaserScan, Scan, ShownClass
from lidar_core.objects import Objects, ShapeElements
from lidar_core.run_folder import RUN_FILE

Capability: TypeAlias = Literal["flying", "circles", "fusion"]
Trails: TypeAlias = dict[int, NDArray[np.float64]]
_WorldScan: TypeAlias = tuple[
    int, NDArray[np.float32], NDArray[np.uint8], NDArray[np.float64] | None
]

RECORDING, MAP = "run.mcap", "map.lcvm"
CORNERS = 36  # of a circle
SMALLEST = 0.1  # side of a box that viewers show, also where nobody knows the extent [m]


@dataclass(frozen=True, slots=True)
class Outline:
    """A wall or another shape than a circle, seen from above.

    Attributes
    ----------
    id : int
        ID of the element.
    points : ndarray, shape (V, 3), float64
        Both ends of a line, or a closed path around an ellipse or rectangle; world frame [m].
    visible : bool
        True if it is in sight.
    """

    id: int
    points: NDArray[np.float64]
    visible: bool


@dataclass(frozen=True, slots=True)
class Moment:
    """One time of a run.

    Attributes
    ----------
    stamp_ns : int
        Time [ns].
    points : ndarray, shape (N, 3), float32
        Points of the scan, world frame [m]; none between scans.
    point_class : ndarray, shape (N,), uint8
        A `PointClass` each; INVALID where points have no class.
    objects : Objects
        Objects at that time.
    outlines : tuple of Outline
        Walls, ellipses and rectangles of a map of circles.
    sensor : ndarray, shape (3,), float64, or None
        Position of the sensor, world frame [m]; None between scans, or where the run does not
        know.
    """

    stamp_ns: int
    points: NDArray[np.float32]
    point_class: NDArray[np.uint8]
    objects: Objects
    outlines: tuple[Outline, ...] = ()
    sensor: NDArray[np.float64] | None = None

    @property
    def movers(self) -> NDArray[np.float32]:
        """Points (M, 3) of the scan that move on the ground [m]."""
        points: NDArray[np.float32] = self.points[self.point_class == ShownClass.MOVING]
        return points


class Playback:
    """The folder that `detect`, `circles`, `fuse` or `demo` wrote.

    Attributes
    ----------
    folder : Path
        Folder of the run.
    capability : str
        flying, circles or fusion.

    Raises
    ------
    FileNotFoundError
        No such folder.
    FormatError
        The folder is no run of these commands.
    """

    def __init__(self, folder: str | Path) -> None:
        self.folder = Path(folder)
        if not self.folder.is_dir():
            raise FileNotFoundError(f"{self.folder}: no such folder")
        if not (self.folder / RUN_FILE).is_file():
            raise FormatError(f"{self.folder}: expected the folder of a run, with {RUN_FILE}")
        tables = [(name, path) for name in ("circles", "tracks") for path in self._tables(name)]
        if not tables:
            raise FormatError(
                f"{self.folder}: neither tracks nor circles in it, but"
                f" {', '.join(sorted(item.name for item in self.folder.iterdir()))}"
            )
        name, path = tables[0]
        self._columns = read_columns(path)
        is_fusion = any(self.folder.glob("states.*"))
        self.capability: Capability = (
            "circles" if name == "circles" else "fusion" if is_fusion else "flying"
        )
        if self.capability == "flying" and "kind" in self._columns:
            flies = self._columns["kind"] == "flying"  # as pictures and summaries
            self._columns = {name: values[flies] for name, values in self._columns.items()}
        self._rows = _rows_by_time(self._columns)
        shapes = self._tables("shapes") if name == "circles" else []
        self._shapes = read_columns(shapes[0]) if shapes else None
        self._shape_rows = {} if self._shapes is None else _rows_by_time(self._shapes)

    @property
    def frame_id(self) -> str:
        """Frame of the objects; "world" if the run has none."""
        frames = self._columns.get("frame_id", _NO_ROWS)
        return str(frames[0]) if len(frames) else "world"

    def nothing_to(self, verb: str) -> FormatError:
        """Error for a run that holds nothing to draw or report, with the way to a run that does."""
        if any(self.steps()):
            return FormatError(
                f"{self.folder}: no objects to {verb}, and no scans, which run.mcap holds: run the"
                " command again with it (mcap=True)"
            )
        return FormatError(
            f"{self.folder}: neither scans nor estimates to {verb}: no scan was processed. Its"
            " summary.json says why, under scans, without_pose and notes; run the command again"
            " with what its scans lacked, such as poses (pose=FILE)"
        )

    def steps(self) -> Iterator[tuple[int, Objects]]:
        """Processed times [ns] in ascending order with the objects at each, without scans.

        Object sizes are zero if the run did not save them.
        """
        timing = self._tables("timing")
        looked_at = read_columns(timing[0])["t_ns"].tolist() if timing else []
        for stamp_ns in sorted(self._rows.keys() | set(looked_at)):
            yield stamp_ns, _objects(self._columns, self._rows.get(stamp_ns, _NO_ROWS), least=0.0)

    def segments(self) -> dict[int, NDArray[np.float64]]:
        """Walls and sides of rectangles of a map of circles, by time [ns]: both ends (S, 2, 3) [m].

        Ellipses have none.
        """
        if self._shapes is None:
            return {}
        shapes = self._shapes
        return {
            stamp_ns: np.concatenate(
                [_NO_SEGMENTS, *(_sides(shapes, row) for row in rows.tolist())]
            )
            for stamp_ns, rows in self._shape_rows.items()
        }

    def _tables(self, name: str) -> list[Path]:
        places = (self.folder / f"{name}.parquet", self.folder / f"{name}.csv")
        return [path for path in places if path.is_file()]

    @property
    def points_name(self) -> str:
        """Name of points without a class in legends."""
        return "measurement" if self.capability == "fusion" else "scan"

    @property
    def recording(self) -> Path | None:
        """MCAP file with the scans; None where the run wrote none."""
        path = self.folder / RECORDING
        return path if path.is_file() else None

    @property
    def voxel_map(self) -> Path | None:
        """The map; None if the run wrote none."""
        path = self.folder / MAP
        return path if path.is_file() else None

    def occupied(self) -> tuple[NDArray[np.float64], float]:
        """Centres (V, 3) of the occupied voxels of the map, and their edge [m]; (0, 3) without."""
        from lidar_core.flying.voxel_map import VoxelMap

        if self.voxel_map is None:
            return np.empty((0, 3)), 1.0
        kept = VoxelMap.load(self.voxel_map)
        return kept.occupied_points(), float(kept.config.voxel_size)

    def times(self) -> list[int]:
        """Times [ns] of scans with points, ascending; of estimates if no scan has points."""
        found = [stamp_ns for stamp_ns, points, _, _ in self._views() if len(points)]
        return found or [stamp_ns for stamp_ns, _, _, _ in self._views()]

    def moments(self, chosen: Collection[int] | None = None) -> Iterator[Moment]:
        """Yield the moments of scans and of estimates in ascending order.

        `chosen` selects moments by their times [ns]; None: all. Without stored scans there are
        only estimates.
        """
        for view in self._views():
            if chosen is None or view[0] in chosen:
                yield self._moment(*view)

    def trails(self, moment: Moment, most: int | None) -> Trails:
        """Return the last positions (S, 3) [m] of every object of a moment, at most this many."""
        found = {}
        for name in moment.objects.id.tolist():
            stamps, places = self._ways[name]
            end = int(np.searchsorted(stamps, moment.stamp_ns, side="right"))
            found[name] = places[0 if most is None else max(0, end - most) : end]
        return found

    @cached_property
    def _ways(self) -> dict[int, tuple[NDArray[np.int64], NDArray[np.float64]]]:
        """Times [ns] and positions (S, 3) [m] of every object."""
        columns = self._columns
        order = np.lexsort((columns["t_ns"], columns["track_id"]))
        places = _objects(columns, order, least=0.0).position
        names, starts = np.unique(columns["track_id"][order], return_index=True)
        parts = zip(
            np.split(columns["t_ns"][order], starts[1:]),
            np.split(places, starts[1:]),
            strict=True,
        )
        return dict(zip(names.tolist(), parts, strict=False))

    @cached_property
    def _sensors(self) -> dict[int, NDArray[np.float64]]:
        """Positions of the sensor (3,) [m] by time [ns], also in runs that kept no scans."""
        timing = self._tables("timing")
        columns = read_columns(timing[0]) if timing else {}
        if "sensor_x" not in columns:
            return {}
        places = np.stack([columns[f"sensor_{axis}"] for axis in "xyz"], axis=1).astype(np.float64)
        return dict(zip(columns["t_ns"].tolist(), places, strict=True))

    def _views(self) -> Iterator[_WorldScan]:
        """Yield the scans, and between them the times that have only estimates."""
        stamps = sorted(self._rows.keys() | self._shape_rows.keys())
        begin = 0
        for scan in self._scans():
            end = bisect_left(stamps, scan[0], begin)
            yield from ((stamp, _NO_POINTS, _NO_CLASSES, None) for stamp in stamps[begin:end])
            yield scan
            begin = bisect_right(stamps, scan[0], end)
        yield from ((stamp, _NO_POINTS, _NO_CLASSES, None) for stamp in stamps[begin:])

    def _moment(
        self,
        stamp_ns: int,
        points: NDArray[np.float32],
        classes: NDArray[np.uint8],
        sensor: NDArray[np.float64] | None = None,
    ) -> Moment:
        rows = self._rows.get(stamp_ns, _NO_ROWS)
        outlines = (
            ()
            if self._shapes is None
            else tuple(
                _outline(self._shapes, row)
                for row in self._shape_rows.get(stamp_ns, _NO_ROWS).tolist()
            )
        )
        objects = _objects(self._columns, rows, least=SMALLEST)
        if sensor is None:
            sensor = self._sensors.get(stamp_ns)
        return Moment(stamp_ns, points, classes, objects, outlines, sensor)

    def _scans(self) -> Iterator[_WorldScan]:
        if self.recording is None:
            return
        with open_recording(self.recording) as recording:
            topics = [topic for topic in recording.topics() if topic.kind in SCAN_KINDS]
            for topic in topics[:1]:
                yield from _read_world_scans(
                    recording, topic.name, is_planar=topic.kind == "planar"
                )


def _read_world_scans(recording: Recording, topic: str, *, is_planar: bool) -> Iterator[_WorldScan]:
    """Yield per scan: time, points in the world, their classes, and the sensor's position."""
    read = posed_laser_scans if is_planar else posed_scans
    for posed in read(recording, cloud=topic):
        scan = posed.scan
        pose = posed.world_from_lidar.reshape(-1, 4, 4)[0]
        local = swept(scan) if isinstance(scan, LaserScan) else scan.points.reshape(-1, 3)
        is_point = np.asarray(np.isfinite(local).all(axis=1), np.bool_)
        classes = _classes(scan, is_point)
        yield scan.stamp_ns, in_world(local[is_point], pose), classes, pose[:3, 3]


def in_world(local: NDArray[Any], world_from_lidar: NDArray[np.float64]) -> NDArray[np.float32]:
    """Transform points (N, 3) from the sensor's frame to the world [m]."""
    turned = local @ world_from_lidar[:3, :3].T + world_from_lidar[:3, 3]
    return np.asarray(turned, np.float32)


def swept(scan: LaserScan) -> NDArray[np.float64]:
    """Points (B, 3) of a 2D scan in its own frame [m]; NaN for rays that hit nothing."""
    bearings = scan.angle_min + scan.angle_increment * np.arange(len(scan.ranges))
    with np.errstate(invalid="ignore"):
        x, y = scan.ranges * np.cos(bearings), scan.ranges * np.sin(bearings)
    return np.stack([x, y, np.where(np.isfinite(scan.ranges), 0.0, np.nan)], axis=1)


def _classes(scan: Scan | LaserScan, is_point: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """Classes of the points that `detect` stored as intensities; zeros if there are none."""
    if isinstance(scan, Scan) and scan.intensity is not None:
        return scan.intensity[is_point].astype(np.uint8)
    return np.zeros(int(is_point.sum()), np.uint8)


def _rows_by_time(columns: Columns) -> dict[int, NDArray[np.int64]]:
    stamps, starts = np.unique(columns["t_ns"], return_index=True)
    order = np.argsort(columns["t_ns"], kind="stable")
    parts = np.split(order, np.searchsorted(columns["t_ns"][order], stamps)[1:])
    return dict(zip(stamps.tolist(), parts, strict=True)) if len(starts) else {}


def _objects(columns: Columns, rows: NDArray[np.int64], *, least: float) -> Objects:
    def of(name: str) -> NDArray[np.float64]:
        return np.asarray(columns[name][rows], float) if name in columns else np.zeros(len(rows))

    axes = ("x", "y", "z")
    triangles = np.stack([of(title) for title in covariance_titles(axes)], axis=1)
    if "radius" in columns:
        size = np.stack([2 * of("radius"), 2 * of("radius"), np.zeros(len(rows))], axis=1)
    else:
        size = np.maximum(np.stack([of(f"extent_{axis}") for axis in axes], axis=1), least)
    return Objects(
        id=columns["track_id"][rows].astype(np.int64),
        position=np.stack([of(axis) for axis in axes], axis=1),
        velocity=np.stack([of(f"v{axis}") for axis in axes], axis=1),
        covariance=np.nan_to_num(symmetric(triangles, len(axes))),
        size=size,
    )


def outlines_of(shapes: ShapeElements) -> tuple[Outline, ...]:
    """Return the outlines of map elements with other shapes than circles."""
    return tuple(
        _outline_from(number, outline(shapes, row, CORNERS), is_visible=bool(shapes.visible[row]))
        for row, number in enumerate(shapes.id.tolist())
    )


def _outline(columns: Columns, row: int) -> Outline:
    around = outline_of_row(columns, row, CORNERS)
    return _outline_from(
        int(columns["track_id"][row]), around, is_visible=bool(columns["visible"][row])
    )


def _sides(columns: Columns, row: int) -> NDArray[np.float64]:
    """Ends (S, 2, 3) [m] of a wall or of the sides of a rectangle; empty for an ellipse."""
    if columns["kind"][row] == "ellipse":
        return _NO_SEGMENTS
    corners = np.pad(outline_of_row(columns, row, CORNERS), ((0, 0), (0, 1)))
    if len(corners) == 2:
        return corners[None]
    sides: NDArray[np.float64] = np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)
    return sides


def _outline_from(number: int, around: NDArray[np.float64], *, is_visible: bool) -> Outline:
    closed = around if len(around) == 2 else np.vstack([around, around[:1]])
    flat = np.pad(closed, ((0, 0), (0, 1)))
    return Outline(number, flat, is_visible)


_NO_POINTS = np.empty((0, 3), np.float32)
_NO_ROWS = np.empty(0, np.int64)
_NO_SEGMENTS = np.empty((0, 2, 3))
_NO_CLASSES = np.empty(0, np.uint8)
