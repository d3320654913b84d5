"""Writers of ROS 1 bags and ROS 2 recordings, for `rosbag play` and `ros2 bag play`."""

import shutil
from collections.abc import Collection, Iterable
from pathlib import Path
from typing import Any

import numpy as np

from lidar_core.errors import InputError
from lidar_core.extras import require
from lidar_core.io.files.atomic import WrittenInBlock, check_place, commit, temporary_for
from lidar_core.io.messages.cloud import ROS_TYPES
from lidar_core.io.messages.own_cloud import packed
from lidar_core.io.messages.ros_types import ros_store
from lidar_core.io.rotations import quaternion_from_matrix
from lidar_core.io.write.item import checked_message
from lidar_core.io.write.topics import (
    LASER_TOPIC,
    ODOMETRY_TOPIC,
    POSE_TOPIC,
    SCAN_TOPIC,
    STATIC_TOPIC,
    own_topic,
)
from lidar_core.io.writers import register_writer
from lidar_core.messages import LaserScan, Message, Pose, Scan

__all__ = [
    "LAST_SECOND",
    "RosMessages",
    "RosWriter",
    "write_ros",
]

LAST_SECOND = {1: 2**32 - 1, 2: 2**31 - 1}
"""Of the time stamps of ROS 1 and ROS 2."""


class RosMessages:
    """Scans and poses as messages of ROS 1 or ROS 2.

    Parameters
    ----------
    version : int
        1 or 2.
    odometry : collection of str
        Topics whose poses are no transforms; poses without child frame never are.

    Attributes
    ----------
    store : rosbags.typesys.store.Typestore
        Store that serialises messages.
    types : mapping of str to type
        Messages by their names.
    """

    def __init__(self, version: int, odometry: Collection[str] = ()) -> None:
        self._version, self._topics = version, odometry
        self.store = ros_store(version)
        self.types = self.store.types

    @property
    def version(self) -> int:
        """Version of ROS: 1 or 2."""
        return self._version

    def of(self, item: Message) -> tuple[str, Any]:
        """Return topic and message of a scan or a pose.

        Raises
        ------
        InputError
            ROS cannot represent a time, or point times are more than two seconds from the stamp.
        """
        self.check_stamp(item.stamp_ns)
        if isinstance(item, Scan):
            topic, message = item.topic or SCAN_TOPIC, self._cloud(item)
        elif isinstance(item, LaserScan):
            topic, message = item.topic or LASER_TOPIC, self._laser(item)
        elif item.covariance is not None:
            topic, message = item.topic or ODOMETRY_TOPIC, self._odometry(item)
        elif (own := own_topic(item, self._topics)) is not None:
            of = self._odometry if item.child_frame_id else self._stamped
            topic, message = own, of(item)
        else:
            topic = STATIC_TOPIC if item.is_static else POSE_TOPIC
            message = self._transform(item)
        return topic if topic.startswith("/") else f"/{topic}", message

    def check_stamp(self, stamp_ns: int) -> None:
        """Reject a time that ROS cannot represent."""
        if not 0 <= stamp_ns < (LAST_SECOND[self._version] + 1) * 10**9:
            raise InputError(
                f"stamp_ns: ROS {self._version} holds times from 1970 on to"
                f" {LAST_SECOND[self._version]} s, got {stamp_ns}"
            )

    def packed(self, message: Any) -> bytes:
        """Serialise a message."""
        ros1, cdr = self.store.serialize_ros1, self.store.serialize_cdr
        return bytes((ros1 if self._version == 1 else cdr)(message, message.__msgtype__))

    def _cloud(self, scan: Scan) -> Any:
        rows = packed(scan)
        codes = {code: number for number, code in ROS_TYPES.items()}
        fields = [
            self.types["sensor_msgs/msg/PointField"](name, offset, codes[dtype.str.lstrip("<|")], 1)
            for name, (dtype, offset, *_) in (rows.dtype.fields or {}).items()
        ]
        height = scan.points.shape[0] if scan.points.ndim == 3 else 1
        step = rows.dtype.itemsize
        return self.types["sensor_msgs/msg/PointCloud2"](
            header=self.header(scan.stamp_ns, scan.frame_id),
            height=height,
            width=len(rows) // max(height, 1),
            fields=fields,
            is_bigendian=False,
            point_step=step,
            row_step=step * (len(rows) // max(height, 1)),
            data=np.frombuffer(rows.tobytes(), np.uint8),
            is_dense=bool(np.isfinite(scan.points).all()),
        )

    def _laser(self, scan: LaserScan) -> Any:
        rays = len(scan.ranges)
        intensity = np.empty(0, np.float32) if scan.intensity is None else scan.intensity
        return self.types["sensor_msgs/msg/LaserScan"](
            header=self.header(scan.stamp_ns, scan.frame_id),
            angle_min=scan.angle_min,
            angle_max=scan.angle_min + scan.angle_increment * (rays - 1),
            angle_increment=scan.angle_increment,
            time_increment=scan.time_increment_ns * 1e-9,
            scan_time=scan.time_increment_ns * rays * 1e-9,
            range_min=scan.range_min,
            range_max=scan.range_max,
            ranges=scan.ranges.astype(np.float32),
            intensities=intensity.astype(np.float32),
        )

    def _transform(self, pose: Pose) -> Any:
        make = self.types
        transform = make["geometry_msgs/msg/Transform"](
            make["geometry_msgs/msg/Vector3"](*pose.matrix[:3, 3].tolist()), self._rotation(pose)
        )
        header = self.header(pose.stamp_ns, pose.frame_id)
        stamped = make["geometry_msgs/msg/TransformStamped"](header, pose.child_frame_id, transform)
        return make["tf2_msgs/msg/TFMessage"]([stamped])

    def _place(self, pose: Pose) -> Any:
        make = self.types
        return make["geometry_msgs/msg/Pose"](
            make["geometry_msgs/msg/Point"](*pose.matrix[:3, 3].tolist()), self._rotation(pose)
        )

    def _stamped(self, pose: Pose) -> Any:
        header = self.header(pose.stamp_ns, pose.frame_id)
        return self.types["geometry_msgs/msg/PoseStamped"](header, self._place(pose))

    def _odometry(self, pose: Pose) -> Any:
        make = self.types
        zero, place = make["geometry_msgs/msg/Vector3"](0.0, 0.0, 0.0), self._place(pose)
        given = np.zeros((6, 6)) if pose.covariance is None else pose.covariance
        covariance = np.asarray(given, np.float64).reshape(-1)
        return make["nav_msgs/msg/Odometry"](
            self.header(pose.stamp_ns, pose.frame_id),
            pose.child_frame_id,
            make["geometry_msgs/msg/PoseWithCovariance"](place, covariance),
            make["geometry_msgs/msg/TwistWithCovariance"](
                make["geometry_msgs/msg/Twist"](zero, zero), np.zeros(36)
            ),
        )

    def _rotation(self, pose: Pose) -> Any:
        values = quaternion_from_matrix(pose.matrix[:3, :3]).tolist()
        return self.types["geometry_msgs/msg/Quaternion"](*values)

    def header(self, stamp_ns: int, frame_id: str) -> Any:
        """Return the header of a message."""
        time = self.types["builtin_interfaces/msg/Time"](*divmod(stamp_ns, 10**9))
        sequence = {"seq": 0} if self._version == 1 else {}
        return self.types["std_msgs/msg/Header"](stamp=time, frame_id=frame_id, **sequence)


class RosWriter(WrittenInBlock):
    """Writes scans and poses as they come; the recording appears when it is complete.

    Scans become PointCloud2, 2D scans LaserScan, poses TFMessage; those with a covariance become
    Odometry, and those without child frame PoseStamped. Leaving the `with` block completes the
    recording, also on Ctrl-C; any other error leaves nothing behind.

    Parameters
    ----------
    path : str or Path
        A ROS 1 bag, replaced if it is there, if the name ends in .bag; else the folder of a ROS 2
        recording (MCAP storage), which must not be there.
    odometry : collection of str
        Topics whose poses become Odometry in any case.

    Raises
    ------
    InputError
        The folder exists.
    MissingExtraError
        rosbags is not installed.
    """

    def __init__(self, path: str | Path, *, odometry: Collection[str] = ()) -> None:
        self._path = Path(path)
        self._version = 1 if self._path.suffix.lower() == ".bag" else 2
        if self._version == 2 and self._path.exists():
            raise InputError(f"{self._path}: exists already; a ROS 2 recording is a new folder")
        check_place(self._path)
        self._temporary = temporary_for(self._path)
        self._messages = RosMessages(self._version, odometry)
        self._writer = self._open_writer()
        self._connections: dict[tuple[str, str], Any] = {}
        self._waiting: list[Message] = []
        self._is_started = False

    def write(self, item: Message, *, log_time_ns: int | None = None) -> None:
        """Append a scan or a pose.

        Mountings that come first are stored at the time of the first message that moves, unless
        the time of their arrival is known: their own stamps are often zero.

        Parameters
        ----------
        item : Scan, LaserScan or Pose
            Message to write.
        log_time_ns : int, optional
            Time of its arrival [ns], which may differ from its stamp; None: its stamp.

        Raises
        ------
        InputError
            ROS cannot represent a time, point times are more than two seconds from the stamp, it is
            no message, or a value has another shape or type.
        """
        item = checked_message(item)
        if log_time_ns is None and _is_mounting(item) and not self._is_started:
            self._waiting.append(item)
            return
        time_ns = item.stamp_ns if log_time_ns is None else log_time_ns
        self._start(time_ns)
        self._store_message(item, time_ns)

    @property
    def messages(self) -> RosMessages:
        """Converter of scans and poses to ROS messages."""
        return self._messages

    def close(self, *, keep: bool = True) -> None:
        """Complete the recording and put it in its place, or drop it."""
        try:
            if self._waiting:
                self._start(self._waiting[0].stamp_ns)
            self._writer.close()
            if keep and self._version == 1:
                commit(self._temporary, self._path)
            elif keep:
                self._name_storage()
                self._temporary.rename(self._path)
        finally:
            if self._temporary.is_dir():
                shutil.rmtree(self._temporary)
            self._temporary.unlink(missing_ok=True)

    def _open_writer(self) -> Any:
        module = require(f"rosbags.rosbag{self._version}", extra="io", purpose="writing for ROS")
        if self._version == 1:
            self._temporary.unlink(missing_ok=True)
            writer = module.Writer(self._temporary)
        else:
            storage = module.StoragePlugin.MCAP
            writer = module.Writer(self._temporary, version=9, storage_plugin=storage)
        writer.open()
        return writer

    def _name_storage(self) -> None:
        """Rename the storage file, which rosbags names after the temporary folder."""
        metadata = self._temporary / "metadata.yaml"
        old, new = f"{self._temporary.name}.mcap", f"{self._path.name}.mcap"
        (self._temporary / old).rename(self._temporary / new)
        metadata.write_text(metadata.read_text(encoding="utf-8").replace(old, new), "utf-8")

    def _start(self, stamp_ns: int) -> None:
        waiting, self._waiting, self._is_started = self._waiting, [], True
        for pose in waiting:
            self._store_message(pose, stamp_ns)

    def _store_message(self, item: Message, time_ns: int) -> None:
        self.write_message(*self._messages.of(item), time_ns)

    def write_message(self, topic: str, message: Any, time_ns: int) -> None:
        """Append a message of a type of `lidar_core.io.messages.ros_types`.

        Raises
        ------
        InputError
            ROS cannot represent a time.
        """
        self._messages.check_stamp(time_ns)
        name = message.__msgtype__
        if (topic, name) not in self._connections:
            store = self._messages.store
            added = self._writer.add_connection(topic, name, typestore=store)
            self._connections[topic, name] = added
        raw = self._messages.packed(message)
        self._writer.write(self._connections[topic, name], time_ns, raw)


def _is_mounting(item: Message) -> bool:
    return isinstance(item, Pose) and item.is_static


@register_writer("ROS 1; ROS 2 as a folder", [".bag", ""], "io", takes="messages")
def write_ros(path: str | Path, items: Iterable[Message]) -> None:
    """Write scans and poses to a ROS 1 bag (.bag) or to the folder of a ROS 2 recording.

    Parameters
    ----------
    path : str or Path
        Bag or folder to write, as for `RosWriter`.
    items : iterable of Scan, LaserScan and Pose
        Written as they come.

    Raises
    ------
    InputError
        The folder exists, or an item is one that `RosWriter.write` refuses.
    MissingExtraError
        rosbags is not installed.
    """
    with RosWriter(path) as writer:
        for item in items:
            writer.write(item)


def __dir__() -> list[str]:
    return __all__
