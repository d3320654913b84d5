"""Decoder of the packets of Livox Mid-360 and HAP, which are collected to clouds.

Layout: Livox SDK 2 communication protocol, "Point cloud data".
"""

import struct
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidar_core.errors import FormatError
from lidar_core.io.files.guard import check_size
from lidar_core.io.messages.cloud import CloudDecoder
from lidar_core.io.options import NS, ReadOptions
from lidar_core.io.records import Findings, Topic
from lidar_core.messages import Scan

TOPIC = "livox"
_HEAD = struct.Struct("<BHHHHBBB12xIQ")
_IMU, _HIGH, _LOW, _SPHERICAL = 0, 1, 2, 3
_TENTH_US = 100  # nanoseconds of the unit of time intervals
_END = [("reflectivity", "u1"), ("tag", "u1")]
_LAYOUTS = {
    _HIGH: np.dtype([("xyz", "<i4", (3,)), *_END]),
    _LOW: np.dtype([("xyz", "<i2", (3,)), *_END]),
    _SPHERICAL: np.dtype([("range", "<u4"), ("zenith", "<u2"), ("azimuth", "<u2"), *_END]),
}
_METRES = {_HIGH: 1e-3, _LOW: 1e-2, _SPHERICAL: 1e-3}
_ROWS = np.dtype(
    [(axis, "f4") for axis in "xyz"]
    + [("offset_time", "u4"), ("reflectivity", "u1"), ("tag", "u1")]
)


class _Part(NamedTuple):
    """Points of one packet, and the time of the first [ns]."""

    stamp_ns: int
    rows: NDArray[Any]


class LivoxStream:
    """Decoder of packets as they arrive over the network; one scan every 1 / `scan_rate` [s].

    Attributes
    ----------
    topic : Topic
        Topic of its scans.
    """

    def __init__(self, options: ReadOptions, findings: Findings) -> None:
        self.topic = Topic(TOPIC, "livox packets", "scan")
        self._options = options
        self._period_ns = round(NS / options.scan_rate)
        self._decoder = CloudDecoder(TOPIC, options, findings)
        self._parts: list[_Part] = []

    def scan(self, stamp_ns: int, packet: bytes, *, place: str) -> Scan | None:
        """Scan that this packet completes, if it does.

        Raises
        ------
        FormatError
            The bytes are no packet of points of Livox.
        LimitError
            A scan of more than `max_points` points.
        """
        del stamp_ns  # the sensor's own is better
        part = _decode(packet, place)
        if part is None:
            return None
        done = None
        if self._parts and not 0 <= part.stamp_ns - self._parts[0].stamp_ns < self._period_ns:
            done = self._cloud(place)
        self._parts.append(part)
        count = sum(len(one.rows) for one in self._parts)
        limit = self._options.max_points
        check_size(place, count, limit=limit, key="max_points", what="a scan of points")
        return done

    def _cloud(self, place: str) -> Scan:
        parts, self._parts = sorted(self._parts, key=lambda one: one.stamp_ns), []
        begin_ns = parts[0].stamp_ns
        for stamp_ns, rows in parts:
            rows["offset_time"] += np.uint32(stamp_ns - begin_ns)
        rows = np.concatenate([part.rows for part in parts])
        return self._decoder.scan(rows, begin_ns, TOPIC, place=place)


def _decode(packet: bytes, place: str) -> _Part | None:
    """Return the points of a packet; None for a packet of the IMU."""
    if len(packet) < _HEAD.size:
        raise FormatError(f"{place}: {len(packet)} bytes are not a packet of a Mid-360 or HAP")
    _, length, interval, count, _, _, kind, _, _, stamp_ns = _HEAD.unpack_from(packet)
    if kind == _IMU and length == len(packet):
        return None
    layout = _LAYOUTS.get(kind)
    if layout is None or length != len(packet) or length != _HEAD.size + count * layout.itemsize:
        raise FormatError(
            f"{place}: a packet of {len(packet)} bytes with {count} points of kind {kind} is not"
            " from a Mid-360 or HAP; older Livox sensors need their driver"
        )
    stored = np.frombuffer(packet, layout, count, _HEAD.size)
    rows = np.zeros(count, _ROWS)
    for axis, values in zip("xyz", _coordinates(stored, kind), strict=True):
        rows[axis] = values
    rows["reflectivity"], rows["tag"] = stored["reflectivity"], stored["tag"]
    rows["offset_time"] = np.arange(count) * interval * _TENTH_US // max(count, 1)
    return _Part(stamp_ns, rows)


def _coordinates(stored: NDArray[Any], kind: int) -> NDArray[np.float64]:
    """Return x, y and z [m] of the stored points as three rows."""
    if kind != _SPHERICAL:
        return stored["xyz"].T * _METRES[kind]
    distance = stored["range"] * _METRES[kind]
    zenith, azimuth = (np.radians(stored[name] * 1e-2) for name in ("zenith", "azimuth"))
    level = distance * np.sin(zenith)
    return np.stack([level * np.cos(azimuth), level * np.sin(azimuth), distance * np.cos(zenith)])
