"""Poses of two bodies stay apart; where they do not, a note says so and no command uses them."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
from ros_files import Ros
from typer.testing import CliRunner

import lidar_core as lc
import lidar_core.io
from lidar_core.cli import app
from lidar_core.errors import PoseFrameWarning
from lidar_core.io import McapWriter
from lidar_core.io.poses import leaps as leaps_module
from lidar_core.io.poses.leaps import MovingTransforms, leaps
from lidar_core.io.records import Topic
from lidar_core.messages import LaserScan, Pose

BASE_NS = 1_700_000_000_000_000_000
STEP_NS = 50_000_000
COPIES = ["a.npz", "a.mcap", "a.bag", "a"]


def at(number, y):
    matrix = np.eye(4)
    matrix[:3, 3] = (0.1 * number, y, 0)
    return matrix


def sweep(number):
    ranges = np.full(90, 3.0, np.float32)
    stamp_ns = BASE_NS + number * STEP_NS
    return LaserScan(stamp_ns, ranges, 0.0, 0.05, 0.1, 10.0, frame_id="laser", topic="/scan")


def drive(child=""):
    """Two vehicles side by side, each with a topic of its own, and the scans of one of them."""
    for number in range(30):
        stamp_ns = BASE_NS + number * STEP_NS
        yield Pose(stamp_ns, "map", child, at(number, 0.0), topic="/ego")
        yield Pose(stamp_ns, "map", child, at(number, 2.0), topic="/other")
        yield sweep(number)


def laser(ros, scan):
    return ros.types["sensor_msgs/msg/LaserScan"](
        header=ros.header(scan.stamp_ns, scan.frame_id),
        angle_min=0.0,
        angle_max=0.05 * 89,
        angle_increment=0.05,
        time_increment=0.0,
        scan_time=0.0,
        range_min=0.1,
        range_max=10.0,
        ranges=scan.ranges,
        intensities=np.empty(0, np.float32),
    )


def bag(path, child):
    """Two topics of poses, of PoseStamped or, with a child frame, of Odometry."""
    ros = Ros(1)
    messages = []
    for item in drive(child):
        if isinstance(item, LaserScan):
            made = laser(ros, item)
        else:
            place = [*item.matrix[:3, 3], 0.0, 0.0, 0.0, 1.0]
            made = ros.odometry(item.stamp_ns, "map", child, place)
        messages.append((item.topic, item.stamp_ns, made))
    return ros.write(path, messages, "bag")


def poses(path, **options):
    with lc.io.open_recording(path) as recording:
        return [one.world_from_lidar for one in lc.io.posed_laser_scans(recording, **options)]


@pytest.mark.parametrize("name", COPIES)
def test_a_copy_keeps_poses_without_a_frame_apart(tmp_path, name):
    lc.io.write_recording(tmp_path / name, drive())
    for topic, y in (("/ego", 0.0), ("/other", 2.0)):
        found = np.array(poses(tmp_path / name, odom=topic))
        np.testing.assert_allclose(found[:, 1, 3], y, atol=1e-6)
    with lc.io.open_recording(tmp_path / name) as recording:
        assert {one.name for one in recording.topics()} == {"/ego", "/other", "/scan"}
        assert not recording.info().defects


@pytest.mark.parametrize("child", ["", "laser"])
@pytest.mark.parametrize("name", COPIES[1:])
def test_a_converted_part_gives_the_poses_of_the_same_part(tmp_path, name, child):
    source = bag(tmp_path / "source.bag", child)
    part = tmp_path / name
    words = ["convert", str(source), str(part), "--start", "0.5", "--end", "1.0"]
    done = CliRunner().invoke(app, words)
    assert done.exit_code == 0, done.output
    for topic in ("/ego", "/other"):
        given = poses(source, odom=topic, start=0.5, end=1.0)
        np.testing.assert_allclose(poses(part, odom=topic), given, atol=1e-9)
    with pytest.raises(lc.errors.FormatError, match="odom=TOPIC"):
        poses(part)


def older(path):
    """Both bodies as one transform without a child frame, as in copies of earlier versions."""
    with McapWriter(path, tracks_frame="map") as writer:
        for item in drive("x"):
            if isinstance(item, Pose):
                writer.write(replace(item, topic="/tf"))
            else:
                writer.write(item)
    return path


def test_info_does_not_recommend_a_transform_of_two_bodies(tmp_path):
    path = older(tmp_path / "old.mcap")
    done = CliRunner().invoke(app, ["info", str(path)])
    assert "leaps 30 times to another place and back, by 2 m" in done.stdout
    assert "--odom" not in done.stdout
    assert "--mounting" not in done.stdout
    with pytest.warns(PoseFrameWarning, match="the poses of two bodies"):
        poses(path, mounting=("x laser 0 0 0 0 0 0",))


@pytest.fixture
def nameless_transforms(tmp_path):
    """A bag whose transforms have no child frame: what moves is not stated."""
    ros = Ros(1)
    messages = []
    for number in range(10):
        scan = sweep(number)
        place = [0.1 * number, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]
        transform = ros.transforms([(scan.stamp_ns, "map", "", place)])
        messages += [("/tf", scan.stamp_ns, transform), ("/scan", scan.stamp_ns, laser(ros, scan))]
    return ros.write(tmp_path / "nameless.bag", messages, "bag")


def test_info_tells_transforms_without_a_child_frame(nameless_transforms):
    done = CliRunner().invoke(app, ["info", str(nameless_transforms)])
    assert "note /tf: 10 transforms without a child frame" in done.stdout, done.stdout


def test_only_the_first_transforms_are_kept_and_all_are_counted(monkeypatch):
    monkeypatch.setattr(leaps_module, "MOST_POSES", 20)
    found, topic = MovingTransforms(), Topic("/tf", "tf2_msgs/msg/TFMessage", "pose")
    for number in range(100):
        matrix = np.eye(4)
        matrix[0, 3] = 5.0 * (number % 2) if number < 20 else 0.0
        found.add(topic, [Pose(number * 10**8, "map", "", matrix, topic="/tf")])
    leap, count = found.notes()
    assert "the poses of two bodies" in leap
    assert "/tf: 100 transforms without a child frame" in count


@pytest.mark.parametrize("speed", [0.0, 1.0, 60.0])
@pytest.mark.parametrize("noise", [0.0, 0.02, 1.0])
def test_one_body_does_not_leap(speed, noise):
    """Neither a fast one, nor one whose poses are noisy, in one direction or in three."""
    rng = np.random.default_rng(3)
    stamps = np.arange(400, dtype=np.int64) * 10**8
    for directions in (1, 3):
        places = np.zeros((400, 3))
        places[:, 0] = speed * stamps * 1e-9
        places[:, :directions] += rng.normal(0, noise, (400, directions))
        assert leaps(stamps, places)[0] == 0


@pytest.mark.parametrize("turn", [4, 9, 30])
def test_one_body_that_flies_to_and_fro_does_not_leap(turn):
    """It turns back every few poses, as a sensor that is carried along a line and back."""
    stamps = np.arange(200, dtype=np.int64) * 10**8
    way = np.abs((np.arange(200) + turn) % (2 * turn) - turn)
    places = np.zeros((200, 3))
    places[:, 0] = 0.4 * way
    assert leaps(stamps, places)[0] == 0
    assert leaps(stamps[:16], places[:16])[0] == 0


@pytest.mark.parametrize("period", [1, 2, 10])
def test_two_bodies_leap_at_any_rates(period):
    stamps = np.arange(400, dtype=np.int64) * 10**7
    places = np.zeros((400, 3))
    places[:, 0] = 15.0 * stamps * 1e-9
    places[:: period + 1, 1] = 4.0
    count, length = leaps(stamps, places)
    assert count > 0
    assert length == pytest.approx(4.0, abs=0.2)


def test_a_single_jump_and_a_few_poses_are_no_second_body():
    stamps = np.arange(100, dtype=np.int64)
    places = np.zeros((100, 3))
    places[50:, 0] = 30.0
    assert leaps(stamps, places)[0] == 0
    assert leaps(stamps[:2], places[:2])[0] == 0


def test_correct_poses_have_no_warning(tmp_path):
    lc.io.write_recording(tmp_path / "a.mcap", drive())
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert len(poses(tmp_path / "a.mcap", odom="/ego")) == 30
