"""lidar_core's own .npz recording: exact, needs no extra package, opens with `numpy.load`.

Layout (version 1), a zip of .npy members, nothing pickled:

- `layout`: 1
- `scan_stamp_ns` (S,), `scan_frame_id` (S,), `scan_topic` (S,)
- `scan_000000_points` (N, 3) or (H, W, 3), and, where known, `scan_000000_no_return`,
  `_directions`, `_point_time_ns`, `_intensity`, `_ring`
- with 2D scans, `laser_stamp_ns` (L,), `laser_frame_id` (L,), `laser_topic` (L,),
  `laser_scanner` (L, 4): angle_min, angle_increment, range_min, range_max,
  `laser_time_increment_ns` (L,), and `laser_000000_ranges` (B,), where known `_intensity` (B,)
- `pose_stamp_ns` (P,), `pose_matrix` (P, 4, 4), `pose_frame_id`, `pose_child_frame_id`,
  `pose_topic` (P,), `pose_is_static` (P,), `pose_covariance` (P, 6, 6), NaN where unknown

A file with a single array `points` is one scan at time 0.
"""

import heapq
from collections.abc import Iterator
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any
from zipfile import ZipFile

import numpy as np
from numpy.typing import NDArray

from lidar_core.arrays import as_mask, as_points, as_pose, as_rows
from lidar_core.errors import FormatError, InputError
from lidar_core.io.files.beginnings import ZIP, check_beginning
from lidar_core.io.files.guard import reading
from lidar_core.io.files.npy import archive_of, array_in
from lidar_core.io.messages.own_cloud import OWN_VERDICT
from lidar_core.io.options import ReadOptions
from lidar_core.io.poses.pose_topics import NPZ_ODOMETRY
from lidar_core.io.readers import register_reader
from lidar_core.io.recording import Recording
from lidar_core.io.records import Record, Topic, decoded
from lidar_core.messages import LaserScan, Message, Pose, Scan

LAYOUT = 1
OPTIONAL = ("no_return", "directions", "point_time_ns", "intensity", "ring")
_ROWS: dict[str, tuple[tuple[int, ...], Any]] = {
    "directions": ((3,), np.float32),
    "point_time_ns": ((), np.int64),
    "intensity": ((), np.float32),
    "ring": ((), np.uint16),
}
"""Shape of a row and dtype of what is optional, `no_return` aside."""
SCANNER = ("angle_min", "angle_increment", "range_min", "range_max")


@register_reader("lidar_core", [".npz"], folder="merged")
class NpzRecording(Recording):
    """One .npz file; scans are read one by one."""

    format = "npz"

    def __init__(self, path: Path, options: ReadOptions) -> None:
        super().__init__(path, options)
        limit = options.max_record_bytes
        self._array = partial(array_in, what="array", limit=limit, key="max_record_bytes")
        check_beginning(path, ZIP, "an .npz file")
        with reading(str(path)), archive_of(path) as archive:
            self._names = {name.removesuffix(".npy") for name in archive.namelist()}
            self._has_index = "layout" in self._names
            self._index = self._read_index(archive) if self._has_index else {}
        if not self._has_index and "points" not in self._names:
            raise FormatError(
                f"{path}: neither 'layout' nor 'points' among {sorted(self._names)[:8]}"
            )
        scans = [*self._index.get("scan_topic", ["points"]), *self._index.get("laser_topic", [])]
        for topic in set(scans):
            self.findings.no_return[str(topic)] = OWN_VERDICT
            self.findings.point_time[str(topic)] = OWN_VERDICT

    def topics(self) -> list[Topic]:
        """Streams of scans, of 2D scans and of poses."""
        if not self._has_index:
            return [Topic("points", "array", "scan", 1)]
        result = []
        for prefix, kind in (("scan", "scan"), ("laser", "planar"), ("pose", "pose")):
            if f"{prefix}_topic" not in self._index:
                continue
            names, counts = np.unique(self._index[f"{prefix}_topic"], return_counts=True)
            result += [
                Topic(str(name), self._type_of(prefix, name), kind, int(count))  # type: ignore[arg-type]
                for name, count in zip(names, counts, strict=True)
            ]
        return result

    def _type_of(self, prefix: str, name: Any) -> str:
        """Type of a topic: poses without child frame are no transforms, as in a bag."""
        is_nameless = prefix == "pose" and not any(
            self._index["pose_child_frame_id"][self._index["pose_topic"] == name]
        )
        return NPZ_ODOMETRY if is_nameless else f"npz {prefix}"

    def records(self, kinds: frozenset[str] | None = None) -> Iterator[Record]:
        """Poses and scans in time order; poses come first at equal times."""
        topics = {(topic.name, topic.kind): topic for topic in self.topics()}
        with reading(str(self.path)), closing(archive_of(self.path)) as archive:
            if not self._has_index:
                yield Record(topics["points", "scan"], 0, partial(self._scan, archive, None))
                return
            parts: list[Iterator[Record]] = []
            if kinds is None or "pose" in kinds:
                parts.append(self._pose_records(topics))
            index = self._index
            if kinds is None or "scan" in kinds:
                scans = zip(index["scan_topic"], index["scan_stamp_ns"].tolist(), strict=True)
                parts.append(
                    Record(topics[str(name), "scan"], stamp, partial(self._scan, archive, number))
                    for number, (name, stamp) in enumerate(scans)
                )
            if "laser_topic" in index and (kinds is None or "planar" in kinds):
                sweeps = zip(index["laser_topic"], index["laser_stamp_ns"].tolist(), strict=True)
                parts.append(
                    Record(topics[str(name), "planar"], at, partial(self._laser, archive, number))
                    for number, (name, at) in enumerate(sweeps)
                )
            yield from heapq.merge(*parts, key=lambda record: record.time_ns)

    def _pose_records(self, topics: Any) -> Iterator[Record]:
        index = self._index
        for number, stamp_ns in enumerate(index["pose_stamp_ns"].tolist()):
            topic = topics[str(index["pose_topic"][number]), "pose"]
            covariance = index["pose_covariance"][number]
            pose = Pose(
                stamp_ns,
                str(index["pose_frame_id"][number]),
                str(index["pose_child_frame_id"][number]),
                as_pose(index["pose_matrix"][number], name=f"{self.path}, pose {number}"),
                None if np.isnan(covariance).all() else covariance,
                bool(index["pose_is_static"][number]),
                topic.name,
            )
            yield Record(topic, stamp_ns, decoded(pose))

    def _scan(self, archive: ZipFile, number: int | None) -> list[Message]:
        """The scan of a number, or of a file that is one scan; every shape and dtype checked."""
        index, is_bare = self._index, number is None
        place = str(self.path) if is_bare else f"{self.path}, scan {number}"
        prefix = "" if is_bare else f"scan_{number:06d}_"
        with reading(place):
            fields = {
                name: self._array(archive, prefix + name)
                for name in ("points", *OPTIONAL)
                if prefix + name in self._names
            }
            stamp_ns, frame_id, topic = (
                (0, "lidar", "points")
                if is_bare
                else (
                    int(index["scan_stamp_ns"][number]),
                    str(index["scan_frame_id"][number]),
                    str(index["scan_topic"][number]),
                )
            )
            rows = len(as_points(fields["points"]))
            known: dict[str, Any] = {
                name: as_rows(fields[name], name=name, rows=rows, shape=shape, dtype=dtype)
                for name, (shape, dtype) in _ROWS.items()
                if name in fields
            }
            if "no_return" in fields:
                known["no_return"] = as_mask(fields["no_return"], name="no_return", rows=rows)
            points = np.ascontiguousarray(fields["points"], np.float32)
            if points.ndim not in (2, 3):
                raise InputError(f"points: expected shape (N, 3) or (H, W, 3), got {points.shape}")
            return [Scan(stamp_ns, points, frame_id, topic=topic, **known)]

    def _laser(self, archive: ZipFile, number: int) -> list[Message]:
        prefix = f"laser_{number:06d}_"
        place = f"{self.path}, 2D scan {number}"
        with reading(place):
            ranges = as_rows(
                self._array(archive, f"{prefix}ranges"),
                name="ranges",
                rows=None,
                shape=(),
                dtype=np.float32,
            )
            intensity = None
            if f"{prefix}intensity" in self._names:
                values = self._array(archive, f"{prefix}intensity")
                intensity = as_rows(
                    values, name="intensity", rows=len(ranges), shape=(), dtype=np.float32
                )
            index = self._index
            return [
                LaserScan(
                    stamp_ns=int(index["laser_stamp_ns"][number]),
                    ranges=ranges,
                    frame_id=str(index["laser_frame_id"][number]),
                    intensity=intensity,
                    time_increment_ns=int(index["laser_time_increment_ns"][number]),
                    topic=str(index["laser_topic"][number]),
                    **dict(zip(SCANNER, index["laser_scanner"][number].tolist(), strict=True)),
                )
            ]

    def _read_index(self, archive: ZipFile) -> dict[str, NDArray[Any]]:
        layout = int(self._array(archive, "layout").item())
        if layout != LAYOUT:
            raise FormatError(f"{self.path}: layout {layout}, this version reads {LAYOUT}")
        names = [
            "scan_stamp_ns",
            "scan_frame_id",
            "scan_topic",
            "pose_stamp_ns",
            "pose_frame_id",
            "pose_child_frame_id",
            "pose_topic",
            "pose_matrix",
            "pose_is_static",
            "pose_covariance",
        ]
        if "laser_stamp_ns" in self._names:
            names += [
                "laser_stamp_ns",
                "laser_frame_id",
                "laser_topic",
                "laser_scanner",
                "laser_time_increment_ns",
            ]
        index = {name: self._array(archive, name) for name in names}
        for prefix in ("scan", "laser", "pose"):
            lengths = {name: len(a) for name, a in index.items() if name.startswith(prefix)}
            if len(set(lengths.values())) > 1:
                raise FormatError(f"{self.path}: arrays of unequal length: {lengths}")
        return index
