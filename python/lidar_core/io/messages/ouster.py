"""Decoder of Ouster's packets in ROS recordings: their sensors, and scans of their frames."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from functools import partial

from lidar_core.io.messages.ros_types import OUSTER_TYPES
from lidar_core.io.options import ReadOptions
from lidar_core.io.ouster.frames import NO_RETURN, POINT_TIME, SENSOR_FRAME, scan_of, told_returns
from lidar_core.io.ouster.packets import Frame, FrameCollector, PacketLayout
from lidar_core.io.ouster.sensor import Sensor, parse_sensor, read_sensor
from lidar_core.io.records import Findings, Record, Topic
from lidar_core.messages import Message

METADATA_TYPE, METADATA_NAME, IMU_NAME = "std_msgs/msg/String", "metadata", "imu"
MISSING = (
    "Ouster packets without the sensor's metadata: record the topic 'metadata' too, or name the"
    " sensor's JSON file with metadata=FILE"
)

FirstText = Callable[[str], str | None]


def _namespace(topic: str) -> str:
    return topic.rpartition("/")[0]


class OusterTopics:
    """Topics of a recording with packets of known sensors.

    Parameters
    ----------
    topics : iterable of Topic
        All topics of the recording.
    first_text : callable
        Function that returns the first message of a topic of texts; None without messages.
    """

    def __init__(
        self,
        topics: Iterable[Topic],
        first_text: FirstText,
        options: ReadOptions,
        findings: Findings,
        place: str,
    ) -> None:
        self._options, self._findings = options, findings
        self._layouts: dict[str, PacketLayout] = {}
        known = list(topics)
        packets = [one.name for one in known if one.type in OUSTER_TYPES and not _is_imu(one.name)]
        if not packets:
            return
        sensors = self._sensors(known, first_text, place)
        for name in packets:
            sensor = sensors.get(_namespace(name))
            if sensor is None and len(sensors) == 1:
                sensor = next(iter(sensors.values()))
            if sensor is not None:
                self._layouts[name] = PacketLayout(
                    sensor, f"{place}, {name}", is_second=self._options.returns == "second"
                )
                findings.no_return[name], findings.point_time[name] = NO_RETURN, POINT_TIME

    def described(self, topic: Topic) -> Topic:
        """Return `topic` as it is read: as scans if it has packets of a known sensor."""
        if topic.type not in OUSTER_TYPES:
            return topic
        layout = self._layouts.get(topic.name)
        if layout is not None:
            sensor = layout.sensor
            note = f"packets of {sensor.product}, {sensor.rows} x {sensor.columns}"
            return replace(topic, kind="scan", count=None, note=note)
        return topic if _is_imu(topic.name) else replace(topic, note=MISSING)

    def streams(self) -> "OusterStreams":
        """Return a new collection of frames, for one pass over the recording."""
        return OusterStreams(
            {name: FrameCollector(layout) for name, layout in self._layouts.items()}, self._messages
        )

    def _sensors(self, topics: list[Topic], first_text: FirstText, place: str) -> dict[str, Sensor]:
        """Sensors by the namespace of their topics; by "" if the options name the sensor's file."""
        most = self._options.max_points
        if self._options.metadata is not None:
            return {"": read_sensor(self._options.metadata, max_points=most)}
        found = {}
        for topic in topics:
            if topic.type == METADATA_TYPE and topic.name.rpartition("/")[2] == METADATA_NAME:
                text = first_text(topic.name)
                if text is not None:
                    where = f"{place}, {topic.name}"
                    found[_namespace(topic.name)] = parse_sensor(text, where, max_points=most)
        return found

    def _messages(self, topic: str, frame: Frame) -> list[Message]:
        if frame.returns > 1:
            self._findings.note(f"{topic}: {told_returns(frame)}")
        frame_id = SENSOR_FRAME
        if len(self._layouts) > 1:
            frame_id = f"{_namespace(topic).lstrip('/')}/{SENSOR_FRAME}".lstrip("/")
        scan = scan_of(
            self._layouts[topic].sensor,
            frame,
            topic=topic,
            frame_id=frame_id,
            destagger=self._options.destagger,
        )
        return [] if scan is None else [scan]


class OusterStreams:
    """Collector of the frames of all sensors of a recording from their packets."""

    def __init__(
        self,
        collectors: dict[str, FrameCollector],
        messages: Callable[[str, Frame], list[Message]],
    ) -> None:
        self._collectors, self._messages = collectors, messages
        self._begun: dict[str, tuple[Topic, int]] = {}

    def takes(self, topic: str) -> bool:
        """True if a topic carries packets of a known sensor."""
        return topic in self._collectors

    def add(self, topic: Topic, time_ns: int, packet: bytes) -> Iterator[Record]:
        """Yield records of the frames that a packet completes, at the times of their first ones."""
        collector = self._collectors[topic.name]
        if not collector.layout.is_lidar(packet):
            return
        for frame in collector.add(packet):
            yield self._record(topic, self._begun.pop(topic.name, (topic, time_ns))[1], frame)
        if collector.is_open:
            self._begun.setdefault(topic.name, (topic, time_ns))

    def rest(self) -> Iterator[Record]:
        """Yield records of the frames that are incomplete when the recording ends."""
        for name, (topic, time_ns) in self._begun.items():
            for frame in self._collectors[name].rest():
                yield self._record(topic, time_ns, frame)
        self._begun.clear()

    def _record(self, topic: Topic, time_ns: int, frame: Frame) -> Record:
        return Record(topic, time_ns, partial(self._messages, topic.name, frame))


def _is_imu(topic: str) -> bool:
    return IMU_NAME in topic.rpartition("/")[2]
