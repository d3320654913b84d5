"""Writer of numbered objects to ROS recordings, for packages that avoid obstacles."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any
from uuid import UUID

import numpy as np
from numpy.typing import NDArray

from lidar_core.io.messages.ros_types import (
    COSTMAP_TYPES,
    DETECTIONS_TYPE,
    DYNAMIC_TYPE,
    OBSTACLES_TYPE,
)
from lidar_core.io.write.objects import SCORE, RunObjects, Steps
from lidar_core.io.write.ros import RosMessages, RosWriter
from lidar_core.io.writers import register_writer
from lidar_core.objects import Objects

TOPICS = {
    DETECTIONS_TYPE: "/detections",
    OBSTACLES_TYPE: "/obstacles",
    DYNAMIC_TYPE: "/dynamic_obstacles",
    COSTMAP_TYPES[1]: "/costmap_obstacles",
    COSTMAP_TYPES[2]: "/costmap_obstacles",
}
"""Where each type of message goes."""


NO_SEGMENTS = np.empty((0, 2, 3))


@register_writer("obstacles of ROS 1; ROS 2 as a folder", [".bag", ""], "io", takes="objects")
def write_run(path: Path, objects: RunObjects) -> list[str]:
    """Write the objects of a run; returns the topics."""
    return write_ros_objects(
        path,
        objects.steps,
        frame_id=objects.frame_id,
        name=objects.name,
        segments=objects.segments,
    )


def write_ros_objects(
    path: str | Path,
    steps: Steps,
    *,
    frame_id: str,
    name: str,
    segments: Mapping[int, NDArray[np.float64]] | None = None,
) -> list[str]:
    """Write objects to a ROS 1 bag (.bag) or to the new folder of a ROS 2 recording.

    A message of every type and time: vision_msgs/Detection3DArray, obstacle_detector/Obstacles,
    costmap_converter's obstacles and, in ROS 2, nav2_dynamic_msgs/ObstacleArray.

    Parameters
    ----------
    path : str or Path
        Bag or folder, as for `RosWriter`.
    steps : iterable of (int, Objects)
        All processed times [ns], also those without objects.
    frame_id : str
        Frame of the objects.
    name : str
        Class of all objects; ROS 1 has no place for it.
    segments : mapping of int to ndarray, optional
        Walls by the times of the steps, both ends (S, 2, 3) [m]: for obstacle_detector.

    Returns
    -------
    topics : list of str
        Topics that were written.
    """
    with RosWriter(path) as writer:
        arrays = ObstacleArrays(writer.messages, frame_id=frame_id, name=name)
        for stamp_ns, objects in steps:
            walls = NO_SEGMENTS if segments is None else segments.get(stamp_ns, NO_SEGMENTS)
            for message in arrays.of(stamp_ns, objects, walls):
                writer.write_message(TOPICS[message.__msgtype__], message, stamp_ns)
    return sorted({TOPICS[kind] for kind in arrays.kinds})


class ObstacleArrays:
    """Builder of the messages of every type about the objects at one time.

    Parameters
    ----------
    messages : RosMessages
        Messages of ROS 1 or ROS 2.
    frame_id, name : str
        Names as in `write_ros_objects`.

    Attributes
    ----------
    kinds : tuple of str
        Types of the messages.
    """

    def __init__(self, messages: RosMessages, *, frame_id: str, name: str) -> None:
        self._messages, self._types = messages, messages.types
        self._frame_id, self._name = frame_id, name
        version = messages.version
        detection = self._detection1 if version == 1 else self._detection2
        self._makers: dict[str, Callable[[Any, Objects, int], Any]] = {
            DETECTIONS_TYPE: detection,
            COSTMAP_TYPES[version]: self._costmap,
        }
        if version == 2:
            self._makers[DYNAMIC_TYPE] = self._dynamic
        self.kinds = (OBSTACLES_TYPE, *self._makers)

    def of(
        self, stamp_ns: int, objects: Objects, segments: NDArray[np.float64] = NO_SEGMENTS
    ) -> list[Any]:
        """Return one message of every type about the objects and walls at one time."""
        return [self.message(kind, stamp_ns, objects, segments) for kind in self.kinds]

    def message(
        self,
        kind: str,
        stamp_ns: int,
        objects: Objects,
        segments: NDArray[np.float64] = NO_SEGMENTS,
    ) -> Any:
        """Return the message of type `kind` about the objects and, if the type has them, walls."""
        self._messages.check_stamp(stamp_ns)
        header = self._messages.header(stamp_ns, self._frame_id)
        rows = range(len(objects.id))
        if kind == OBSTACLES_TYPE:
            walls = [self._segment(ends) for ends in segments]
            return self._types[kind](header, walls, [self._circle(objects, row) for row in rows])
        make = self._makers[kind]
        return self._types[kind](header, [make(header, objects, row) for row in rows])

    def odometry(
        self, stamp_ns: int, objects: Objects, covariance: NDArray[np.float64]
    ) -> list[Any]:
        """Return a nav_msgs/Odometry for each object, with the child frame track_NUMBER.

        The child frame has the axes of the objects' frame, so that twists are velocities in it.

        Parameters
        ----------
        stamp_ns : int
            Time of the objects [ns].
        objects : Objects
            One row each.
        covariance : ndarray, shape (K, 6, 6), float64
            Covariance of position and velocity.
        """
        header = self._messages.header(stamp_ns, self._frame_id)
        zero = self._vector(np.zeros(3))
        found = []
        for row, number in enumerate(objects.id.tolist()):
            twist = self._types["geometry_msgs/msg/TwistWithCovariance"](
                self._types["geometry_msgs/msg/Twist"](self._vector(objects.velocity[row]), zero),
                _six(covariance[row, 3:, 3:]),
            )
            pose = self._known_pose(objects, row, covariance[row, :3, :3])
            found.append(
                self._types["nav_msgs/msg/Odometry"](header, f"track_{number}", pose, twist)
            )
        return found

    def _detection2(self, header: Any, objects: Objects, row: int) -> Any:
        meant = self._types["vision_msgs/msg/ObjectHypothesis"](self._name, SCORE)
        return self._types["vision_msgs/msg/Detection3D"](
            header,
            [self._hypothesis(objects, row, meant)],
            self._box(objects, row),
            str(int(objects.id[row])),
        )

    def _detection1(self, header: Any, objects: Objects, row: int) -> Any:
        """Return the ROS 1 Detection3D of an object, whose hypothesis has the object's ID."""
        cloud = self._types["sensor_msgs/msg/PointCloud2"](
            header=header,
            height=0,
            width=0,
            fields=[],
            is_bigendian=False,
            point_step=0,
            row_step=0,
            data=np.empty(0, np.uint8),
            is_dense=True,
        )
        found = self._hypothesis(objects, row, int(objects.id[row]), SCORE)
        return self._types["vision_msgs/msg/Detection3D"](
            header, [found], self._box(objects, row), cloud
        )

    def _hypothesis(self, objects: Objects, row: int, *meant: Any) -> Any:
        pose = self._known_pose(objects, row, objects.covariance[row])
        return self._types["vision_msgs/msg/ObjectHypothesisWithPose"](*meant, pose)

    def _box(self, objects: Objects, row: int) -> Any:
        return self._types["vision_msgs/msg/BoundingBox3D"](
            self._pose(objects, row), self._vector(objects.size[row])
        )

    def _segment(self, ends: NDArray[np.float64]) -> Any:
        return self._types["obstacle_detector/msg/SegmentObstacle"](*map(self._point, ends))

    def _circle(self, objects: Objects, row: int) -> Any:
        radius = float(objects.size[row, :2].max()) / 2
        return self._types["obstacle_detector/msg/CircleObstacle"](
            self._point(objects.position[row]), self._vector(objects.velocity[row]), radius, radius
        )

    def _dynamic(self, header: Any, objects: Objects, row: int) -> Any:
        number = UUID(int=int(objects.id[row])).bytes
        return self._types["nav2_dynamic_msgs/msg/Obstacle"](
            self._types["unique_identifier_msgs/msg/UUID"](np.frombuffer(number, np.uint8)),
            SCORE,
            self._point(objects.position[row]),
            self._vector(objects.velocity[row]),
            self._vector(objects.size[row]),
        )

    def _costmap(self, header: Any, objects: Objects, row: int) -> Any:
        """Return the obstacle: point and radius for circles and unknown sizes, else the box."""
        package = COSTMAP_TYPES[self._messages.version].partition("/")[0]
        length, width, height = objects.size[row].tolist()
        is_circle = height == 0 and length == width
        signs = [(0, 0)] if is_circle else [(1, 1), (-1, 1), (-1, -1), (1, -1)]
        corners = objects.position[row, :2] + np.array(signs) * objects.size[row, :2] / 2
        point = self._types["geometry_msgs/msg/Point32"]
        zero = self._vector(np.zeros(3))
        twist = self._types["geometry_msgs/msg/Twist"](self._vector(objects.velocity[row]), zero)
        return self._types[f"{package}/msg/ObstacleMsg"](
            header=header,
            polygon=self._types["geometry_msgs/msg/Polygon"](
                [point(x, y, 0.0) for x, y in corners.tolist()]
            ),
            radius=length / 2 if is_circle else 0.0,
            id=int(objects.id[row]),
            orientation=self._upright(),
            velocities=self._types["geometry_msgs/msg/TwistWithCovariance"](twist, np.zeros(36)),
        )

    def _known_pose(self, objects: Objects, row: int, covariance: NDArray[np.float64]) -> Any:
        return self._types["geometry_msgs/msg/PoseWithCovariance"](
            self._pose(objects, row), _six(covariance)
        )

    def _pose(self, objects: Objects, row: int) -> Any:
        place = self._point(objects.position[row])
        return self._types["geometry_msgs/msg/Pose"](place, self._upright())

    def _upright(self) -> Any:
        return self._types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)

    def _point(self, place: NDArray[np.float64]) -> Any:
        return self._types["geometry_msgs/msg/Point"](*place.tolist())

    def _vector(self, values: NDArray[np.float64]) -> Any:
        return self._types["geometry_msgs/msg/Vector3"](*values.tolist())


def _six(covariance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Covariance (36,) in the form of ROS: that of x, y, z; zero for the unknown angles."""
    full = np.zeros((6, 6))
    full[:3, :3] = covariance
    return full.reshape(-1)
