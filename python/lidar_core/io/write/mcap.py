"""Writer of MCAP files with Foxglove's messages, for viewers and for `open_recording`."""

import os
from collections.abc import Collection, Iterable, Mapping
from contextlib import suppress
from dataclasses import fields as fields_of
from errno import EIO
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from lidar_core.errors import InputError
from lidar_core.extras import require
from lidar_core.io.files.atomic import WrittenInBlock, check_place, commit, temporary_for
from lidar_core.io.messages.foxglove import FOXGLOVE_TYPES, OWN_CHILD, OWN_HEIGHT, OWN_SCANNER
from lidar_core.io.messages.own_cloud import packed
from lidar_core.io.rotations import quaternion_from_matrix
from lidar_core.io.write.circle_scene import CircleScene
from lidar_core.io.write.item import checked_message
from lidar_core.io.write.topics import (
    LASER_TOPIC,
    POSE_TOPIC,
    SCAN_TOPIC,
    STATIC_TOPIC,
    own_topic,
)
from lidar_core.io.writers import register_writer
from lidar_core.messages import LaserScan, Message, Pose, Scan
from lidar_core.objects import Boxes, CircleElements, ShapeElements

TRACKS_TOPIC, CIRCLES_TOPIC, SHAPES_TOPIC = "/tracks", "/circles", "/shapes"
TRACK_LIFETIME_NS = 500_000_000  # a track that is no longer written disappears from the view
SMALLEST_BOX = 0.1  # a track without extent stays visible [m]
LIVE_CHUNK_BYTES = 256 * 1024  # what a live recording loses at most, if its process is killed
TRACK_COLOUR = (1.0, 0.35, 0.1, 0.8)
NO_METADATA: Mapping[str, str] = {}


class FoxgloveLog:
    """Log of scans, poses, tracks and maps as Foxglove's messages, on channels of one context.

    The files and servers of the context get them. Scans become PointCloud, 2D scans
    LaserScan, poses FrameTransform or, those that are no transforms, PoseInFrame (their covariances
    are not kept), tracks and circle maps SceneUpdate.

    Parameters
    ----------
    context : foxglove.Context
        Made by the caller.
    tracks_frame : str
        Frame that tracks are given in.
    odometry : collection of str
        Topics whose poses are no transforms; poses without child frame never are.
    """

    def __init__(self, context: Any, *, tracks_frame: str, odometry: Collection[str] = ()) -> None:
        purpose = "Foxglove's messages"
        self._messages = require("foxglove.messages", extra="viz", purpose=purpose)
        self._channel_types = require("foxglove.channels", extra="viz", purpose=purpose)
        self._context = context
        self._tracks_frame = tracks_frame
        self._odometry = odometry
        self._channels: dict[tuple[str, ...], Any] = {}

    def write(self, item: Message | Boxes, *, log_time_ns: int | None = None) -> None:
        """Append a scan, a pose or the tracks of one time.

        Parameters
        ----------
        item : Scan, LaserScan, Pose or Tracks
            Message or tracks to write.
        log_time_ns : int, optional
            Time of its arrival [ns], which may differ from its stamp; None: its stamp.

        Raises
        ------
        InputError
            A time before 1970, point times more than two seconds from the scan's stamp, something
            else than these, or a value of another shape or type.
        """
        if not all(hasattr(item, one.name) for one in fields_of(Boxes)):  # any object with these
            item = checked_message(item, also="Tracks")
        _check_stamp(item.stamp_ns)
        log_time = item.stamp_ns if log_time_ns is None else log_time_ns
        if isinstance(item, Scan):
            self._write_scan(item, log_time)
        elif isinstance(item, Pose):
            self._write_pose(item, log_time)
        elif isinstance(item, LaserScan):
            self._write_laser(item, log_time)
        else:
            self._write_tracks(item, log_time)

    def _write_scan(self, scan: Scan, log_time: int) -> None:
        m = self._messages
        rows = packed(scan)
        codes = {code: number for number, code in FOXGLOVE_TYPES.items()}
        numeric = {int(t): t for t in _numeric_types(m.PackedElementFieldNumericType)}
        offsets: Mapping[str, Any] = rows.dtype.fields or {}
        fields = [
            m.PackedElementField(
                name=name, offset=item[1], type=numeric[codes[item[0].str.lstrip("<|")]]
            )
            for name, item in offsets.items()
        ]
        height = scan.points.shape[0] if scan.points.ndim == 3 else 1
        message = m.PointCloud(
            timestamp=self._stamp(scan.stamp_ns),
            frame_id=scan.frame_id,
            pose=m.Pose(position=m.Vector3(), orientation=m.Quaternion(w=1.0)),
            point_stride=rows.dtype.itemsize,
            fields=fields,
            data=rows.tobytes(),
        )
        self._channel("PointCloudChannel", scan.topic or SCAN_TOPIC, {OWN_HEIGHT: str(height)}).log(
            message, log_time=log_time
        )

    def _write_laser(self, scan: LaserScan, log_time: int) -> None:
        m = self._messages
        limits = (scan.angle_increment, scan.range_min, scan.range_max)
        scanner = " ".join([*map(repr, map(float, limits)), str(scan.time_increment_ns)])
        span = scan.angle_increment * (len(scan.ranges) - 1)
        message = m.LaserScan(
            timestamp=self._stamp(scan.stamp_ns),
            frame_id=scan.frame_id,
            pose=m.Pose(position=m.Vector3(), orientation=m.Quaternion(w=1.0)),
            start_angle=scan.angle_min,
            end_angle=scan.angle_min + span,
            ranges=scan.ranges.astype(np.float64).tolist(),
            intensities=[] if scan.intensity is None else scan.intensity.astype(float).tolist(),
        )
        self._channel("LaserScanChannel", scan.topic or LASER_TOPIC, {OWN_SCANNER: scanner}).log(
            message, log_time=log_time
        )

    def _write_pose(self, pose: Pose, log_time: int) -> None:
        m = self._messages
        if (own := own_topic(pose, self._odometry)) is not None:
            position = self._vector(pose.matrix[:3, 3])
            orientation = self._quaternion(quaternion_from_matrix(pose.matrix[:3, :3]))
            place = m.PoseInFrame(
                timestamp=self._stamp(pose.stamp_ns),
                frame_id=pose.frame_id,
                pose=m.Pose(position=position, orientation=orientation),
            )
            child = {OWN_CHILD: pose.child_frame_id} if pose.child_frame_id else NO_METADATA
            self._channel("PoseInFrameChannel", own, child).log(place, log_time=log_time)
            return
        message = m.FrameTransform(
            timestamp=self._stamp(pose.stamp_ns),
            parent_frame_id=pose.frame_id,
            child_frame_id=pose.child_frame_id,
            translation=self._vector(pose.matrix[:3, 3]),
            rotation=self._quaternion(quaternion_from_matrix(pose.matrix[:3, :3])),
        )
        topic = STATIC_TOPIC if pose.is_static else POSE_TOPIC
        self._channel("FrameTransformChannel", topic).log(message, log_time=log_time)

    def _write_tracks(self, tracks: Boxes, log_time: int) -> None:
        m = self._messages
        stamp = self._stamp(tracks.stamp_ns)
        entities = [self._entity(tracks, row, stamp) for row in range(len(tracks.id))]
        self._channel("SceneUpdateChannel", TRACKS_TOPIC).log(
            m.SceneUpdate(entities=entities), log_time=log_time
        )

    def write_circles(self, circles: CircleElements) -> None:
        """Append the elements of a circle map at one time: discs, 2 sigma ellipses, velocities.

        Raises
        ------
        InputError
            A time before 1970.
        """
        scene = self._scene(circles.stamp_ns)
        self._write_scene(CIRCLES_TOPIC, scene.entities(circles), circles.stamp_ns)

    def write_shapes(self, shapes: ShapeElements) -> None:
        """Append the lines, ellipses and rectangles of a map at one time.

        Raises
        ------
        InputError
            A time before 1970.
        """
        scene = self._scene(shapes.stamp_ns)
        self._write_scene(SHAPES_TOPIC, scene.outlines(shapes), shapes.stamp_ns)

    def _scene(self, stamp_ns: int) -> CircleScene:
        _check_stamp(stamp_ns)
        return CircleScene(self._messages, self._stamp(stamp_ns), self._tracks_frame)

    def _write_scene(self, topic: str, entities: list[Any], stamp_ns: int) -> None:
        update = self._messages.SceneUpdate(entities=entities)
        self._channel("SceneUpdateChannel", topic).log(update, log_time=stamp_ns)

    def _entity(self, tracks: Boxes, row: int, stamp: Any) -> Any:
        m = self._messages
        number, size = int(tracks.id[row]), np.maximum(tracks.extent[row], SMALLEST_BOX)
        upright = m.Quaternion(w=1.0)
        colour = m.Color(**dict(zip("rgba", TRACK_COLOUR, strict=True)))
        at = m.Pose(position=self._vector(tracks.position[row]), orientation=upright)
        above = m.Pose(
            position=self._vector(tracks.position[row] + [0, 0, size[2]]), orientation=upright
        )
        speed = float(np.linalg.norm(tracks.velocity[row]))
        label = m.TextPrimitive(
            pose=above,
            billboard=True,
            font_size=14.0,
            scale_invariant=True,
            color=colour,
            text=f"{number}: {speed:.1f} m/s",
        )
        return m.SceneEntity(
            timestamp=stamp,
            frame_id=self._tracks_frame,
            id=str(number),
            lifetime=m.Duration(sec=0, nsec=TRACK_LIFETIME_NS),
            cubes=[m.CubePrimitive(pose=at, size=self._vector(size), color=colour)],
            texts=[label],
        )

    def _channel(self, kind: str, topic: str, metadata: Mapping[str, str] = NO_METADATA) -> Any:
        """Channel of a topic; every combination of metadata has a separate channel."""
        key = (topic, *metadata.values())
        if key not in self._channels:
            self._channels[key] = self._made_channel(kind, topic, metadata)
        return self._channels[key]

    def _made_channel(self, kind: str, topic: str, metadata: Mapping[str, str]) -> Any:
        make = getattr(self._channel_types, kind)
        return make(topic, metadata=dict(metadata), context=self._context)

    def _stamp(self, stamp_ns: int) -> Any:
        seconds, nanoseconds = divmod(int(stamp_ns), 1_000_000_000)
        return self._messages.Timestamp(sec=seconds, nsec=nanoseconds)

    def _vector(self, values: NDArray[np.float64]) -> Any:
        x, y, z = (float(value) for value in values)
        return self._messages.Vector3(x=x, y=y, z=z)

    def _quaternion(self, values: NDArray[np.float64]) -> Any:
        x, y, z, w = (float(value) for value in values)
        return self._messages.Quaternion(x=x, y=y, z=z, w=w)


def partial_path(path: Path) -> Path:
    """Return the temporary path of a file that cannot be computed again, until it is complete."""
    return path.with_suffix(f".partial{path.suffix}")


class McapWriter(FoxgloveLog, WrittenInBlock):
    """Writes scans, poses and tracks as they come; the file appears when it is complete.

    Messages are those of `FoxgloveLog`. Leaving the `with` block completes the file, also on
    Ctrl-C; any other error leaves nothing behind, unless `is_live`.

    Parameters
    ----------
    path : str or Path
        File to write; an older one is replaced when the new one is complete.
    tracks_frame : str
        Frame that tracks are given in.
    is_live : bool
        The items come once, from a robot. They are written to `NAME.partial.mcap` beside `path`,
        which stays there if the process is killed or an error ends the block: recordings opened
        with `recover` read all scans except the last one, or, if scans are smaller than 256 KiB,
        except up to 256 KiB of the last ones. An older partial file is replaced.
    odometry : collection of str
        Topics whose poses are no transforms; poses without child frame never are.

    Raises
    ------
    FileNotFoundError
        The folder of the file is missing.
    FileExistsError
        Another process writes the same live file.
    MissingExtraError
        foxglove-sdk is not installed.
    """

    def __init__(
        self,
        path: str | Path,
        *,
        tracks_frame: str,
        is_live: bool = False,
        odometry: Collection[str] = (),
    ) -> None:
        foxglove = require("foxglove", extra="viz", purpose="writing MCAP")
        super().__init__(foxglove.Context(), tracks_frame=tracks_frame, odometry=odometry)
        self._path, self._is_live = Path(path), is_live
        check_place(self._path)
        self._temporary = partial_path(self._path) if is_live else temporary_for(self._path)
        self._lock = _locked(self._temporary) if is_live else None
        options = {"chunk_size": LIVE_CHUNK_BYTES} if is_live else {}
        try:
            self._writer = foxglove.open_mcap(
                self._temporary,
                allow_overwrite=True,
                context=self._context,
                writer_options=foxglove.mcap.MCAPWriteOptions(**options),
            )
        except OSError as error:  # which names no file
            self._put_away()
            raise self._unwritten(error) from error

    def close(self, *, keep: bool = True) -> None:
        """Complete the file and put it in its place, or drop it; a live one stays a partial file.

        Raises
        ------
        OSError
            The file is not complete; the library reports failed writes only here, if at all.
        """
        try:
            self._writer.close()
            if keep:
                commit(self._temporary, self._path)
        except RuntimeError as error:
            raise self._unwritten(error) from error
        finally:
            self._put_away()

    def _put_away(self) -> None:
        """Remove the temporary file; of a live file, only release the lock."""
        if self._lock is None:
            self._temporary.unlink(missing_ok=True)
        else:
            self._lock.close()

    def _unwritten(self, error: Exception) -> OSError:
        text = f"cannot be written: {error}; is the disk full?"
        return OSError(EIO, text, str(self._path))


@register_writer("Foxglove's messages", [".mcap"], "viz", takes="messages")
def write_mcap(
    path: str | Path, items: Iterable[Message | Boxes], *, tracks_frame: str = "world"
) -> None:
    """Write scans, poses and tracks to one MCAP file atomically.

    Parameters
    ----------
    path : str or Path
        File to write.
    items : iterable of Scan, LaserScan, Pose and Tracks
        Written as they come.
    tracks_frame : str
        Frame that tracks are given in.

    Raises
    ------
    InputError
        An item that `McapWriter.write` refuses.
    MissingExtraError
        foxglove-sdk is not installed.
    """
    with McapWriter(path, tracks_frame=tracks_frame) as writer:
        for item in items:
            writer.write(item)


def _locked(path: Path) -> BinaryIO:
    """Open a new file at `path`, locked while open; an old one is removed if nobody writes it."""
    check_place(path)
    with suppress(FileNotFoundError), path.open("rb") as older:
        _lock(older, path)
    path.unlink(missing_ok=True)
    file = path.open("xb")
    _lock(file, path)
    return file


def _lock(file: BinaryIO, path: Path) -> None:
    if os.name != "posix":
        return
    import fcntl

    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        file.close()
        raise FileExistsError(f"{path}: another process writes this recording") from None


def _check_stamp(stamp_ns: int) -> None:
    if stamp_ns < 0:
        raise InputError(f"stamp_ns: MCAP holds no negative times, got {stamp_ns}")


def _numeric_types(enum: Any) -> list[Any]:
    return [getattr(enum, name) for name in dir(enum) if name[0].isupper() and name != "Unknown"]
