"""The ROS 2 node of the examples, without ROS: a node that only remembers."""

import runpy
import time
from pathlib import Path
from threading import Thread

import numpy as np
import pytest
from typer.testing import CliRunner

import lidar_core as lc
import lidar_core.io
from lidar_core.cli import app
from lidar_core.io.ros_types import DETECTIONS_TYPE
from lidar_core.io.write_ros import RosMessages

NODE = Path(__file__).parents[2] / "examples" / "ros2" / "lidar_core_node.py"
PATIENCE_S = 60


@pytest.fixture(scope="module")
def example():
    return runpy.run_path(str(NODE))


class Publisher:
    def __init__(self):
        self.sent = []

    def publish(self, raw):
        self.sent.append(raw)


class Node:
    """What `lidar_core_node` uses of rclpy's nodes."""

    def __init__(self):
        self.taken, self.publishers = {}, {}

    def create_subscription(self, message, name, take, quality, *, raw):
        assert raw
        self.taken[name] = (message, take, quality)
        return name

    def create_publisher(self, message, name, depth):
        self.publishers[name] = Publisher()
        return self.publishers[name]

    def destroy_subscription(self, name):
        del self.taken[name]


def test_topics_are_those_of_the_parameters(example):
    named = example["wanted_topics"]({"cloud": "", "scan": "/scan", "odom": "/odom"})
    assert named == {
        "/tf": "tf2_msgs/msg/TFMessage",
        "/tf_static": "tf2_msgs/msg/TFMessage",
        "/scan": "sensor_msgs/msg/LaserScan",
        "/odom": "nav_msgs/msg/Odometry",
    }


def test_pipelines_are_those_of_the_scans(example):
    assert example["pipeline_for"](lc.messages.LaserScan).capability == "circles"
    assert example["pipeline_for"](lc.messages.Scan).capability == "flying"


def test_scans_of_a_node_become_detections(example, tmp_path):
    path = tmp_path / "circles.npz"
    made = CliRunner().invoke(app, ["simulate", "circles", "-o", str(path), "--scans", "15"])
    assert made.exit_code == 0, made.output
    with lc.io.open_recording(path) as recording:
        items = list(recording)
    node, messages = Node(), RosMessages(2)
    loop = example["loop_of"](node, {"scan": "/laser/scan"}, lambda name: name, lambda name: 1)
    work = Thread(target=loop.run, args=(PATIENCE_S,))
    work.start()
    while len(node.taken) < 3:
        time.sleep(0.01)
    assert node.taken["/laser/scan"][0] == "sensor_msgs/msg/LaserScan"
    for item in items:
        topic, message = messages.of(item)
        node.taken[topic][1](messages.packed(message))
        time.sleep(0.02)
    node.taken["/laser/scan"][1](b"no message")
    end = time.monotonic() + PATIENCE_S
    while time.monotonic() < end and not loop.inbox.rejected:
        time.sleep(0.02)
    loop.inbox.finish()
    work.join()
    assert node.taken == {}
    summary = loop.summary()
    assert summary["bad_messages"] == {"/laser/scan": 1}
    sent = node.publishers["lidar_core/tracks"].sent
    assert len(sent) == summary["processed"] >= 3
    last = messages.store.deserialize_cdr(sent[-1], DETECTIONS_TYPE)
    assert last.header.frame_id == "world"
    assert len(node.publishers["lidar_core/odometry"].sent) >= len(last.detections)
    assert all(np.isfinite(item.bbox.center.position.x) for item in last.detections)
