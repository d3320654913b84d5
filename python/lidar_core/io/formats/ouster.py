"""Ouster captures and OSF files."""

from collections.abc import Iterator
from pathlib import Path

from lidar_core.errors import FormatError
from lidar_core.io.files.pcap import packet_sizes
from lidar_core.io.files.udp import datagrams
from lidar_core.io.options import ReadOptions
from lidar_core.io.ouster.frames import (
    NO_RETURN,
    POINT_TIME,
    SENSOR_FRAME,
    poses_of,
    scan_of,
    told_returns,
)
from lidar_core.io.ouster.osf import OsfFile
from lidar_core.io.ouster.packets import Frame, FrameCollector, PacketLayout
from lidar_core.io.ouster.sensor import MOST_METADATA_BYTES, Sensor, read_sensor
from lidar_core.io.readers import register_reader
from lidar_core.io.recording import Recording
from lidar_core.io.records import Record, Topic, decoded

SENSOR_KEY = b'"beam_altitude_angles"'


def is_ouster_capture(path: Path, options: ReadOptions) -> bool:
    """Return whether the JSON file of a sensor was named, or is beside a capture."""
    packet_sizes(path)  # refuses what is no capture
    return options.metadata is not None or metadata_beside(path) is not None


def metadata_beside(path: Path) -> Path | None:
    """Return the JSON file of a capture: its name begins the name of the capture."""
    names = [
        file
        for file in path.parent.glob("*.json")
        if path.stem.startswith(file.stem)
        and file.is_file()  # a pipe or a device has no end
        and file.stat().st_size <= MOST_METADATA_BYTES
        and SENSOR_KEY in file.read_bytes()
    ]
    return max(names, key=lambda file: len(file.stem), default=None)


class _OusterFrames(Recording):
    """Base of captures and OSF files: frames become scans and poses."""

    _sensors: list[Sensor]

    def topics(self) -> list[Topic]:
        """Return one stream per sensor."""
        return self._topics

    def records(self, kinds: frozenset[str] | None = None) -> Iterator[Record]:
        """Yield one record per frame."""
        if kinds is not None and not kinds & {"scan", "scan+pose"}:
            return
        for number, frame in self._frames():
            topic, sensor = self._topics[number], self._sensors[number]
            frame_id = SENSOR_FRAME if len(self._sensors) == 1 else f"{SENSOR_FRAME}_{number}"
            scan = scan_of(
                sensor,
                frame,
                topic=topic.name,
                frame_id=frame_id,
                destagger=self.options.destagger,
            )
            if frame.returns > 1:
                self.findings.note(f"{topic.name}: {told_returns(frame)}")
            if scan is not None:
                poses = poses_of(sensor, frame, topic=topic.name, frame_id=frame_id)
                yield Record(topic, scan.stamp_ns, decoded(*poses, scan))

    def _frames(self) -> Iterator[tuple[int, Frame]]:
        """Frames with the number of their sensor, in time order."""
        raise NotImplementedError

    def _set_sensors(self, sensors: list[Sensor]) -> None:
        self._sensors = sensors
        self._topics = []
        for number, sensor in enumerate(sensors):
            name = "ouster" if len(sensors) == 1 else f"ouster/{number}"
            size = f"{sensor.product}, {sensor.rows} x {sensor.columns}"
            self._topics.append(Topic(name, size, "scan+pose"))
            self.findings.no_return[name] = NO_RETURN
            self.findings.point_time[name] = POINT_TIME


@register_reader(
    "Ouster packets",
    [".pcap", ".pcapng"],
    sniff=is_ouster_capture,
    note="captures with the sensor's .json",
)
class OusterRecording(_OusterFrames):
    """A packet capture with the JSON file of its sensor."""

    format = "Ouster packets"

    def __init__(self, path: Path, options: ReadOptions) -> None:
        super().__init__(path, options)
        packet_sizes(path, on_cut=self.findings.note)  # refuses what is damaged
        beside = Path(options.metadata) if options.metadata is not None else metadata_beside(path)
        if beside is None:
            raise FormatError(f"{path}: name the sensor's JSON file with metadata=FILE")
        sensor = read_sensor(beside, max_points=options.max_points)
        self._layout = PacketLayout(sensor, str(beside), is_second=options.returns == "second")
        self._set_sensors([sensor])
        self._sender = self._find_sender(beside)

    def _frames(self) -> Iterator[tuple[int, Frame]]:
        collector = FrameCollector(self._layout)
        for packet in datagrams(self.path):
            if (packet.source, packet.port) == self._sender and self._layout.is_lidar(packet.data):
                for frame in collector.add(packet.data):
                    yield 0, frame
        for frame in collector.rest():
            yield 0, frame
        if collector.late:
            self.findings.note(f"ouster: {collector.late} packets came late and were dropped")

    def _find_sender(self, metadata: Path) -> tuple[bytes, int]:
        """Return address and port of the sensor whose packets are read.

        A capture may contain several sensors. Then it is the one whose packets have the serial
        number of the JSON file, or are sent to its port; else the first.
        """
        sensor, layout = self._sensors[0], self._layout
        senders: dict[tuple[bytes, int], int | None] = {}
        sizes: dict[int, int] = {}
        for packet in datagrams(self.path):
            sizes[len(packet.data)] = sizes.get(len(packet.data), 0) + 1
            if layout.is_lidar(packet.data):
                senders.setdefault((packet.source, packet.port), layout.serial(packet.data))
        if not senders:
            listed = ", ".join(f"{count} of {size}" for size, count in sorted(sizes.items())[-3:])
            raise FormatError(
                f"{self.path}: no packets of {layout.size} bytes, which {metadata} describes"
                f" ({sensor.profile}, {sensor.rows} rows); there are (number of bytes:"
                f" {listed or 'none'}). Name the JSON file of this sensor with metadata=FILE"
            )
        known = [one for one, serial in senders.items() if serial == sensor.serial is not None]
        ported = [one for one in senders if one[1] == sensor.port]
        chosen = next(iter(known or ported or senders))
        if len(senders) > 1:
            self.findings.note(f"ouster: packets of {len(senders)} sensors, one of them is read")
        serial = senders[chosen]
        if None not in (serial, sensor.serial) and serial != sensor.serial:
            self.findings.note(
                f"ouster: the packets are of sensor {serial}, {metadata.name} of {sensor.serial}"
            )
        return chosen


@register_reader("Ouster OSF", [".osf"])
class OsfRecording(_OusterFrames):
    """An OSF file."""

    format = "Ouster OSF"

    def __init__(self, path: Path, options: ReadOptions) -> None:
        super().__init__(path, options)
        self._file = OsfFile(
            path, max_points=options.max_points, is_second=options.returns == "second"
        )
        self._set_sensors(self._file.sensors)

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _frames(self) -> Iterator[tuple[int, Frame]]:
        is_empty = True
        for item in self._file.frames():
            is_empty = False
            yield item
        if is_empty:
            raise FormatError(f"{self.path}: no frame can be read; the file is damaged")
