"""Writer of lidar_core's own .npz recordings; the reader documents the layout."""

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any
from zipfile import ZipFile

import numpy as np
from numpy.typing import NDArray

from lidar_core.io.files.atomic import written_whole
from lidar_core.io.formats.npz import LAYOUT, OPTIONAL, SCANNER
from lidar_core.io.write.item import checked_message
from lidar_core.io.writers import register_writer
from lidar_core.messages import LaserScan, Message, Pose, Scan


@register_writer("exact, lidar_core's own", [".npz"], takes="messages")
def write_npz(path: str | Path, messages: Iterable[Message]) -> None:
    """Write scans in 3D and 2D and poses to one .npz recording atomically.

    Parameters
    ----------
    path : str or Path
        File to write; an older one is replaced when the new one is complete.
    messages : iterable of Scan, LaserScan and Pose
        Written as they come: a generator is not gathered in memory.

    Raises
    ------
    InputError
        Something else than a message, or a value of another shape or type.

    Examples
    --------
    >>> write_npz("scans.npz", [Scan(0, np.zeros((3, 3), np.float32))])  # doctest: +SKIP
    """
    scans: list[Scan] = []
    lasers: list[LaserScan] = []
    poses: list[Pose] = []
    with written_whole(path) as temporary, ZipFile(temporary, "w") as archive:
        for item in messages:
            message = checked_message(item)
            if isinstance(message, Pose):
                poses.append(message)
                continue
            if isinstance(message, LaserScan):
                _put_laser(archive, len(lasers), message)
                lasers.append(replace(message, ranges=np.empty(0, np.float32), intensity=None))
                continue
            prefix = f"scan_{len(scans):06d}_"
            for name in ("points", *OPTIONAL):
                value = getattr(message, name)
                if value is not None:
                    _put(archive, prefix + name, value)
            scans.append(
                Scan(
                    message.stamp_ns,
                    np.empty((0, 3), np.float32),
                    message.frame_id,
                    topic=message.topic,
                )
            )
        _put(archive, "layout", np.array(LAYOUT))
        _put(archive, "scan_stamp_ns", np.array([s.stamp_ns for s in scans], np.int64))
        _put(archive, "scan_frame_id", np.array([s.frame_id for s in scans], np.str_))
        _put(archive, "scan_topic", np.array([s.topic for s in scans], np.str_))
        if lasers:
            _put_scanners(archive, lasers)
        _put_poses(archive, poses)


def _put_laser(archive: ZipFile, number: int, scan: LaserScan) -> None:
    _put(archive, f"laser_{number:06d}_ranges", scan.ranges)
    if scan.intensity is not None:
        _put(archive, f"laser_{number:06d}_intensity", scan.intensity)


def _put_scanners(archive: ZipFile, scans: list[LaserScan]) -> None:
    _put(archive, "laser_stamp_ns", np.array([s.stamp_ns for s in scans], np.int64))
    _put(archive, "laser_frame_id", np.array([s.frame_id for s in scans], np.str_))
    _put(archive, "laser_topic", np.array([s.topic for s in scans], np.str_))
    limits = [[getattr(scan, name) for name in SCANNER] for scan in scans]
    _put(archive, "laser_scanner", np.array(limits, np.float64))
    steps = [scan.time_increment_ns for scan in scans]
    _put(archive, "laser_time_increment_ns", np.array(steps, np.int64))


def _put_poses(archive: ZipFile, poses: list[Pose]) -> None:
    unknown = np.full((6, 6), np.nan)
    covariance = [unknown if p.covariance is None else p.covariance for p in poses]
    _put(archive, "pose_stamp_ns", np.array([p.stamp_ns for p in poses], np.int64))
    _put(archive, "pose_frame_id", np.array([p.frame_id for p in poses], np.str_))
    _put(archive, "pose_child_frame_id", np.array([p.child_frame_id for p in poses], np.str_))
    _put(archive, "pose_topic", np.array([p.topic for p in poses], np.str_))
    _put(archive, "pose_matrix", np.array([p.matrix for p in poses]).reshape(-1, 4, 4))
    _put(archive, "pose_is_static", np.array([p.is_static for p in poses], np.bool_))
    _put(archive, "pose_covariance", np.array(covariance, np.float64).reshape(-1, 6, 6))


def _put(archive: ZipFile, name: str, array: NDArray[Any]) -> None:
    with archive.open(f"{name}.npy", "w", force_zip64=True) as stream:
        np.lib.format.write_array(stream, np.ascontiguousarray(array), allow_pickle=False)
