"""Conversion of scans to the clouds that lidar_core writes (rows of named fields), and back."""

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_core.errors import FormatError, InputError
from lidar_core.messages import Scan

OWN_FIELD = "no_return"
"""Field that no driver writes: 1 for rays that met nothing within range."""
OWN_VERDICT = "as lidar_core wrote it"


def packed(scan: Scan) -> NDArray[Any]:
    """Rows of a scan as one structured array; point times as int32 [ns] from its stamp.

    Raises
    ------
    InputError
        Point times more than two seconds from the stamp.
    """
    columns: dict[str, NDArray[Any]] = {}
    points = scan.points.reshape(-1, 3)
    columns |= {name: points[:, axis] for axis, name in enumerate("xyz")}
    if scan.intensity is not None:
        columns["intensity"] = scan.intensity
    if scan.ring is not None:
        columns["ring"] = scan.ring
    if scan.point_time_ns is not None:
        offset = scan.point_time_ns - scan.stamp_ns
        if offset.size and np.abs(offset).max() > np.iinfo(np.int32).max:
            raise InputError("point_time_ns: expected times within 2.1 s of the scan's stamp")
        columns["t"] = offset.astype(np.int32)
    if scan.no_return is not None:
        columns["no_return"] = scan.no_return.astype(np.uint8)
    if scan.directions is not None:
        columns |= {name: scan.directions[:, axis] for axis, name in enumerate(("dx", "dy", "dz"))}
    little = [(name, column.dtype.newbyteorder("<")) for name, column in columns.items()]
    rows = np.empty(len(points), little)
    for name, column in columns.items():
        rows[name] = column
    return rows


def own_scan(rows: NDArray[Any], stamp_ns: int, frame_id: str, topic: str, height: int) -> Scan:
    """Scan from the fields of `packed`; nothing needs to be detected.

    Raises
    ------
    FormatError
        A field is missing, or has more than one value per point.
    """
    names = [name for name in rows.dtype.names or () if rows[name].ndim == 1]
    wanted = [*"xyz", *(("dx", "dy", "dz") if "dx" in names else ())]
    if missing := [name for name in wanted if name not in names]:
        raise FormatError(
            f"{topic}: no field {', '.join(missing)} of one value per point in a cloud that"
            f" lidar_core wrote; found {', '.join(rows.dtype.names or ())}"
        )
    points = _columns(rows, "xyz")
    if height > 1 and len(points) % height == 0:
        points = points.reshape(height, -1, 3)
    return Scan(
        stamp_ns=stamp_ns,
        points=points,
        frame_id=frame_id,
        no_return=rows["no_return"] != 0 if "no_return" in names else None,
        directions=_columns(rows, ("dx", "dy", "dz")) if "dx" in names else None,
        point_time_ns=rows["t"].astype(np.int64) + stamp_ns if "t" in names else None,
        intensity=np.ascontiguousarray(rows["intensity"]) if "intensity" in names else None,
        ring=np.ascontiguousarray(rows["ring"]) if "ring" in names else None,
        topic=topic,
    )


def _columns(rows: NDArray[Any], names: Iterable[str]) -> NDArray[np.float32]:
    return np.stack([rows[name] for name in names], axis=1).astype(np.float32, copy=False)
