"""Small ROS recordings for tests, written with rosbags."""

import struct
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

ROS1 = get_typestore(Stores.ROS1_NOETIC)
ROS1.register(
    get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage")
)
ROS2 = get_typestore(Stores.ROS2_HUMBLE)
TYPE_CODES = {"i1": 1, "u1": 2, "i2": 3, "u2": 4, "i4": 5, "u4": 6, "f4": 7, "f8": 8}


class Ros:
    """Makes messages of one ROS version; `written` stores them."""

    def __init__(self, version: int) -> None:
        self.version = version
        self.store = ROS1 if version == 1 else ROS2
        self.types = self.store.types

    def header(self, stamp_ns: int, frame_id: str) -> Any:
        time = self.types["builtin_interfaces/msg/Time"](stamp_ns // 10**9, stamp_ns % 10**9)
        if self.version == 1:
            return self.types["std_msgs/msg/Header"](seq=0, stamp=time, frame_id=frame_id)
        return self.types["std_msgs/msg/Header"](stamp=time, frame_id=frame_id)

    def cloud(self, rows: np.ndarray, stamp_ns: int, frame_id: str) -> Any:
        """PointCloud2 of a structured array of shape (N,) or (H, W)."""
        rows = np.atleast_2d(rows)
        fields = [
            self.types["sensor_msgs/msg/PointField"](name, offset, TYPE_CODES[dtype.str[1:]], 1)
            for name, (dtype, offset) in rows.dtype.fields.items()
        ]
        step = rows.dtype.itemsize
        return self.types["sensor_msgs/msg/PointCloud2"](
            header=self.header(stamp_ns, frame_id),
            height=rows.shape[0],
            width=rows.shape[1],
            fields=fields,
            is_bigendian=False,
            point_step=step,
            row_step=step * rows.shape[1],
            data=np.frombuffer(rows.tobytes(), np.uint8),
            is_dense=True,
        )

    def transforms(self, items: Iterable[tuple[int, str, str, Sequence[float]]]) -> Any:
        """TFMessage from (stamp, parent, child, x y z qx qy qz qw)."""
        make = self.types
        result = []
        for stamp_ns, parent, child, values in items:
            transform = make["geometry_msgs/msg/Transform"](
                make["geometry_msgs/msg/Vector3"](*values[:3]),
                make["geometry_msgs/msg/Quaternion"](*values[3:]),
            )
            header = self.header(stamp_ns, parent)
            result.append(make["geometry_msgs/msg/TransformStamped"](header, child, transform))
        return make["tf2_msgs/msg/TFMessage"](result)

    def odometry(self, stamp_ns: int, parent: str, child: str, values: Sequence[float]) -> Any:
        make = self.types
        zero = make["geometry_msgs/msg/Vector3"](0.0, 0.0, 0.0)
        pose = make["geometry_msgs/msg/Pose"](
            make["geometry_msgs/msg/Point"](*values[:3]),
            make["geometry_msgs/msg/Quaternion"](*values[3:]),
        )
        covariance = np.diag([0.01] * 6).reshape(-1)
        return make["nav_msgs/msg/Odometry"](
            self.header(stamp_ns, parent),
            child,
            make["geometry_msgs/msg/PoseWithCovariance"](pose, covariance),
            make["geometry_msgs/msg/TwistWithCovariance"](
                make["geometry_msgs/msg/Twist"](zero, zero), covariance
            ),
        )

    def write(self, path: Path, messages: Iterable[tuple[str, int, Any]], storage: str) -> Path:
        """Store (topic, time, message) as "bag", "sqlite3" or "mcap"."""
        writer = (
            Writer1(path)
            if storage == "bag"
            else Writer2(path, version=9, storage_plugin=StoragePlugin[storage.upper()])
        )
        serialise = self.store.serialize_ros1 if self.version == 1 else self.store.serialize_cdr
        connections: dict[str, Any] = {}
        with writer:
            for topic, time_ns, message in messages:
                name = message.__msgtype__
                if topic not in connections:
                    connections[topic] = writer.add_connection(topic, name, typestore=self.store)
                writer.write(connections[topic], time_ns, bytes(serialise(message, name)))
        return path


def packets_of(capture: Path) -> list[tuple[int, bytes]]:
    """Times [ns] and contents of the Velodyne data packets in a little-endian capture."""
    data, position, found = capture.read_bytes(), 24, []
    while position + 16 <= len(data):
        seconds, micros, size, _ = struct.unpack_from("<IIII", data, position)
        if size == 1248:
            content = data[position + 16 + 42 : position + 16 + size]
            found.append((seconds * 10**9 + micros * 1000, content))
        position += 16 + size
    return found
