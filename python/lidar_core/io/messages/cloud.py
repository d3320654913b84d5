"""Decoder of PointCloud2 and similar clouds: packed rows of named fields to a scan."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidar_core.errors import FormatError
from lidar_core.io.files.guard import check_size, reading
from lidar_core.io.messages.conventions import NoReturnRule, PointTimeRule
from lidar_core.io.messages.own_cloud import OWN_FIELD, OWN_VERDICT, own_scan
from lidar_core.io.options import ReadOptions
from lidar_core.io.records import Findings
from lidar_core.messages import Scan

INTENSITY_FIELDS = ("intensity", "reflectivity", "i")
RING_FIELDS = ("ring", "channel", "line")
MAX_POINT_BYTES = 65_536
ROS_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}


class Field(NamedTuple):
    """One field of a packed row: numpy type code without byte order, offset [bytes], length."""

    name: str
    code: str
    offset: int
    length: int = 1


class Layout(NamedTuple):
    """Memory layout of the rows: sizes in bytes."""

    fields: Sequence[Field]
    point_step: int
    row_step: int
    width: int
    height: int
    is_bigendian: bool


def unpack(data: NDArray[np.uint8], layout: Layout, *, place: str, max_points: int) -> NDArray[Any]:
    """View packed `data` as a structured array of shape (height, width), without copying.

    Raises
    ------
    FormatError
        Fields that overlap the row's end, or less data than the layout claims.
    LimitError
        More than `max_points` points.
    """
    rows, columns = layout.height, layout.width
    check_size(place, rows * columns, limit=max_points, key="max_points", what="a scan of points")
    dtype = _dtype(layout, place)
    if rows * columns == 0:
        return np.empty((rows, columns), dtype)
    row_step = layout.row_step if rows > 1 else columns * layout.point_step
    used = columns * layout.point_step
    if row_step < used:
        raise FormatError(f"{place}: row_step {row_step}, but {columns} points need {used}")
    needed = (rows - 1) * row_step + used
    if len(data) < needed:
        raise FormatError(f"{place}: {len(data)} bytes of data, but the layout needs {needed}")
    flat = np.ascontiguousarray(data[:needed])
    return np.ndarray(
        (rows, columns), dtype, buffer=flat.data, strides=(row_step, layout.point_step)
    )


def _dtype(layout: Layout, place: str) -> np.dtype[Any]:
    if not 0 < layout.point_step <= MAX_POINT_BYTES:
        raise FormatError(f"{place}: point step of {layout.point_step} bytes")
    order = ">" if layout.is_bigendian else "<"
    names, formats, offsets = [], [], []
    for item in layout.fields:
        code = np.dtype(order + item.code)
        count = max(item.length, 1)  # some drivers write 0 and mean 1, as PCL reads it
        if item.offset < 0 or item.offset + count * code.itemsize > layout.point_step:
            raise FormatError(
                f"{place}: field {item.name!r} at offset {item.offset} ends beyond the point"
                f" step of {layout.point_step} bytes"
            )
        if not item.name or item.name == "_":
            continue  # padding
        if item.name in names:
            raise FormatError(f"{place}: field {item.name!r} appears twice")
        names.append(item.name)
        formats.append(code if count == 1 else np.dtype((code, (count,))))
        offsets.append(item.offset)
    return np.dtype(
        {"names": names, "formats": formats, "offsets": offsets, "itemsize": layout.point_step}
    )


class CloudDecoder:
    """Decoder of the structured rows of one topic to scans, by the conventions detected for it."""

    def __init__(self, topic: str, options: ReadOptions, findings: Findings) -> None:
        self._topic = topic
        self._no_return = NoReturnRule(options)
        self._point_time = PointTimeRule(options)
        self._findings = findings

    def scan(self, rows: NDArray[Any], stamp_ns: int, frame_id: str, *, place: str) -> Scan:
        """Return a scan from a structured array of shape (N,), or (H, W) for an organised cloud.

        Raises
        ------
        FormatError
            x, y or z is missing, or the point times that the options name.
        """
        organised = rows.ndim == 2 and rows.shape[0] > 1
        flat = rows.reshape(-1)
        fields = {name: flat[name] for name in flat.dtype.names or () if flat[name].ndim == 1}
        if OWN_FIELD in fields:
            self._findings.point_time[self._topic] = self._findings.no_return[self._topic] = (
                OWN_VERDICT
            )
            with reading(place):
                return own_scan(
                    flat, stamp_ns, frame_id, self._topic, rows.shape[0] if organised else 1
                )
        points = _coordinates(fields, place)
        no_return = self._no_return.apply(points, organised=organised)
        times = self._point_time.apply(fields, stamp_ns, place)
        self._findings.no_return[self._topic] = self._no_return.verdict
        self._findings.point_time[self._topic] = self._point_time.verdict
        if times is not None and times.size > 0:
            stamp_ns = min(stamp_ns, int(times.min()))
        return Scan(
            stamp_ns=stamp_ns,
            points=points.reshape(*rows.shape, 3) if organised else points,
            frame_id=frame_id,
            no_return=no_return,
            point_time_ns=times,
            intensity=_intensity(fields),
            ring=_ring(fields),
            topic=self._topic,
        )


def _coordinates(fields: dict[str, NDArray[Any]], place: str) -> NDArray[np.float32]:
    missing = [axis for axis in "xyz" if axis not in fields]
    if missing:
        raise FormatError(f"{place}: no field {', '.join(missing)}; found {', '.join(fields)}")
    points = np.empty((len(fields["x"]), 3), np.float32)
    with np.errstate(over="ignore", invalid="ignore"):
        for axis, name in enumerate("xyz"):
            points[:, axis] = fields[name]
    return points


def _intensity(fields: dict[str, NDArray[Any]]) -> NDArray[np.float32] | None:
    for name in INTENSITY_FIELDS:
        if name in fields:
            with np.errstate(over="ignore", invalid="ignore"):
                return fields[name].astype(np.float32)
    return None


def _ring(fields: dict[str, NDArray[Any]]) -> NDArray[np.uint16] | None:
    for name in RING_FIELDS:
        values = fields.get(name)
        if values is None or values.size == 0:
            continue
        if np.issubdtype(values.dtype, np.integer) and values.min() >= 0 and values.max() < 2**16:
            return values.astype(np.uint16)
    return None
