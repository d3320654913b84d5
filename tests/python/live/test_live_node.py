"""The ROS 2 node of the examples, without ROS: stand-ins for what it uses of rclpy."""

import _thread
import runpy
import sys
import time
from threading import Event, Thread
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest
from repository import ROOT
from typer.testing import CliRunner

import lidar_core as lc
import lidar_core.io
from lidar_core.cli import app
from lidar_core.io.messages.ros_types import DETECTIONS_TYPE
from lidar_core.io.write.ros import RosMessages

NODE = ROOT / "examples" / "ros2" / "lidar_core_node.py"
PATIENCE_S = 60


@pytest.fixture(scope="module")
def example():
    return runpy.run_path(str(NODE))


class Publisher:
    """As that of rclpy: messages of its class, or bytes."""

    def __init__(self, message):
        self.message, self.sent = message, []

    def publish(self, raw):
        assert type(raw) is bytes
        self.sent.append(raw)


class Node:
    """What `lidar_core_node` uses of rclpy's nodes."""

    def __init__(self, parameters=None):
        self.taken, self.publishers = {}, {}
        self.parameters, self.is_up = parameters or {}, Event()
        self.is_up.set()
        self.context = SimpleNamespace(ok=self.is_up.is_set)

    def declare_parameter(self, name, value):
        return SimpleNamespace(value=self.parameters.get(name, value))

    def create_subscription(self, message, name, take, quality, *, raw):
        assert raw
        self.taken[name] = (message, take, quality)
        return name

    def create_publisher(self, message, name, depth):
        self.publishers[name] = Publisher(message)
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


class Ros:
    """Modules of ROS as far as `main` uses them; `spin` gives the node messages, then ends."""

    def __init__(self, node, feed, end):
        self.node, self.feed, self.end = node, feed, end
        self.store = RosMessages(2).store
        self.qualities, self.is_shut_down = {}, False

    def install(self, monkeypatch):
        executors = ModuleType("rclpy.executors")
        executors.ExternalShutdownException = type("ExternalShutdownException", (Exception,), {})
        self.shutdown = executors.ExternalShutdownException
        rclpy, qos = ModuleType("rclpy"), ModuleType("rclpy.qos")
        rclpy.init, rclpy.spin, rclpy.try_shutdown = lambda: None, self.spin, self.try_shutdown
        rclpy.create_node = lambda name: self.node
        qos.DurabilityPolicy = SimpleNamespace(TRANSIENT_LOCAL="transient")
        qos.QoSProfile = lambda **values: values
        qos.qos_profile_sensor_data = {"reliability": "best effort"}
        utilities = ModuleType("rosidl_runtime_py.utilities")
        utilities.get_message = lambda name: self.store.types[name]
        package = ModuleType("rosidl_runtime_py")
        for module in (rclpy, qos, executors, package, utilities):
            monkeypatch.setitem(sys.modules, module.__name__, module)

    def spin(self, node):
        for topic, raw in self.feed:
            wait_until(lambda name=topic: name in node.taken)
            message, take, quality = node.taken[topic]
            self.qualities[topic] = quality
            assert isinstance(message, type)
            take(raw)
            time.sleep(0.02)
        wait_until(lambda: len(node.publishers["lidar_core/tracks"].sent) >= 3)
        node.is_up.clear()
        if self.end == "interrupt":
            _thread.interrupt_main()
        raise self.shutdown

    def try_shutdown(self):
        self.is_shut_down = True


def wait_until(is_so):
    end = time.monotonic() + PATIENCE_S
    while not is_so() and time.monotonic() < end:
        time.sleep(0.01)
    assert is_so()


def told(items, messages):
    """What a robot would publish of a recording: topics and serialised messages."""
    for item in items:
        topic, message = messages.of(item)
        yield topic, bytes(messages.packed(message))


@pytest.mark.parametrize("end", ["shutdown", "interrupt"])
@pytest.mark.parametrize(
    ("scene", "topic", "options"),
    [
        ("circles", "/laser/scan", {"scan": "/laser/scan"}),
        ("demo", "/lidar/points", {"cloud": "/lidar/points", "pose": "static"}),
    ],
)
def test_the_whole_node_runs_until_ros_ends(
    example, tmp_path, monkeypatch, capsys, scene, topic, options, end
):
    path = tmp_path / "recording.npz"
    sensor = ["--sensor", "vlp-16"] if scene == "demo" else []
    made = CliRunner().invoke(app, ["simulate", scene, "-o", str(path), "--scans", "12", *sensor])
    assert made.exit_code == 0, made.output
    messages = RosMessages(2)
    with lc.io.open_recording(path) as recording:
        feed = [one for one in told(recording, messages) if one[0] in (topic, "/tf", "/tf_static")]
    node = Node(options)
    ros = Ros(node, feed, end)
    ros.install(monkeypatch)
    example["main"]()
    assert ros.is_shut_down
    assert node.taken == {}
    assert ros.qualities[topic] == {"reliability": "best effort"}
    tracks = node.publishers["lidar_core/tracks"]
    assert tracks.message.__name__.endswith("Detection3DArray")
    stamps = {message.stamp_ns for message in scans_of(path)}
    for raw in tracks.sent:
        header = messages.store.deserialize_cdr(raw, DETECTIONS_TYPE).header
        assert header.stamp.sec * 10**9 + header.stamp.nanosec in stamps
    assert "'processed':" in capsys.readouterr().out


def scans_of(path):
    with lc.io.open_recording(path) as recording:
        sorts = (lc.messages.Scan, lc.messages.LaserScan)
        return [item for item in recording if isinstance(item, sorts)]


def test_nothing_is_published_once_ros_has_ended(example):
    node = Node()
    node.is_up.clear()
    output = example["NodeOutput"](node, lambda name: name)
    frame = SimpleNamespace()
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(
            output.publish.__func__.__globals__,
            "ros_messages",
            lambda update, messages: [("tracks", None)],
        )
        output.publish(frame)
    assert node.publishers["lidar_core/tracks"].sent == []
