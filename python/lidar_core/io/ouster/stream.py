"""Decoder of Ouster's packets from the network, and the description of their sensor."""

from pathlib import Path
from urllib.request import ProxyHandler, build_opener

from lidar_core.errors import FormatError, LinkError
from lidar_core.io.options import ReadOptions
from lidar_core.io.ouster.frames import NO_RETURN, POINT_TIME, SENSOR_FRAME, scan_of
from lidar_core.io.ouster.packets import FrameCollector, PacketLayout
from lidar_core.io.ouster.sensor import MOST_METADATA_BYTES, Sensor, parse_sensor, read_sensor
from lidar_core.io.records import Findings, Topic
from lidar_core.messages import Scan

TOPIC, DEFAULT_PORT = "ouster", 7502
METADATA_PATH, PATIENCE_S = "api/v1/sensor/metadata", 5.0


def sensor_at(place: str, options: ReadOptions) -> Sensor:
    """Return the sensor of a JSON file, or the one at an address.

    Raises
    ------
    FormatError
        The file or answer is not the metadata of an Ouster sensor.
    LinkError
        No sensor answers at the address.
    """
    most = options.max_points
    if Path(place).is_file():
        return read_sensor(place, max_points=most)
    address = f"http://{place}/{METADATA_PATH}"
    try:
        # A sensor is on the robot's own network, never behind a proxy.
        with build_opener(ProxyHandler({})).open(address, timeout=PATIENCE_S) as answer:
            text = answer.read(MOST_METADATA_BYTES + 1)
    except (OSError, ValueError) as error:
        raise LinkError(
            f"ouster: {place} is no file, and no sensor answers at {address} ({error}); name the"
            " sensor's address or its JSON file: ouster:FILE.json"
        ) from error
    if len(text) > MOST_METADATA_BYTES:
        raise FormatError(f"{address}: the answer is too large")
    return parse_sensor(text, address, max_points=most)


class RepeatedFrameError(FormatError):
    """A frame of a sensor came again, or after a later one, so it gives no scan."""


class OusterStream:
    """Decoder of packets as they arrive over the network; one scan for every frame.

    Attributes
    ----------
    topic : Topic
        Topic of its scans.
    """

    def __init__(self, sensor: Sensor, options: ReadOptions, findings: Findings) -> None:
        size = f"{sensor.product}, {sensor.rows} x {sensor.columns}"
        self.topic = Topic(TOPIC, size, "scan")
        self._layout = PacketLayout(sensor, "ouster", is_second=options.returns == "second")
        self._collector = FrameCollector(self._layout)
        self._options, self._findings = options, findings
        findings.no_return[TOPIC], findings.point_time[TOPIC] = NO_RETURN, POINT_TIME

    def scan(self, stamp_ns: int, packet: bytes, *, place: str) -> Scan | None:
        """Scan that this packet completes, if it does.

        Raises
        ------
        FormatError
            The bytes are no packet of this sensor.
        RepeatedFrameError
            Most packets of a frame were dropped, up to this one.
        """
        del stamp_ns  # the sensor's own are better
        layout = self._layout
        if not layout.is_lidar(packet):
            raise FormatError(
                f"{place}: {len(packet)} bytes are not a packet of {layout.size} bytes of"
                f" {layout.sensor.profile}: is the JSON file of another sensor or mode?"
            )
        serial, known = layout.serial(packet), layout.sensor.serial
        if serial != known and None not in (serial, known):
            raise FormatError(f"{place}: packets are of sensor {serial}, not of {known}")
        refused = self._collector.refused
        frames = self._collector.add(packet)
        if self._collector.refused > refused:
            raise RepeatedFrameError(
                f"{TOPIC}: frame {layout.frame_number(packet)} came again, or after a later one (a"
                " capture that is sent in a loop, or a second sender)"
            )
        scans = [
            scan_of(
                layout.sensor,
                frame,
                topic=TOPIC,
                frame_id=SENSOR_FRAME,
                destagger=self._options.destagger,
            )
            for frame in frames
        ]
        # Two at once are the rest of a frame that lost packets, and a frame of one packet.
        return next((scan for scan in reversed(scans) if scan is not None), None)
