"""Decoder of ROS messages to 3D scans, 2D scans and poses.

Message definitions come from rosbags' own stores, never from the file: rosbags compiles
definitions to Python code, and a file must not choose code.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_core.errors import FormatError
from lidar_core.io.files.beginnings import ZSTD
from lidar_core.io.files.compressed import zstd_data
from lidar_core.io.files.guard import check_size, reading
from lidar_core.io.messages.cloud import ROS_TYPES, CloudDecoder, Field, Layout, unpack
from lidar_core.io.messages.laser import LaserDecoder, ros_laser_scan
from lidar_core.io.messages.livox import LIVOX_TYPES, livox_cloud
from lidar_core.io.messages.ros_types import (
    OBJECTS_TYPES,
    RADAR_SCAN_TYPE,
    RADAR_TRACKS_TYPE,
    RELEASES,
    VELODYNE_TYPE,
    ros_store,
)
from lidar_core.io.options import ReadOptions
from lidar_core.io.records import PACKETS, Findings, Kind
from lidar_core.io.rotations import pose_matrix, unit_quaternion
from lidar_core.messages import LaserScan, Message, Pose, Scan

__all__ = [
    "MEASUREMENT_TYPES",
    "PLANAR_TYPES",
    "POSE_TYPES",
    "SCAN_TYPES",
    "TRANSFORM_TYPES",
    "RosDecoder",
    "kind_of",
    "matrix_of",
    "note_of",
    "ros_name",
    "stamp_of",
]

SCAN_TYPES = ("sensor_msgs/msg/PointCloud2", *LIVOX_TYPES)
PLANAR_TYPES = ("sensor_msgs/msg/LaserScan", "sensor_msgs/msg/MultiEchoLaserScan")
TRANSFORM_TYPES = (
    "tf2_msgs/msg/TFMessage",
    "tf/msg/tfMessage",
    "geometry_msgs/msg/TransformStamped",
)
POSE_TYPES = (
    "nav_msgs/msg/Odometry",
    "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/PoseWithCovarianceStamped",
)
POINT_TYPE, IMU_TYPE = "geometry_msgs/msg/PointStamped", "sensor_msgs/msg/Imu"
MEASUREMENT_TYPES = (RADAR_TRACKS_TYPE, RADAR_SCAN_TYPE, POINT_TYPE, IMU_TYPE, *OBJECTS_TYPES)
"""Of targets and of the platform's motion: `lidar_core.fusion.read_bag`."""


def kind_of(type_name: str) -> Kind:
    """Kind of message that this type is read as."""
    if type_name in SCAN_TYPES or type_name == VELODYNE_TYPE:
        return "scan"
    if type_name in PLANAR_TYPES:
        return "planar"
    if type_name in TRANSFORM_TYPES or type_name in POSE_TYPES:
        return "pose"
    if type_name in MEASUREMENT_TYPES:
        return "measurement"
    return "packets" if type_name in PACKETS else "other"


def ros_name(type_name: str) -> str:
    """Convert the name of a type to that of ROS 2, package/msg/Name; ROS 1 has package/Name."""
    package, _, rest = type_name.partition("/")
    return type_name if "/" in rest or not rest else f"{package}/msg/{rest}"


def note_of(type_name: str) -> str:
    """Note for the user about messages of this type; empty without one."""
    if type_name == "sensor_msgs/msg/MultiEchoLaserScan":
        return "the first echo of every ray is read"
    return PACKETS.get(type_name, "")


class RosDecoder:
    """Decodes raw messages of one recording.

    Parameters
    ----------
    version : int
        1 for ROS 1 serialisation, 2 for CDR.
    """

    def __init__(self, version: int, options: ReadOptions, findings: Findings) -> None:
        self._store = ros_store(version)
        self._parse: Callable[[bytes, str], Any] = (
            self._store.deserialize_ros1 if version == 1 else self._store.deserialize_cdr
        )
        self._version = version
        self._options = options
        self._findings = findings
        self._clouds: dict[str, CloudDecoder] = {}
        self._lasers: dict[str, LaserDecoder] = {}
        self._velodyne: dict[str, Any] = {}

    def decode(self, topic: str, type_name: str, raw: bytes, place: str) -> list[Message]:
        """Scans and poses of one message; none for a type that is not read.

        Raises
        ------
        FormatError
            The bytes are not a message of this type.
        LimitError
            The message is larger than the options allow.
        """
        kind = kind_of(type_name)
        if kind not in ("scan", "planar", "pose"):
            self._check_size(raw, place)
            return []
        if kind == "scan":
            return self._in_space(topic, type_name, raw, place)
        message = self.message(type_name, raw, place)
        try:
            if kind == "planar":
                return [self._laser(topic, message, place)]
            return _poses(topic, type_name, message, place)
        except FormatError as error:
            self._findings.rejected[topic] += 1
            self._findings.note(str(error))
            return []

    def message(self, type_name: str, raw: bytes, place: str) -> Any:
        """Decode one message by its type; errors as for `decode`."""
        plain = self._plain(raw, place)
        *others, last = RELEASES.get(type_name, (type_name,))
        for other in others:
            try:
                with reading(place):
                    return self._parse(plain, other)
            except FormatError:
                continue  # of another release: what follows its fields would be left over
        with reading(place):
            return self._parse(plain, last)

    def _plain(self, raw: bytes, place: str) -> bytes:
        """Return a message as ROS serialised it; `ros2 bag record` may have compressed it."""
        self._check_size(raw, place)
        if self._version == 1 or not raw.startswith(ZSTD):
            return raw
        with reading(place):
            return zstd_data(raw, place, self._options.max_record_bytes)

    def _check_size(self, raw: bytes, place: str) -> None:
        limit = self._options.max_record_bytes
        check_size(place, len(raw), limit=limit, key="max_record_bytes", what="a message of bytes")

    def _in_space(self, topic: str, type_name: str, raw: bytes, place: str) -> list[Message]:
        if type_name in LIVOX_TYPES:
            return [self._livox(topic, raw, place)]
        message = self.message(type_name, raw, place)
        if type_name == VELODYNE_TYPE:
            return self._packets(topic, message, place)
        return [self._cloud(topic, message, place)]

    def _cloud(self, topic: str, message: Any, place: str) -> Scan:
        fields = []
        for item in message.fields:
            code = ROS_TYPES.get(item.datatype)
            if code is None:
                raise FormatError(
                    f"{place}: field {item.name!r} has unknown datatype {item.datatype}"
                )
            fields.append(Field(item.name, code, item.offset, item.count))
        layout = Layout(
            fields,
            message.point_step,
            message.row_step,
            message.width,
            message.height,
            bool(message.is_bigendian),
        )
        rows = unpack(message.data, layout, place=place, max_points=self._options.max_points)
        header = message.header
        return self._scan(topic, rows, stamp_of(header.stamp), header.frame_id, place)

    def _livox(self, topic: str, raw: bytes, place: str) -> Scan:
        cloud = livox_cloud(
            self._plain(raw, place), self._version, place=place, max_points=self._options.max_points
        )
        return self._scan(topic, *cloud, place)

    def _scan(
        self, topic: str, rows: NDArray[Any], stamp_ns: int, frame_id: str, place: str
    ) -> Scan:
        if topic not in self._clouds:
            self._clouds[topic] = CloudDecoder(topic, self._options, self._findings)
        return self._clouds[topic].scan(rows, stamp_ns, _frame(frame_id), place=place)

    def _laser(self, topic: str, message: Any, place: str) -> LaserScan:
        if topic not in self._lasers:
            self._lasers[topic] = LaserDecoder(topic, self._options, self._findings)
        header = message.header
        raw = ros_laser_scan(topic, message, stamp_of(header.stamp), _frame(header.frame_id))
        return self._lasers[topic].scan(raw, place=place)

    def _packets(self, topic: str, message: Any, place: str) -> list[Message]:
        from lidar_core.io.messages.velodyne import PacketDecoder

        if topic not in self._velodyne:
            self._velodyne[topic] = PacketDecoder(topic, self._options, self._findings)
        packets = [(stamp_of(item.stamp), item.data) for item in message.packets]
        scan: Scan | None = self._velodyne[topic].scan(
            packets, _frame(message.header.frame_id), place=place
        )
        return [] if scan is None else [scan]


def _poses(topic: str, type_name: str, message: Any, place: str) -> list[Message]:
    if type_name in TRANSFORM_TYPES:
        items = message.transforms if hasattr(message, "transforms") else [message]
        static = topic.rstrip("/").endswith("tf_static")
        return [_transform(topic, item, static, place) for item in items]
    matrix, covariance = matrix_of(message, place)
    return [
        Pose(
            stamp_of(message.header.stamp),
            _frame(message.header.frame_id),
            _frame(getattr(message, "child_frame_id", "")),
            matrix,
            covariance,
            topic=topic,
        )
    ]


def matrix_of(message: Any, place: str) -> tuple[NDArray[np.float64], NDArray[np.float64] | None]:
    """Pose (4, 4) of a message of `POSE_TYPES`, and its covariance (6, 6), None if all zero."""
    inner, covariance = message.pose, None
    if hasattr(inner, "covariance"):
        covariance = np.array(inner.covariance, np.float64).reshape(6, 6)
        inner = inner.pose
    matrix = _matrix(inner.position, inner.orientation, place)
    return matrix, covariance if covariance is not None and covariance.any() else None


def _transform(topic: str, item: Any, static: bool, place: str) -> Pose:
    matrix = _matrix(item.transform.translation, item.transform.rotation, place)
    return Pose(
        stamp_of(item.header.stamp),
        _frame(item.header.frame_id),
        _frame(item.child_frame_id),
        matrix,
        is_static=static,
        topic=topic,
    )


def _matrix(position: Any, rotation: Any, place: str) -> NDArray[np.float64]:
    translation = np.array([position.x, position.y, position.z], np.float64)
    if not np.isfinite(translation).all():
        raise FormatError(f"{place}: position {translation.tolist()} is not finite")
    quaternion = np.array([rotation.x, rotation.y, rotation.z, rotation.w], np.float64)
    return pose_matrix(translation, unit_quaternion(quaternion, place=place))


def stamp_of(stamp: Any) -> int:
    """Convert a time of ROS to nanoseconds."""
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def _frame(name: str) -> str:
    return name.lstrip("/")


def __dir__() -> list[str]:
    return __all__
