"""Decoder of Velodyne packets to scans, through velodyne-decoder."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_core.errors import ConfigError, FormatError
from lidar_core.extras import require
from lidar_core.io.files.guard import check_size, reading
from lidar_core.io.files.pcap import VELODYNE_PAYLOAD
from lidar_core.io.options import ReadOptions
from lidar_core.io.records import Findings, Topic
from lidar_core.messages import Scan

TOPIC = "velodyne"
NO_RETURN = "none: Velodyne packets leave rays without return out of the cloud"
POINT_TIME = "from the firing sequence, relative to the stamp of the scan's first packet"
X, INTENSITY, TIME, RING = 0, 3, 4, 6  # columns of velodyne-decoder's arrays


class PacketDecoder:
    """Decoder of ROS messages with the packets of one revolution each."""

    def __init__(self, topic: str, options: ReadOptions, findings: Findings) -> None:
        self._library = velodyne_library()
        self._topic = topic
        self._options = options
        self._decoder = self._library.ScanDecoder(decoder_config(self._library, options))
        state_conventions(topic, findings)

    def scan(
        self, packets: Sequence[tuple[int, NDArray[np.uint8]]], frame_id: str, *, place: str
    ) -> Scan | None:
        """Scan of one message; None if it holds no packets.

        Raises
        ------
        FormatError
            The bytes are not Velodyne packets of a known model.
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
        return revolution(packets[0][0], points, self._topic, frame_id, self._options, place)


class VelodyneStream:
    """Decoder of packets as they arrive over the network; one scan for every revolution.

    Attributes
    ----------
    topic : Topic
        Topic of its scans.
    """

    def __init__(self, options: ReadOptions, findings: Findings) -> None:
        self.topic = Topic(TOPIC, "velodyne packets", "scan")
        self._options = options
        self._decoder = velodyne_library().StreamDecoder(
            decoder_config(velodyne_library(), options)
        )
        state_conventions(TOPIC, findings)

    def scan(self, stamp_ns: int, packet: bytes, *, place: str) -> Scan | None:
        """Scan that this packet completes, if it does.

        Raises
        ------
        FormatError
            The bytes are no Velodyne data packet of a known model.
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
        return revolution(first_ns, points, TOPIC, TOPIC, self._options, place)


def velodyne_library() -> Any:
    """Import the optional package that decodes packets."""
    return require("velodyne_decoder", extra="velodyne", purpose="reading Velodyne packets")


def decoder_config(library: Any, options: ReadOptions) -> Any:
    """Return the settings of the package; ConfigError for an unknown model."""
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


def state_conventions(topic: str, findings: Findings) -> None:
    """Note the conventions of Velodyne packets for times and rays without return."""
    findings.no_return[topic] = NO_RETURN
    findings.point_time[topic] = POINT_TIME


def revolution(
    stamp_ns: int, points: Any, topic: str, frame_id: str, options: ReadOptions, place: str
) -> Scan:
    """Scan of the decoded points of one revolution."""
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
