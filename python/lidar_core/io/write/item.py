"""Check of the messages that users give to the writers of recordings."""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_core.arrays import as_mask, as_points, as_pose, as_real, as_rows, as_stamp
from lidar_core.errors import InputError
from lidar_core.io.messages.cloud import ROS_TYPES
from lidar_core.messages import LaserScan, Message, Pose, PosedScan, Scan

_KEPT = frozenset(ROS_TYPES.values())
_ROWS: dict[str, tuple[tuple[int, ...], type[Any]]] = {
    "directions": ((3,), np.float32),
    "point_time_ns": ((), np.int64),
    "intensity": ((), np.float32),
    "ring": ((), np.uint16),
}
"""Shape of a row and dtype of what a scan may hold, `no_return` aside."""


def checked_message(item: object, *, also: str = "") -> Message:
    """Return the message of a user with arrays of the shapes that its class documents.

    Arrays keep their dtype, unless clouds cannot store it.

    Parameters
    ----------
    item : object
        Object that the user gave.
    also : str
        Other things that the writer takes, for the error.

    Raises
    ------
    InputError
        The object is no message, or one of its values has another shape or type.
    """
    if isinstance(item, Scan):
        return _checked_scan(item)
    if isinstance(item, LaserScan):
        return _checked_laser(item)
    if isinstance(item, Pose):
        return _checked_pose(item)
    is_posed = isinstance(getattr(item, "posed", None), PosedScan)
    cure = "; its scan is `posed.scan`" if is_posed else ""
    expected = f"Scan, LaserScan, Pose or {also}" if also else "Scan, LaserScan or Pose"
    raise InputError(f"expected {expected}, got {type(item).__name__}{cure}")


def _checked_scan(scan: Scan) -> Scan:
    as_stamp(scan.stamp_ns)
    points = as_real(scan.points, name="points")
    if points.ndim not in (2, 3) or points.shape[-1] != 3:
        points = as_points(points)  # refuses it, with the cure
    rows = points.size // 3
    known: dict[str, Any] = {"points": points.astype(_kept(points, np.float32), copy=False)}
    for name, (shape, dtype) in _ROWS.items():
        value = getattr(scan, name)
        if value is not None:
            array = as_real(value, name=name)
            kept = dtype if name == "point_time_ns" else _kept(array, dtype)
            known[name] = as_rows(array, name=name, rows=rows, shape=shape, dtype=kept)
    if scan.no_return is not None:
        known["no_return"] = as_mask(scan.no_return, name="no_return", rows=rows)
    return replace(scan, **known)


def _checked_laser(scan: LaserScan) -> LaserScan:
    as_stamp(scan.stamp_ns)
    ranges = as_rows(scan.ranges, name="ranges", rows=None, shape=(), dtype=np.float32)
    intensity = scan.intensity
    if intensity is not None:
        rays = len(ranges)
        intensity = as_rows(intensity, name="intensity", rows=rays, shape=(), dtype=np.float32)
    return replace(scan, ranges=ranges, intensity=intensity)


def _checked_pose(pose: Pose) -> Pose:
    at = f"pose of {pose.child_frame_id!r} in {pose.frame_id!r} at {pose.stamp_ns} ns"
    as_stamp(pose.stamp_ns, name=f"{at}: stamp_ns")
    matrix = as_rows(pose.matrix, name=f"{at}: matrix", rows=4, shape=(4,), dtype=np.float64)
    as_pose(matrix, name=f"{at}: matrix")  # readers refuse what is no rigid transform
    covariance = pose.covariance
    if covariance is not None:
        covariance = as_rows(covariance, name="covariance", rows=6, shape=(6,), dtype=np.float64)
    return replace(pose, matrix=matrix, covariance=covariance)


def _kept(array: NDArray[Any], dtype: type[Any]) -> type[Any]:
    """Return the dtype of an array if clouds can store it, else the documented one."""
    kind: type[Any] = array.dtype.type
    return kind if array.dtype.str[1:] in _KEPT else dtype
