"""Velodyne packets, from captures and from ROS messages, through velodyne-decoder."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_core.errors import ConfigError, FormatError
from lidar_core.extras import require
from lidar_core.io.guard import check_size, reading
from lidar_core.io.options import ReadOptions
from lidar_core.io.pcap import VELODYNE_BYTES, VELODYNE_PAYLOAD, packet_sizes, readable
from lidar_core.io.recording import Findings, Record, Recording, Topic, decoded
from lidar_core.messages import Scan

TOPIC = "velodyne"
NO_RETURN = "none: Velodyne packets leave rays without return out of the cloud"
POINT_TIME = "from the firing sequence, relative to the stamp of the scan's first packet"
X, INTENSITY, TIME, RING = 0, 3, 4, 6  # columns of velodyne-decoder's arrays


class VelodyneRecording(Recording):
    """A packet capture of a Velodyne sensor; stamps are those of the capturing computer."""

    format = "Velodyne pcap"

    def __init__(self, path: Path, options: ReadOptions) -> None:
        super().__init__(path, options)
        self._library = _library()
        packets = packet_sizes(path)
        if not packets[VELODYNE_BYTES]:
            raise FormatError(f"{path}: no Velodyne data packets of {VELODYNE_BYTES} bytes")
        self._topic = Topic(TOPIC, "velodyne packets", "scan")
        _state(TOPIC, self.findings)

    def topics(self) -> list[Topic]:
        """The sensor's only stream."""
        return [self._topic]

    def records(self, kinds: frozenset[str] | None = None) -> Iterator[Record]:
        """One record per revolution; the first and last are usually incomplete."""
        if kinds is not None and "scan" not in kinds:
            return
        with reading(str(self.path)):
            config = _config(self._library, self.options)
            stored = self._library.read_pcap(readable(self.path), config)
        number = 0
        while True:
            place = f"{self.path}, scan {number}"
            with reading(place):
                item = next(stored, None)
            if item is None:
                return
            stamp_ns = round(item.stamp.host * 1e9)
            scan = _scan(stamp_ns, item.points, TOPIC, "velodyne", self.options, place)
            yield Record(self._topic, scan.stamp_ns, decoded(scan))
            number += 1


class PacketDecoder:
    """Decodes ROS messages that hold the packets of one revolution each."""

    def __init__(self, topic: str, options: ReadOptions, findings: Findings) -> None:
        self._library = _library()
        self._topic = topic
        self._options = options
        self._decoder = self._library.ScanDecoder(_config(self._library, options))
        _state(topic, findings)

    def scan(
        self, packets: Sequence[tuple[int, NDArray[np.uint8]]], frame_id: str, *, place: str
    ) -> Scan | None:
        """Scan of one message; None if it holds no packets.

        Raises
        ------
        FormatError
            The bytes are no Velodyne packets of a known model.
        """
        if not packets:
            return None
        with reading(place):
            vector = self._library.PacketVector(
                [
                    self._library.VelodynePacket(stamp_ns * 1e-9, data.tobytes())
                    for stamp_ns, data in packets
                ]
            )
            _, points = self._decoder.decode(vector, False)
        return _scan(packets[0][0], points, self._topic, frame_id, self._options, place)


class PacketStream:
    """Decodes packets as they arrive over the network; a scan for every revolution."""

    def __init__(self, topic: str, frame_id: str, options: ReadOptions, findings: Findings) -> None:
        self._topic, self._frame_id = topic, frame_id
        self._options = options
        self._decoder = _library().StreamDecoder(_config(_library(), options))
        _state(topic, findings)

    def scan(self, stamp_ns: int, packet: bytes, *, place: str) -> Scan | None:
        """Scan that this packet completes, if it does.

        Raises
        ------
        FormatError
            No Velodyne data packet of a known model.
        """
        if len(packet) != VELODYNE_PAYLOAD:
            raise FormatError(
                f"{place}: {len(packet)} bytes, a Velodyne data packet has {VELODYNE_PAYLOAD};"
                " other sensors need their drivers"
            )
        with reading(place):
            done = self._decoder.decode(stamp_ns * 1e-9, packet)
        if done is None:
            return None
        stamp, points = done
        first_ns = round(stamp.host * 1e9)
        return _scan(first_ns, points, self._topic, self._frame_id, self._options, place)


def _library() -> Any:
    return require("velodyne_decoder", extra="velodyne", purpose="reading Velodyne packets")


def _config(library: Any, options: ReadOptions) -> Any:
    config = library.Config(timestamp_first_packet=True)
    if options.velodyne_model is not None:
        models = library.Model.__members__
        if options.velodyne_model not in models:
            raise ConfigError(
                f"velodyne_model: expected one of {', '.join(models)}, got"
                f" {options.velodyne_model!r}"
            )
        config.model = models[options.velodyne_model]
    return config


def _state(topic: str, findings: Findings) -> None:
    findings.no_return[topic] = NO_RETURN
    findings.point_time[topic] = POINT_TIME


def _scan(
    stamp_ns: int, points: Any, topic: str, frame_id: str, options: ReadOptions, place: str
) -> Scan:
    rows = np.asarray(points, np.float32)
    if rows.ndim != 2 or rows.shape[1] <= RING:
        raise FormatError(f"{place}: decoded to shape {rows.shape}")
    check_size(
        place, len(rows), limit=options.max_points, key="max_points", what="a scan of points"
    )
    offsets = np.rint(rows[:, TIME].astype(np.float64) * 1e9).astype(np.int64)
    first = min(int(offsets.min()), 0) if len(rows) else 0
    return Scan(
        stamp_ns=stamp_ns + first,
        points=np.ascontiguousarray(rows[:, X : X + 3]),
        frame_id=frame_id,
        point_time_ns=offsets + stamp_ns,
        intensity=np.ascontiguousarray(rows[:, INTENSITY]),
        ring=rows[:, RING].astype(np.uint16),
        topic=topic,
    )
