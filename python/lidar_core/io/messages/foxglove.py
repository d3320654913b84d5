"""Decoder of Foxglove's protobuf messages PointCloud, LaserScan, FrameTransform(s), PoseInFrame."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_core.errors import FormatError
from lidar_core.extras import require
from lidar_core.io.files.guard import check_size, reading
from lidar_core.io.messages.cloud import CloudDecoder, Field, Layout, unpack
from lidar_core.io.messages.laser import LaserDecoder
from lidar_core.io.messages.own_cloud import OWN_VERDICT, own_scan
from lidar_core.io.options import ReadOptions
from lidar_core.io.records import Findings, Kind
from lidar_core.io.rotations import pose_matrix, unit_quaternion
from lidar_core.messages import LaserScan, Message, Pose, Scan

CLOUD, LASER, TRANSFORM, TRANSFORMS, POSE_IN_FRAME = (
    "foxglove.PointCloud",
    "foxglove.LaserScan",
    "foxglove.FrameTransform",
    "foxglove.FrameTransforms",
    "foxglove.PoseInFrame",
)
FOXGLOVE_TYPES = {1: "u1", 2: "i1", 3: "u2", 4: "i2", 5: "u4", 6: "i4", 7: "f4", 8: "f8"}
OWN_HEIGHT = "lidar_core_height"
"""Key in the metadata of a channel that `write_mcap` wrote: rows of the organised cloud, or 1."""
OWN_SCANNER = "lidar_core_scanner"
"""Same for 2D scans: angle_increment, range_min, range_max, and time_increment [ns]."""
OWN_CHILD = "lidar_core_child_frame"
"""Same for poses: their child frame, which PoseInFrame does not have."""


def foxglove_kind(type_name: str) -> Kind:
    """Kind of message that this schema is read as."""
    if type_name == CLOUD:
        return "scan"
    if type_name == LASER:
        return "planar"
    return "pose" if type_name in (TRANSFORM, TRANSFORMS, POSE_IN_FRAME) else "other"


class FoxgloveDecoder:
    """Decodes the protobuf messages of one MCAP file, by the schemas in the file."""

    def __init__(self, options: ReadOptions, findings: Findings) -> None:
        self._options = options
        self._findings = findings
        self._parsers: dict[int, Callable[[bytes], Any]] = {}
        self._clouds: dict[str, CloudDecoder] = {}
        self._lasers: dict[str, LaserDecoder] = {}
        self._factory: Any = None

    def decode(
        self, topic: str, schema: Any, metadata: Mapping[str, str], raw: bytes, place: str
    ) -> list[Message]:
        """Scans and poses of one message; none for a schema that is not read.

        Raises
        ------
        FormatError
            The bytes do not follow the schema.
        LimitError
            The message is larger than the options allow.
        """
        if foxglove_kind(schema.name) == "other":
            self._check_size(raw, place)
            return []
        message = self.message(schema, raw, place)
        with reading(place):
            if schema.name == CLOUD:
                return [self._cloud(topic, message, metadata, place)]
            if schema.name == LASER:
                return [self._laser(topic, message, metadata, place)]
            if schema.name == POSE_IN_FRAME:
                return [_pose(topic, message, metadata.get(OWN_CHILD, ""), place)]
            items = message.transforms if schema.name == TRANSFORMS else [message]
            return [_transform(topic, item, place) for item in items]

    def message(self, schema: Any, raw: bytes, place: str) -> Any:
        """Decode one message by its schema; errors as for `decode`."""
        self._check_size(raw, place)
        with reading(place):
            return self._parser(schema)(raw)

    def _check_size(self, raw: bytes, place: str) -> None:
        limit = self._options.max_record_bytes
        check_size(place, len(raw), limit=limit, key="max_record_bytes", what="a message of bytes")

    def _parser(self, schema: Any) -> Callable[[bytes], Any]:
        if schema.id not in self._parsers:
            if self._factory is None:
                module = require("mcap_protobuf.decoder", extra="io", purpose="reading this MCAP")
                self._factory = module.DecoderFactory()
            parser = self._factory.decoder_for("protobuf", schema)
            if parser is None:
                raise FormatError(
                    f"schema {schema.name}: expected encoding protobuf, got {schema.encoding!r}"
                )
            self._parsers[schema.id] = parser
        return self._parsers[schema.id]

    def _cloud(self, topic: str, message: Any, metadata: Mapping[str, str], place: str) -> Scan:
        fields = []
        for item in message.fields:
            code = FOXGLOVE_TYPES.get(item.type)
            if code is None:
                raise FormatError(f"{place}: field {item.name!r} has unknown type {item.type}")
            fields.append(Field(item.name, code, item.offset))
        step = message.point_stride
        if step == 0 or len(message.data) % step:
            raise FormatError(
                f"{place}: {len(message.data)} bytes of data do not fit points of {step} bytes"
            )
        count = len(message.data) // step
        layout = Layout(fields, step, count * step, count, 1, is_bigendian=False)
        data = np.frombuffer(message.data, np.uint8)
        rows = unpack(data, layout, place=place, max_points=self._options.max_points).reshape(-1)
        if OWN_HEIGHT in metadata:
            self._findings.point_time[topic] = self._findings.no_return[topic] = OWN_VERDICT
            return own_scan(
                rows,
                _stamp_ns(message.timestamp),
                message.frame_id,
                topic,
                int(metadata[OWN_HEIGHT]),
            )
        if topic not in self._clouds:
            self._clouds[topic] = CloudDecoder(topic, self._options, self._findings)
        return self._clouds[topic].scan(
            rows, _stamp_ns(message.timestamp), message.frame_id, place=place
        )

    def _laser(
        self, topic: str, message: Any, metadata: Mapping[str, str], place: str
    ) -> LaserScan:
        ranges = np.array(message.ranges, np.float32)
        steps = max(len(ranges) - 1, 1)
        increment, nearest, farthest = (
            (message.end_angle - message.start_angle) / steps,
            0.0,
            np.inf,
        )
        time_increment = "0"
        if OWN_SCANNER in metadata:
            *numbers, time_increment = metadata[OWN_SCANNER].split()
            increment, nearest, farthest = (float(number) for number in numbers)
        raw = LaserScan(
            stamp_ns=_stamp_ns(message.timestamp),
            ranges=ranges,
            angle_min=message.start_angle,
            angle_increment=increment,
            range_min=nearest,
            range_max=farthest,
            frame_id=message.frame_id,
            intensity=np.array(message.intensities, np.float32) if message.intensities else None,
            time_increment_ns=int(time_increment),
            topic=topic,
        )
        if OWN_SCANNER in metadata:
            self._findings.point_time[topic] = self._findings.no_return[topic] = OWN_VERDICT
            return raw
        if topic not in self._lasers:
            self._lasers[topic] = LaserDecoder(topic, self._options, self._findings)
        return self._lasers[topic].scan(raw, place=place)


def _transform(topic: str, item: Any, place: str) -> Pose:
    return Pose(
        _stamp_ns(item.timestamp),
        item.parent_frame_id,
        item.child_frame_id,
        _matrix(item.translation, item.rotation, place),
        is_static=topic.rstrip("/").endswith("tf_static"),
        topic=topic,
    )


def _pose(topic: str, item: Any, child_frame_id: str, place: str) -> Pose:
    matrix = _matrix(item.pose.position, item.pose.orientation, place)
    return Pose(_stamp_ns(item.timestamp), item.frame_id, child_frame_id, matrix, topic=topic)


def _matrix(t: Any, r: Any, place: str) -> NDArray[np.float64]:
    quaternion = unit_quaternion(np.array([r.x, r.y, r.z, r.w], np.float64), place=place)
    return pose_matrix(np.array([t.x, t.y, t.z], np.float64), quaternion)


def _stamp_ns(stamp: Any) -> int:
    if isinstance(stamp, int):
        return stamp
    return int(stamp.seconds) * 1_000_000_000 + int(stamp.nanos)
