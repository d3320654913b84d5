"""Packet captures of Velodyne sensors."""

from collections.abc import Iterator
from pathlib import Path

from lidar_core.errors import FormatError
from lidar_core.io.files.guard import reading
from lidar_core.io.files.pcap import VELODYNE_BYTES, packet_sizes, readable
from lidar_core.io.messages.velodyne import (
    TOPIC,
    decoder_config,
    revolution,
    state_conventions,
    velodyne_library,
)
from lidar_core.io.options import ReadOptions
from lidar_core.io.readers import register_reader
from lidar_core.io.recording import Recording
from lidar_core.io.records import Record, Topic, decoded


@register_reader("Velodyne packets", [".pcap", ".pcapng"], extra="velodyne")
class VelodyneRecording(Recording):
    """Packet capture of a Velodyne sensor; stamps are those of the capturing computer."""

    format = "Velodyne pcap"

    def __init__(self, path: Path, options: ReadOptions) -> None:
        super().__init__(path, options)
        packets = packet_sizes(path, on_cut=self.findings.note)
        if not packets[VELODYNE_BYTES]:
            sizes = ", ".join(f"{count} of {size}" for size, count in packets.most_common(3))
            raise FormatError(
                f"{path}: packets (number of bytes: {sizes or 'none'}) are not Velodyne's; for"
                " Ouster, put its .json beside the file or name it with metadata=FILE"
            )
        self._library = velodyne_library()
        self._topic = Topic(TOPIC, "velodyne packets", "scan")
        state_conventions(TOPIC, self.findings)

    def topics(self) -> list[Topic]:
        """The sensor's only stream."""
        return [self._topic]

    def records(self, kinds: frozenset[str] | None = None) -> Iterator[Record]:
        """Yield one record per revolution; the first and last are usually incomplete."""
        if kinds is not None and "scan" not in kinds:
            return
        with reading(str(self.path)):
            config = decoder_config(self._library, self.options)
            stored = self._library.read_pcap(readable(self.path), config)
        number = 0
        while True:
            place = f"{self.path}, scan {number}"
            with reading(place):
                item = next(stored, None)
            if item is None:
                return
            stamp_ns = round(item.stamp.host * 1e9)
            scan = revolution(stamp_ns, item.points, TOPIC, "velodyne", self.options, place)
            yield Record(self._topic, scan.stamp_ns, decoded(scan))
            number += 1
