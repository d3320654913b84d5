"""The lifecycle node of the examples and its obstacles for Nav2, without ROS."""

import sys
import time
from threading import Event
from types import SimpleNamespace

import numpy as np
import pytest
from repository import ROOT
from typer.testing import CliRunner

import lidar_core as lc
import lidar_core.io
from lidar_core.cli import app
from lidar_core.io.write.ros import RosMessages

PATIENCE_S = 60
CLOUD, OBSTACLES = "sensor_msgs/msg/PointCloud2", "lidar_core/obstacles"


@pytest.fixture
def lifecycle(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "examples" / "ros2"))
    import lifecycle_node

    yield lifecycle_node
    for name in ("lifecycle_node", "lidar_core_node", "nav2_obstacles"):
        sys.modules.pop(name, None)


class Node:
    """What the node uses of rclpy's."""

    def __init__(self):
        self.taken, self.sent, self.errors = {}, {}, []
        up = Event()
        up.set()
        self.context = SimpleNamespace(ok=up.is_set)

    def create_subscription(self, message, name, take, quality, *, raw):
        assert raw
        self.taken[name] = take
        return name

    def destroy_subscription(self, name):
        del self.taken[name]

    def create_publisher(self, message, name, depth):
        self.sent.setdefault(name, [])
        return SimpleNamespace(publish=self.sent[name].append)

    def get_logger(self):
        return SimpleNamespace(error=self.errors.append)


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    path = tmp_path_factory.mktemp("drive") / "circles.npz"
    made = CliRunner().invoke(app, ["simulate", "circles", "-o", str(path), "--scans", "12"])
    assert made.exit_code == 0, made.output
    messages = RosMessages(2)
    with lc.io.open_recording(path) as recording:
        told = [messages.of(item) for item in recording]
    return [(topic, bytes(messages.packed(message))) for topic, message in told]


def wait_until(is_so):
    end = time.monotonic() + PATIENCE_S
    while not is_so() and time.monotonic() < end:
        time.sleep(0.01)
    assert is_so()


def play(node, drive):
    wait_until(lambda: "/laser/scan" in node.taken)
    for topic, raw in drive:
        node.taken[topic](raw)
        time.sleep(0.01)


def clouds_of(node):
    store = RosMessages(2).store
    return [store.deserialize_cdr(raw, CLOUD) for raw in node.sent[OBSTACLES]]


def test_scans_are_processed_while_the_node_is_active_and_again_after_that(lifecycle, drive):
    node = Node()
    work = lifecycle.Lifecycle(node, lambda name: name, lambda name: 1)
    assert work.configure({"scan": "/laser/scan"})
    assert node.taken == {}
    counts = []
    for _ in range(2):
        assert work.activate()
        play(node, drive)
        before = sum(counts)
        wait_until(lambda before=before: len(node.sent[OBSTACLES]) > before + 2)
        assert work.deactivate()
        assert node.taken == {}
        counts.append(len(node.sent[OBSTACLES]) - before)
    assert node.errors == []
    assert work.cleanup()
    assert not work.activate()
    assert len(node.sent["lidar_core/tracks"]) == sum(counts)
    last = clouds_of(node)[-1]
    assert last.header.frame_id == "world"
    assert last.width * last.height > 100


@pytest.mark.parametrize("parameters", [{}, {"scan": "/a", "cloud": "/b"}])
def test_parameters_that_name_no_or_two_topics_are_refused(lifecycle, parameters):
    node = Node()
    work = lifecycle.Lifecycle(node, lambda name: name, lambda name: 1)
    assert not work.configure(parameters)
    assert node.errors == ["expected one of the parameters cloud and scan"]
    assert not work.activate()


def test_a_pose_that_is_no_source_is_refused_when_it_is_configured(lifecycle):
    node = Node()
    work = lifecycle.Lifecycle(node, lambda name: name, lambda name: 1)
    assert not work.configure({"scan": "/a", "pose": "poses.txt"})
    assert "live stream" in node.errors[0]


def test_what_ends_the_processing_is_told_when_the_node_is_deactivated(lifecycle, monkeypatch):
    node = Node()
    work = lifecycle.Lifecycle(node, lambda name: name, lambda name: 1)
    assert work.configure({"scan": "/a"})
    monkeypatch.setattr(work.loop, "run", lambda: 1 / 0)
    assert work.activate()
    assert not work.deactivate()
    assert "division by zero" in node.errors[0]


def objects(**values):
    return SimpleNamespace(
        **{name: np.array(value, float).reshape(-1, 3) for name, value in values.items()}
    )


def test_obstacles_cover_where_objects_are_and_will_be(lifecycle):
    """A disc of 0.5 m around the way of the next second, and nothing else."""
    from nav2_obstacles import SPACING, obstacle_points

    points = obstacle_points(
        objects(position=[1, 2, 0.5], velocity=[2, 0, 0], size=[0.8, 0.6, 0.2])
    )
    x, y, z = points.T
    assert np.all(z == np.float32(0.5))
    along = np.clip(x, 1, 3)
    assert np.hypot(x - along, y - 2).max() <= 0.5 + 1e-6
    for place in ([1, 2], [2, 2], [3, 2], [3.45, 2], [1, 2.45]):
        assert np.hypot(*(points[:, :2] - place).T).min() <= SPACING
    assert len(obstacle_points(objects(position=[], velocity=[], size=[]))) == 0


def test_an_object_without_size_is_still_an_obstacle(lifecycle):
    from nav2_obstacles import LEAST_RADIUS, obstacle_points

    points = obstacle_points(objects(position=[0, 0, 0], velocity=[0, 0, 0], size=[0, 0, 0]))
    assert 0.9 * LEAST_RADIUS <= np.hypot(*points[:, :2].T).max() <= LEAST_RADIUS + 1e-6
