"""Poses that name no frame of their own, on robots whose sensor is mounted away from the base."""

import shlex

import numpy as np
import pytest
from ros_files import Ros
from typer.testing import CliRunner

from lidar_core.cli import app
from lidar_core.errors import ConfigError, FormatError
from lidar_core.io import (
    NoTransformError,
    PoseOptions,
    open_recording,
    posed_laser_scans,
    posed_scans,
)
from lidar_core.io.options import mounting_of
from lidar_core.io.poses.nameless import carrier_of
from lidar_core.io.records import Topic
from lidar_core.io.rotations import angles_from_matrix, pose_matrix, quaternion_from_angles
from lidar_core.live import LiveConfig
from lidar_core.live.poses import LivePoses
from lidar_core.messages import Pose, Scan

BASE_NS = 1_700_000_000_000_000_000
AHEAD = [0.14, 0.0, 0.3, 0.0, 0.0, 0.0, 1.0]
"""Where the sensor sits on what carries it: place, and no turn."""
EGO = "ego_pose laser 0.14 0 0 0 0 0"


def bag(folder, *, child="", static=(), moving=(), count=5):
    """A bag with clouds in frame laser, odometry on /odom, and transforms."""
    ros = Ros(2)
    rows = np.zeros(4, np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4")]))
    rows["x"] = np.arange(1, 5)
    messages = []
    if static:
        tree = ros.transforms([(0, parent, one, values) for parent, one, values in static])
        messages.append(("/tf_static", BASE_NS, tree))
    for number in range(count):
        stamp = BASE_NS + number * 10**8
        # It drives in a curve, so that a mounting turns with it.
        yaw = 0.2 * number
        place = [float(number), 0.5 * number, 0.0, 0.0, 0.0, np.sin(yaw / 2), np.cos(yaw / 2)]
        messages.append(("/odom", stamp, ros.odometry(stamp, "odom", child, place)))
        away = [place[0] + 3.0, *place[1:]]
        for name, is_same in moving:
            tree = ros.transforms([(stamp, "odom", name, place if is_same else away)])
            messages.append(("/tf", stamp, tree))
        messages.append(("/points", stamp, ros.cloud(rows, stamp, "laser")))
    return ros.write(folder / "bag", messages, "sqlite3")


def poses_of(path, **options):
    with open_recording(path) as recording:
        return np.array([item.world_from_lidar for item in posed_scans(recording, **options)])


def driven(values):
    """The sensor's poses on that drive, mounted at `values`."""
    sensor = pose_matrix(np.array(values[:3]), np.array(values[3:]))
    base = [
        pose_matrix(
            np.array([number, 0.5 * number, 0.0]), quaternion_from_angles(0.0, 0.0, 0.2 * number)
        )
        for number in range(5)
    ]
    return np.array(base) @ sensor


@pytest.mark.parametrize("child", ["", "base_link"])
@pytest.mark.parametrize("odom", ["/odom", None])
def test_odometry_is_composed_with_the_static_mounting(tmp_path, child, odom):
    path = bag(tmp_path, child=child, static=[("base_link", "laser", AHEAD)])
    np.testing.assert_allclose(poses_of(path, odom=odom), driven(AHEAD), atol=1e-6)


def test_without_a_mounting_nameless_odometry_is_the_sensors(tmp_path):
    at_base = [0.0] * 6 + [1.0]
    np.testing.assert_allclose(poses_of(bag(tmp_path), odom="/odom"), driven(at_base), atol=1e-6)


def test_a_stated_mounting_counts_more(tmp_path):
    path = bag(tmp_path, static=[("base_link", "camera", AHEAD)])
    got = poses_of(path, odom="/odom", mounting=("base_link laser 0.5 0 0 0 0 0",))
    np.testing.assert_allclose(got, driven([0.5, 0, 0, 0, 0, 0, 1.0]), atol=1e-6)


def test_odometry_that_moves_as_a_frame_does_is_of_that_frame(tmp_path):
    path = bag(
        tmp_path,
        static=[("base_link", "laser", AHEAD)],
        moving=[("base_link", True), ("other", False)],
    )
    np.testing.assert_allclose(poses_of(path, odom="/odom"), driven(AHEAD), atol=1e-6)


def test_odometry_of_a_frame_that_carries_no_sensor_is_refused(tmp_path):
    path = bag(tmp_path, moving=[("base_link", True), ("other", False)])
    with pytest.raises(FormatError, match=r"mounting='base_link laser x y z roll pitch yaw'"):
        poses_of(path, odom="/odom")


RAISED = [0.0, 0.0, 0.1, 0.0, 0.0, 0.0, 1.0]
LEVEL = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]


def test_two_frames_that_carry_the_sensor_are_a_question_with_two_answers(tmp_path):
    static = [("base_footprint", "base_link", RAISED), ("base_link", "laser", AHEAD)]
    path = bag(tmp_path, static=static)
    with pytest.raises(ConfigError, match="it may be base_link or base_footprint") as asked:
        poses_of(path, odom="/odom")
    answers = [text.split("'")[0] for text in str(asked.value).split("mounting='")[1:]]
    assert len(answers) == 2
    for height, answer in zip((0.3, 0.4), answers, strict=True):
        got = poses_of(path, odom="/odom", mounting=(answer,))
        np.testing.assert_allclose(got, driven([0.14, 0, height, *LEVEL[3:]]), atol=1e-6)


def test_two_frames_at_one_place_are_no_question(tmp_path):
    static = [("base_footprint", "base_link", LEVEL), ("base_link", "laser", AHEAD)]
    got = poses_of(bag(tmp_path, static=static), odom="/odom")
    np.testing.assert_allclose(got, driven(AHEAD), atol=1e-6)


def test_of_two_frames_the_one_that_transforms_move_is_meant(tmp_path):
    static = [("base_footprint", "base_link", RAISED), ("base_link", "laser", AHEAD)]
    path = bag(tmp_path, static=static, moving=[("base_footprint", False)])
    got = poses_of(path, odom="/odom")
    np.testing.assert_allclose(got, driven([0.14, 0, 0.4, *LEVEL[3:]]), atol=1e-6)


def test_a_sensor_that_stands_in_the_frame_of_the_poses_is_not_moved(tmp_path):
    path = bag(tmp_path, static=[("odom", "laser", AHEAD)])
    with pytest.raises(ConfigError, match=r"fix 'laser' in that frame.*pose=.static"):
        poses_of(path, odom="/odom")


@pytest.mark.parametrize("angles", [(0.1, -0.4, 2.0), (0, np.pi / 2, 0.7), (0, -np.pi / 2, -2.0)])
def test_angles_of_a_mounting_are_those_that_make_it(angles):
    matrix = pose_matrix(np.zeros(3), quaternion_from_angles(*angles))
    again = pose_matrix(np.zeros(3), quaternion_from_angles(*angles_from_matrix(matrix[:3, :3])))
    np.testing.assert_allclose(again, matrix, atol=1e-9)


OTHER_CARS = ["overtake_ego", "overtake_red", "parallel"]


@pytest.mark.parametrize(
    "name",
    ["intersection", *(pytest.param(name, marks=pytest.mark.nightly) for name in OTHER_CARS)],
)
def test_nameless_poses_of_the_real_cars_are_not_the_lasers(recordings, name):
    """The cars tell poses of ego_pose and red_pose, and not where the laser sits on them."""
    with open_recording(recordings / "2d" / "datmo" / f"{name}.bag") as recording:

        def poses(**options):
            scans = posed_laser_scans(recording, **options)
            return {item.scan.stamp_ns: item.world_from_lidar for item in scans}

        for odom in ("/ego_pose", "/red_pose"):
            frame = odom.removeprefix("/")
            asked = rf"mounting='{frame} laser x y z roll pitch yaw'"
            with pytest.raises(FormatError, match=asked):
                poses(odom=odom)
        by_topic, by_tree = poses(odom="/ego_pose", mounting=(EGO,)), poses(mounting=(EGO,))
        bare = poses(odom="/ego_pose", mounting=("ego_pose laser 0 0 0 0 0 0",))
        with pytest.raises(FormatError, match="nothing moves 'laser'"):
            poses(odom="/red_pose", mounting=(EGO,))
    assert len(by_topic) > 80
    shared = sorted(by_topic.keys() & by_tree.keys())
    assert len(shared) > 80
    for stamp in shared:
        np.testing.assert_allclose(by_topic[stamp], by_tree[stamp], atol=0.02)
        ahead = np.linalg.inv(bare[stamp]) @ by_topic[stamp]
        np.testing.assert_allclose(ahead[:3, 3], [0.14, 0, 0], atol=1e-9)


def test_the_command_says_what_to_give_and_works_with_it(recordings, tmp_path):
    path = recordings / "2d" / "datmo" / "intersection.bag"
    words = [
        "circles",
        str(path),
        "-o",
        str(tmp_path / "run"),
        "--odom",
        "/ego_pose",
        "--no-picture",
        "--no-mcap",
        "--end",
        "1",
    ]
    refused = CliRunner().invoke(app, words)
    told = str(refused.exception).split("--mounting ")[1]
    (mounting,) = shlex.split(told[: told.index("', or") + 1])
    mounting = mounting.replace("x y z roll pitch yaw", "0.14 0 0 0 0 0")
    assert mounting == EGO
    done = CliRunner().invoke(app, [*words, "--mounting", mounting])
    assert done.exit_code == 0, done.exception


ODOM = Topic("/odom", "geometry_msgs/msg/PoseStamped", "pose")
TREE = Topic("/tf_static", "tf2_msgs/msg/TFMessage", "pose")


@pytest.mark.parametrize("is_late", [False, True])
def test_a_stream_is_composed_with_the_static_mounting(is_late):
    poses = LivePoses(PoseOptions(odom="/odom"), LiveConfig())
    mounted = Pose(
        0,
        "base_link",
        "laser",
        pose_matrix(np.array(AHEAD[:3]), np.array(AHEAD[3:])),
        is_static=True,
    )
    matrix = np.eye(4)
    if not is_late:
        poses.add(TREE, mounted, "laser")
    poses.add(ODOM, Pose(100, "odom", "", matrix), "laser")
    if is_late:
        poses.add(TREE, mounted, "laser")
        poses.add(ODOM, Pose(100, "odom", "", matrix), "laser")
    posed = poses.posed(Scan(100, np.zeros((1, 3), np.float32), "laser"))
    np.testing.assert_allclose(posed.world_from_lidar[:3, 3], AHEAD[:3])


@pytest.mark.parametrize("is_mounted", [False, True])
def test_a_stream_whose_poses_move_as_a_frame_does_is_of_that_frame(is_mounted):
    poses = LivePoses(PoseOptions(odom="/odom"), LiveConfig())
    scan = Scan(900, np.zeros((1, 3), np.float32), "laser")
    if is_mounted:
        poses.add(TREE, mounting_of("ego_pose laser 0.14 0 0.3 0 0 0"), "laser")
    for stamp in range(0, 1000, 100):
        matrix = np.eye(4)
        matrix[0, 3] = stamp
        poses.add(ODOM, Pose(stamp, "map", "", matrix), "laser")
        poses.add(TREE, Pose(stamp, "map", "ego_pose", matrix), "laser")
    if is_mounted:
        np.testing.assert_allclose(poses.posed(scan).world_from_lidar[:3, 3], [900.14, 0, 0.3])
        return
    assert not poses.is_complete(scan)
    with pytest.raises(NoTransformError, match="mounting="):
        poses.posed(scan)


def test_a_stream_asks_which_frame_is_meant():
    poses = LivePoses(PoseOptions(odom="/odom"), LiveConfig())
    for text in ("base_footprint base_link 0 0 0.1 0 0 0", "base_link laser 1 0 0 0 0 0"):
        poses.add(TREE, mounting_of(text), "laser")
    with pytest.raises(ConfigError, match="it may be base_link or base_footprint"):
        poses.add(ODOM, Pose(100, "odom", "", np.eye(4)), "laser")


def test_a_ring_of_mountings_ends():
    ring = [mounting_of("a b 0 0 0 0 0 0"), mounting_of("b a 0 0 0 0 0 0")]
    assert carrier_of("b", [Pose(1, "odom", "", np.eye(4))], ring, [], "/odom") in ("a", "b")
