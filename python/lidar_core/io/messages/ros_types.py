"""Message types that are missing in the stores of rosbags, and stores that contain them.

Fields as the packages define them, checked against the hashes that ROS itself computed.
"""

from functools import cache
from typing import Any

from lidar_core.extras import require

DETECTIONS_TYPE = "vision_msgs/msg/Detection3DArray"
OBSTACLES_TYPE = "obstacle_detector/msg/Obstacles"
DYNAMIC_TYPE = "nav2_dynamic_msgs/msg/ObstacleArray"
COSTMAP_TYPES = {
    1: "costmap_converter/msg/ObstacleArrayMsg",
    2: "costmap_converter_msgs/msg/ObstacleArrayMsg",
}
"""By the version of ROS: the package was renamed."""
RADAR_TRACKS_TYPE, RADAR_SCAN_TYPE = "radar_msgs/msg/RadarTracks", "radar_msgs/msg/RadarScan"
OBJECTS_TYPES = ("zed_msgs/msg/ObjectsStamped", "zed_interfaces/msg/ObjectsStamped")
"""Of a camera's driver, whose package was renamed."""
RELEASES = dict.fromkeys(OBJECTS_TYPES, (OBJECTS_TYPES[0], "zed_msgs_70/msg/ObjectsStamped"))
"""By type, those whose definitions are tried in turn: releases of a package differ."""
VELODYNE_TYPE = "velodyne_msgs/msg/VelodyneScan"
OUSTER_TYPES = (
    "ouster_msgs/msg/PacketMsg",
    "ouster_ros/msg/PacketMsg",
    "ouster_sensor_msgs/msg/PacketMsg",
)
_COSTMAP = (
    "std_msgs/Header header\ngeometry_msgs/Polygon polygon\nfloat64 radius\nint64 id\n"
    "geometry_msgs/Quaternion orientation\ngeometry_msgs/TwistWithCovariance velocities"
)
_RADAR_TRACK = (
    " uuid\ngeometry_msgs/Point position\ngeometry_msgs/Vector3 velocity\n"
    "geometry_msgs/Vector3 acceleration\ngeometry_msgs/Vector3 size\n"
    "uint16 NO_CLASSIFICATION=0\nuint16 STATIC=1\nuint16 DYNAMIC=2\nuint16 classification\n"
    "float32[6] position_covariance\nfloat32[6] velocity_covariance\n"
    "float32[6] acceleration_covariance\nfloat32[6] size_covariance"
)
_OBJECT = (
    "string label\nint16 label_id\nstring sublabel\nfloat32 confidence\nfloat32[3] position\n"
    "float32[6] position_covariance\nfloat32[3] velocity\nbool tracking_available\n"
    "int8 tracking_state\nint8 action_state\n{0}/BoundingBox2Di bounding_box_2d\n"
    "{0}/BoundingBox3D bounding_box_3d\nfloat32[3] dimensions_3d\nbool skeleton_available\n"
    "int8 body_format\n{0}/BoundingBox2Df head_bounding_box_2d\n"
    "{0}/BoundingBox3D head_bounding_box_3d\nfloat32[3] head_position\n"
    "{0}/Skeleton2D skeleton_2d\n{0}/Skeleton3D skeleton_3d"
)
_OBJECTS = {
    "Keypoint2Di": "uint32[2] kp",
    "Keypoint2Df": "float32[2] kp",
    "Keypoint3D": "float32[3] kp",
    "BoundingBox2Di": "{0}/Keypoint2Di[4] corners",
    "BoundingBox2Df": "{0}/Keypoint2Df[4] corners",
    "BoundingBox3D": "{0}/Keypoint3D[8] corners",
    "Skeleton2D": "{0}/Keypoint2Df[70] keypoints",
    "Skeleton3D": "{0}/Keypoint3D[70] keypoints",
    "Object": _OBJECT,
    "ObjectsStamped": "std_msgs/Header header\n{0}/Object[] objects",
}
_BOTH = {
    **{f"zed_msgs/msg/{name}": text.format("zed_msgs") for name, text in _OBJECTS.items()},
    "zed_msgs_70/msg/Object": f"{_OBJECT}\nfloat32[70] skeleton_keypoint_confidence".format(
        "zed_msgs"
    ),
    RELEASES[OBJECTS_TYPES[0]][1]: _OBJECTS["ObjectsStamped"].format("zed_msgs_70"),
    "tf2_msgs/msg/TFMessage": "geometry_msgs/TransformStamped[] transforms",
    "tf/msg/tfMessage": "geometry_msgs/TransformStamped[] transforms",
    "velodyne_msgs/msg/VelodynePacket": "time stamp\nuint8[1206] data",
    VELODYNE_TYPE: "std_msgs/Header header\nvelodyne_msgs/VelodynePacket[] packets",
    **dict.fromkeys(OUSTER_TYPES, "uint8[] buf"),
    "radar_msgs/msg/RadarReturn": (
        "float32 range\nfloat32 azimuth\nfloat32 elevation\n"
        "float32 doppler_velocity\nfloat32 amplitude"
    ),
    RADAR_SCAN_TYPE: "std_msgs/Header header\nradar_msgs/RadarReturn[] returns",
    RADAR_TRACKS_TYPE: "std_msgs/Header header\nradar_msgs/RadarTrack[] tracks",
    "vision_msgs/msg/BoundingBox3D": "geometry_msgs/Pose center\ngeometry_msgs/Vector3 size",
    DETECTIONS_TYPE: "std_msgs/Header header\nvision_msgs/Detection3D[] detections",
    "obstacle_detector/msg/SegmentObstacle": (
        "geometry_msgs/Point first_point\ngeometry_msgs/Point last_point"
    ),
    "obstacle_detector/msg/CircleObstacle": (
        "geometry_msgs/Point center\ngeometry_msgs/Vector3 velocity\n"
        "float64 radius\nfloat64 true_radius"
    ),
    OBSTACLES_TYPE: (
        "std_msgs/Header header\nobstacle_detector/SegmentObstacle[] segments\n"
        "obstacle_detector/CircleObstacle[] circles"
    ),
}
_ROS1 = {
    "uuid_msgs/msg/UniqueID": "uint8[16] uuid",
    "radar_msgs/msg/RadarTrack": f"uuid_msgs/UniqueID{_RADAR_TRACK}",
    "costmap_converter/msg/ObstacleMsg": _COSTMAP,
    COSTMAP_TYPES[1]: "std_msgs/Header header\ncostmap_converter/ObstacleMsg[] obstacles",
    "vision_msgs/msg/ObjectHypothesisWithPose": (
        "int64 id\nfloat64 score\ngeometry_msgs/PoseWithCovariance pose"
    ),
    "vision_msgs/msg/Detection3D": (
        "std_msgs/Header header\nvision_msgs/ObjectHypothesisWithPose[] results\n"
        "vision_msgs/BoundingBox3D bbox\nsensor_msgs/PointCloud2 source_cloud"
    ),
}
_ROS2 = {
    "radar_msgs/msg/RadarTrack": f"unique_identifier_msgs/UUID{_RADAR_TRACK}",
    "costmap_converter_msgs/msg/ObstacleMsg": _COSTMAP,
    COSTMAP_TYPES[2]: "std_msgs/Header header\ncostmap_converter_msgs/ObstacleMsg[] obstacles",
    "vision_msgs/msg/ObjectHypothesis": "string class_id\nfloat64 score",
    "vision_msgs/msg/ObjectHypothesisWithPose": (
        "vision_msgs/ObjectHypothesis hypothesis\ngeometry_msgs/PoseWithCovariance pose"
    ),
    "vision_msgs/msg/Detection3D": (
        "std_msgs/Header header\nvision_msgs/ObjectHypothesisWithPose[] results\n"
        "vision_msgs/BoundingBox3D bbox\nstring id"
    ),
    "nav2_dynamic_msgs/msg/Obstacle": (
        "unique_identifier_msgs/UUID uuid\nfloat32 score\ngeometry_msgs/Point position\n"
        "geometry_msgs/Vector3 velocity\ngeometry_msgs/Vector3 size"
    ),
    DYNAMIC_TYPE: "std_msgs/Header header\nnav2_dynamic_msgs/Obstacle[] obstacles",
}


@cache
def ros_store(version: int) -> Any:
    """Return a store with the messages of all ROS 1 or ROS 2 distributions, and those above.

    Building a store takes 30 ms.
    """
    typesys = require("rosbags.typesys", extra="io", purpose="handling ROS messages")
    store = typesys.Stores.ROS1_NOETIC if version == 1 else typesys.Stores.ROS2_HUMBLE
    types = typesys.get_typestore(store)
    for name, text in {**_BOTH, **(_ROS1 if version == 1 else _ROS2)}.items():
        if name not in types.fielddefs:
            types.register(typesys.get_types_from_msg(text, name))
    return types
