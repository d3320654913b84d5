"""Poses in a wrong frame: recognised by the scans, named with the cure, and no false alarms."""

import warnings

import numpy as np
import pytest
from archives import unpack
from typer.testing import CliRunner

import lidar_core as lc
import lidar_core.sim as sim
from lidar_core.cli import app
from lidar_core.errors import PoseFrameWarning
from lidar_core.io.poses.pose_frames import PoseFrameCheck, Reading, _turn, advice
from lidar_core.io.rotations import matrix_from_quaternion, quaternion_from_matrix
from lidar_core.messages import Pose, Scan

CAMERA = _turn("-y", "-z", "x")
DOWN = _turn("x", "-y", "-z")
HALF = _turn("-x", "-y", "z")
SCANS, LONG, LONG_STREET = 14, 26, 14


def pose_of(rotation=None, translation=(0, 0, 0)):
    matrix = np.eye(4)
    matrix[:3, :3] = np.eye(3) if rotation is None else rotation
    matrix[:3, 3] = translation
    return matrix


def simulated(seed, preset="os1-32", *, scans=SCANS, columns=None):
    """Scans and poses; of a spinning sensor with so many columns."""
    scene, lidar = sim.scenes.demo(seed, scans=scans), sim.LidarModel.preset(preset)
    if columns is not None:
        pattern = lidar.pattern.model_copy(update={"columns": columns})
        lidar = lidar.model_copy(update={"pattern": pattern})
    items = list(sim.simulate(scene.model_copy(update={"lidar": lidar}), seed=seed))
    return [item.scan for item in items], np.array([item.world_from_lidar for item in items])


@pytest.fixture(scope="module")
def flight():
    return simulated(5, columns=256)


def mismatch_of(scans, poses, *mounted):
    check = PoseFrameCheck(*mounted)
    found = [
        check.add(getattr(scan, "points", scan), pose)
        for scan, pose in zip(scans, poses, strict=True)
    ]
    return next((one for one in [*found, check.decide()] if one is not None), None)


@pytest.mark.parametrize(
    "lever", [(0.3, -0.2, 0.5), pytest.param((0, 0, 0), marks=pytest.mark.nightly)]
)
@pytest.mark.parametrize(
    ("turn", "words"),
    [
        (CAMERA, "a camera's (x right, y down, z forward)"),
        (DOWN, "a body's with z down (x forward, y right, z down)"),
        (HALF, "one turned half round"),
    ],
)
def test_poses_of_a_camera_or_a_body_are_named(flight, turn, words, lever):
    scans, poses = flight
    for world in (np.eye(4), pose_of(turn)):  # the world may have the other axes, too
        other = world @ poses @ pose_of(turn.T, lever)
        found = mismatch_of(scans, other)
        assert found is not None
        assert found.name.startswith(words)
        assert not found.is_inverse
        assert found.found > found.given + 0.1
        np.testing.assert_array_equal(found.turn, turn)


def test_inverse_poses_are_named(flight):
    scans, poses = flight
    found = mismatch_of(scans, np.linalg.inv(poses))
    assert found.is_inverse
    np.testing.assert_array_equal(found.turn, np.eye(3))
    text = advice(found, frame="os", source="poses.txt")
    assert text.startswith("poses (poses.txt) seem to be inverted, of the world in the sensor's")
    assert text.endswith("Cure: give the inverse of every matrix")
    camera = mismatch_of(scans, np.linalg.inv(poses @ pose_of(CAMERA.T)))
    assert camera.is_inverse
    np.testing.assert_array_equal(camera.turn, CAMERA)


@pytest.mark.parametrize(
    ("preset", "seed", "scans"),
    [
        ("vlp-16", 7, SCANS),
        ("livox-mid360", 8, SCANS),
        pytest.param("os1-32", 6, LONG, marks=pytest.mark.nightly),
        pytest.param("vlp-16", 7, LONG, marks=pytest.mark.nightly),
        pytest.param("livox-mid360", 8, LONG, marks=pytest.mark.nightly),
    ],
)
def test_right_poses_are_no_alarm(preset, seed, scans):
    scans, poses = simulated(seed, preset, scans=scans)
    assert mismatch_of(scans, poses) is None
    rng = np.random.default_rng(seed)
    noisy = [pose @ pose_of(None, rng.normal(0, 0.03, 3)) for pose in poses]
    assert mismatch_of(scans, noisy) is None


def test_a_sensor_that_stands_is_undecidable_and_silent(flight):
    scans, poses = flight
    assert mismatch_of(scans, np.tile(poses[:1] @ pose_of(CAMERA.T), (len(scans), 1, 1))) is None
    assert mismatch_of(scans[:3], poses[:3] @ pose_of(CAMERA.T)) is None
    empty = [Scan(0, np.empty((0, 3), np.float32))] * len(scans)
    assert mismatch_of(empty, poses @ pose_of(CAMERA.T)) is None


def w_first(poses):
    """Poses whose quaternions were written as w x y z, and read as x y z w."""
    read = np.array(poses)
    quaternions = quaternion_from_matrix(read[:, :3, :3])
    read[:, :3, :3] = matrix_from_quaternion(np.roll(quaternions, 1, axis=-1))
    return read


@pytest.mark.parametrize("turn", [np.eye(3), CAMERA])
def test_quaternions_in_the_order_w_x_y_z_are_named(flight, turn):
    scans, poses = flight
    mounted = pose_of(DOWN, (0.3, 0.1, 0))
    for carrier in (np.eye(4), mounted):
        given = w_first(poses @ pose_of(turn.T) @ np.linalg.inv(carrier)) @ carrier
        found = mismatch_of(scans, given, carrier)
        assert found.reading is Reading.W_FIRST
        np.testing.assert_array_equal(found.turn, turn)
        assert found.other is None


def test_an_order_that_is_right_is_not_blamed(flight):
    scans, poses = flight
    assert mismatch_of(scans, poses, np.eye(4)) is None
    for turn in (CAMERA, DOWN, HALF):
        found = mismatch_of(scans, poses @ pose_of(turn.T), np.eye(4))
        assert found.reading is Reading.GIVEN
        np.testing.assert_array_equal(found.turn, turn)
    assert mismatch_of(scans, np.linalg.inv(poses), np.eye(4)).is_inverse


def driven(scans=12):
    """A sensor that drives and turns on the level between boxes of points; only yaw changes."""
    rng = np.random.default_rng(3)
    walls = rng.uniform(-15, 15, (4000, 3)) * (1, 1, 0.2)
    walls[:, rng.integers(0, 2)] = np.round(walls[:, 0] / 10) * 10
    clouds, poses = [], []
    for number in range(scans):
        yaw = 0.05 * number
        turn = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
        poses.append(pose_of(turn, (0.02 * number, 0, 1.5)))
        points = (walls - poses[-1][:3, 3]) @ turn
        clouds.append(Scan(number * 10**8, points.astype(np.float32), frame_id="lidar"))
    return clouds, np.array(poses)


def write_tum(path, scans, poses, *, first_w):
    quaternions = quaternion_from_matrix(poses[:, :3, :3])
    order = np.roll(quaternions, 1, axis=-1) if first_w else quaternions
    times = [scan.stamp_ns * 1e-9 for scan in scans]
    np.savetxt(path, np.column_stack([times, poses[:, :3, 3], order]), fmt="%.9f")
    return str(path)


def told(path, file):
    with lc.io.open_recording(path) as recording, warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always", PoseFrameWarning)
        list(lc.io.posed_scans(recording, pose=file))
    return [str(one.message) for one in told if one.category is PoseFrameWarning]


def test_a_tum_file_with_w_first_is_named_with_the_cure(tmp_path):
    """Where nothing but yaw changes, an odd frame fits too; the order is named first."""
    scans, poses = driven()
    path = tmp_path / "r.npz"
    lc.io.write_npz(path, scans)
    file = write_tum(tmp_path / "poses.txt", scans, poses, first_w=True)
    (text,) = told(path, file)
    assert "quaternions in the order w x y z, not x y z w" in text
    assert text.index("order w x y z") < text.index("move column 5")
    assert "Or the order is right, and they are in another frame than the scans: one whose" in text
    rows = np.loadtxt(file)[:, [0, 1, 2, 3, 5, 6, 7, 4]]  # the cure
    np.savetxt(file, rows, fmt="%.9f")
    assert told(path, file) == []


def written(tmp_path, flight, poses):
    """A recording without poses, and a poses file as KITTI writes it."""
    lc.io.write_npz(tmp_path / "r.npz", flight[0])
    np.savetxt(tmp_path / "poses.txt", np.asarray(poses)[:, :3].reshape(-1, 12))
    return tmp_path / "r.npz", str(tmp_path / "poses.txt")


def test_the_cure_that_is_printed_cures(tmp_path, flight):
    """--mounting, as the warning says it, gives the LiDAR's own poses, also for KITTI files."""
    _, poses = flight
    path, file = written(tmp_path, flight, poses @ pose_of(CAMERA.T))
    with lc.io.open_recording(path) as recording, pytest.warns(PoseFrameWarning) as told:
        list(lc.io.posed_scans(recording, pose=file))
    (text,) = [str(one.message) for one in told]
    assert "in another frame than the scans: a camera's (x right, y down, z forward)" in text
    mounting = text.split('mounting="')[1].split('"')[0]
    with lc.io.open_recording(path) as recording, warnings.catch_warnings():
        warnings.simplefilter("error")
        found = list(lc.io.posed_scans(recording, pose=file, mounting=(mounting,)))
    got = np.array([item.world_from_lidar for item in found])
    np.testing.assert_allclose(got, poses, atol=2e-3)


def test_detect_prints_the_frame_and_the_cure(tmp_path, flight):
    _, poses = flight
    path, file = written(tmp_path, flight, poses @ pose_of(CAMERA.T))
    arguments = ["detect", str(path), "--no-picture", "--no-mcap", "--pose"]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PoseFrameWarning)
        done = CliRunner().invoke(app, [*arguments, file, "-o", str(tmp_path / "a")])
    assert done.exit_code == 0, done.output
    assert "a camera's (x right, y down, z forward)" in done.output
    assert "--mounting" in done.output
    _, file = written(tmp_path, flight, poses)
    done = CliRunner().invoke(app, [*arguments, file, "-o", str(tmp_path / "b")])
    assert done.exit_code == 0, done.output
    assert "another frame" not in done.output


@pytest.mark.parametrize("is_camera", [True, False])
def test_info_tells_of_poses_in_another_frame(tmp_path, flight, is_camera):
    scans, poses = flight
    turn = pose_of(CAMERA.T) if is_camera else np.eye(4)
    messages = []
    for scan, pose in zip(scans, poses, strict=True):
        messages += [Pose(scan.stamp_ns, "map", scan.frame_id, pose @ turn), scan]
    lc.io.write_npz(tmp_path / "r.npz", messages)
    with lc.io.open_recording(tmp_path / "r.npz") as recording:
        defects = recording.info().defects
    found = [text for text in defects if "in another frame than the scans" in text]
    assert len(found) == is_camera
    done = CliRunner().invoke(app, ["info", str(tmp_path / "r.npz")])
    assert ("a camera's (x right" in done.output) == is_camera


@pytest.mark.parametrize("count", [6, pytest.param(LONG_STREET, marks=pytest.mark.nightly)])
def test_a_real_street_with_its_poses_and_those_of_a_camera(recordings, tmp_path, count):
    folder = recordings / "3d/sequences/street_128_labelled"
    packed = folder / "lidar_rounded_000000-000029.tar.xz"
    names = unpack(packed, tmp_path, suffix=".pcd", most=count)
    known = np.tile(np.eye(4), (30, 1, 1))
    known[:, :3] = np.loadtxt(folder / "poses_icp.txt").reshape(-1, 3, 4)
    scans = []
    for name in names:
        with lc.io.open_recording(tmp_path / name) as recording:
            scans += [message for message in recording if isinstance(message, Scan)]
    assert mismatch_of(scans, known[:count]) is None
    found = mismatch_of(scans, known[:count] @ pose_of(CAMERA.T))
    assert found is not None
    np.testing.assert_array_equal(found.turn, CAMERA)
    if count == LONG_STREET:
        assert mismatch_of(scans, np.linalg.inv(known[:count])).is_inverse
