"""Message definitions: the hashes that ROS computed of the packages' own files."""

import pytest

pytest.importorskip("rosbags")

from lidar_core.io.messages.ros_types import (
    COSTMAP_TYPES,
    DETECTIONS_TYPE,
    DYNAMIC_TYPE,
    OBSTACLES_TYPE,
    RADAR_SCAN_TYPE,
    RADAR_TRACKS_TYPE,
    ros_store,
)

MD5 = {
    COSTMAP_TYPES[1]: "8a1bdcde72c65ca7d3ce8ebf52d43516",
    DETECTIONS_TYPE: "05c51d9aea1fb4cfdc8effb94f197b6f",
    OBSTACLES_TYPE: "043bbf49c7775f8111e850268dbcf2e3",
    RADAR_SCAN_TYPE: "6dfacef1e665538dbd8e159d5ce7a97a",
    RADAR_TRACKS_TYPE: "d068321616577632690aba69b8985e75",
    "tf2_msgs/msg/TFMessage": "94810edda583a504dfda3829e70d7eec",
}
"""From headers that genmsg wrote."""
RIHS01 = {
    DETECTIONS_TYPE: "793f5eab9595ac1c0da07873cc859db42eae51f0ee76056db8562515d830e018",
    COSTMAP_TYPES[2]: "ec79215656d8d48c5b0f6c922ccdc2ccb4b4f10c4c2871d5044f5444fae3090c",
    "tf2_msgs/msg/TFMessage": "e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087",
}
"""From sources that rosidl wrote."""


@pytest.mark.parametrize("name", MD5)
def test_ros_1_definitions_have_the_hashes_of_their_packages(name):
    assert ros_store(1).generate_msgdef(name, ros_version=1)[1] == MD5[name]


@pytest.mark.parametrize("name", RIHS01)
def test_ros_2_definitions_have_the_hashes_of_their_packages(name):
    assert ros_store(2).hash_rihs01(name) == f"RIHS01_{RIHS01[name]}"


def test_the_type_without_published_hash_has_its_fields_in_order():
    fields = [name for name, _ in ros_store(2).fielddefs["nav2_dynamic_msgs/msg/Obstacle"][1]]
    assert fields == ["uuid", "score", "position", "velocity", "size"]
    assert DYNAMIC_TYPE in ros_store(2).types
