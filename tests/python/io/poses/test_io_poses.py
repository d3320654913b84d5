"""Poses: interpolation against scipy, look-up through trees, files, and what is said without."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from ros_files import Ros
from scipy.spatial.transform import Rotation, Slerp

import lidar_core as lc
import lidar_core.io
import lidar_core.io.poses.posed as posed_module
from lidar_core.errors import ConfigError, FormatError
from lidar_core.io.formats.npz import NpzRecording
from lidar_core.io.rotations import matrix_from_quaternion, quaternion_from_matrix, slerp
from lidar_core.messages import Pose, Scan

ROUNDING = 1e-12
BASE_NS = 1_700_000_000_000_000_000
IDENTITY = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]
seeds = st.integers(0, 2**32 - 1)


def random_pose(rng, stamp_ns, parent="map", child="base", *, is_static=False):
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.random(random_state=rng).as_matrix()
    matrix[:3, 3] = rng.normal(size=3) * 100
    return Pose(stamp_ns, parent, child, matrix, is_static=is_static)


def buffer(*poses, max_gap=10.0, max_extrapolation=0.1):
    result = lc.io.TransformBuffer(max_gap=max_gap, max_extrapolation=max_extrapolation)
    for pose in poses:
        result.add(pose)
    return result


@given(seeds)
def test_quaternions_equal_scipy(seed):
    rotations = Rotation.random(5, random_state=np.random.default_rng(seed))
    expected = rotations.as_quat(canonical=True)
    got = quaternion_from_matrix(rotations.as_matrix())
    flip = np.sign(np.sum(got * expected, axis=1, keepdims=True))  # w = 0 has two forms
    np.testing.assert_allclose(got * flip, expected, atol=1e-7)
    np.testing.assert_allclose(matrix_from_quaternion(expected), rotations.as_matrix(), atol=1e-12)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-7, 1e-3, 1.0, np.pi - 1e-6])
def test_slerp_keeps_small_and_large_angles(angle):
    end = Rotation.from_rotvec([0, 0, angle]).as_quat()
    part = np.linspace(0, 1, 7)
    got = slerp(np.array([0, 0, 0, 1.0]), end, part)
    expected = Rotation.from_rotvec(np.outer(part, [0, 0, angle])).as_quat()
    np.testing.assert_allclose(got, expected, atol=1e-12)
    np.testing.assert_allclose(slerp(np.array([0, 0, 0, 1.0]), -end, part), expected, atol=1e-12)


@given(seeds, st.integers(2, 6))
def test_interpolation_equals_scipy(seed, count):
    rng = np.random.default_rng(seed)
    stamps = np.sort(rng.choice(10**9, count, replace=False))
    poses = [random_pose(rng, BASE_NS + int(stamp)) for stamp in stamps]
    asked = rng.integers(stamps[0], stamps[-1] + 1, 20)
    got = buffer(*[poses[k] for k in rng.permutation(count)]).lookup("map", "base", BASE_NS + asked)
    matrices = np.array([pose.matrix for pose in poses])
    rotation = Slerp(stamps, Rotation.from_matrix(matrices[:, :3, :3]))(asked).as_matrix()
    np.testing.assert_allclose(got[:, :3, :3], rotation, atol=1e-9)
    for axis in range(3):
        expected = np.interp(asked, stamps, matrices[:, axis, 3])
        np.testing.assert_allclose(got[:, axis, 3], expected, rtol=1e-12, atol=1e-9)


def test_chains_run_both_ways_through_the_tree():
    rng = np.random.default_rng(0)
    odom = random_pose(rng, BASE_NS, "map", "odom")
    base = random_pose(rng, BASE_NS, "odom", "base")
    lidar = random_pose(rng, 0, "base", "lidar", is_static=True)
    camera = random_pose(rng, 0, "base", "camera", is_static=True)
    tree = buffer(odom, base, lidar, camera)
    got = tree.lookup("map", "lidar", [BASE_NS])[0]
    np.testing.assert_allclose(got, odom.matrix @ base.matrix @ lidar.matrix, atol=1e-9)
    got = tree.lookup("camera", "lidar", [BASE_NS])[0]
    np.testing.assert_allclose(got, np.linalg.inv(camera.matrix) @ lidar.matrix, atol=1e-9)
    assert tree.root_of("lidar") == "map"
    assert tree.is_static("camera", "lidar")
    assert not tree.is_static("map", "lidar")


def test_times_outside_and_gaps_are_errors():
    poses = [random_pose(np.random.default_rng(k), BASE_NS + k * 10**9) for k in (0, 1, 5)]
    tree = buffer(*poses, max_gap=2.0, max_extrapolation=0.1)
    held = tree.lookup("map", "base", [BASE_NS - 10**8, BASE_NS + 5 * 10**9 + 10**8])
    np.testing.assert_allclose(held[0], poses[0].matrix, atol=1e-9)
    np.testing.assert_allclose(held[1], poses[2].matrix, atol=1e-9)
    for stamp, text in [
        (-2 * 10**8, r"is known from .*, not at \d+ ns \(0\.2 s before the first\)"),
        (3 * 10**9, "has a gap"),
    ]:
        with pytest.raises(lc.io.NoTransformError, match=text):
            tree.lookup("map", "base", [BASE_NS + stamp])
    np.testing.assert_allclose(
        tree.lookup("map", "base", [BASE_NS + 5 * 10**9])[0], poses[2].matrix
    )
    with pytest.raises(lc.io.NoTransformError, match="no transform connects 'map' and 'moon'"):
        tree.lookup("map", "moon", [BASE_NS])


def test_repeated_stamps_use_the_last_pose():
    first, second = (random_pose(np.random.default_rng(k), BASE_NS) for k in (0, 1))
    got = buffer(first, second).lookup("map", "base", [BASE_NS])[0]
    np.testing.assert_allclose(got, second.matrix, atol=1e-12)


def test_loops_between_frames_end():
    rng = np.random.default_rng(0)
    tree = buffer(random_pose(rng, 0, "a", "b"), random_pose(rng, 0, "b", "a"))
    assert tree.root_of("a") in ("a", "b")


# --- posed_scans ----------------------------------------------------------------------------


def cloud_rows(times=True):
    names = [("x", "<f4"), ("y", "<f4"), ("z", "<f4")] + ([("t", "<u4")] if times else [])
    rows = np.ones(5, names)
    if times:
        rows["t"] = np.arange(5) * 20_000_000
    return rows


def recording_of(tmp_path, messages):
    ros = Ros(2)
    made = [(topic, stamp, make(ros)) for topic, stamp, make in messages]
    return ros.write(tmp_path / "bag", sorted(made, key=lambda item: item[1]), "sqlite3")


def clouds(count=5, times=True, topic="/points"):
    for number in range(count):
        stamp = BASE_NS + number * 10**8
        yield topic, stamp, lambda ros, s=stamp: ros.cloud(cloud_rows(times), s, "lidar")


def moves(kind, parent, child, count=13, step_ns=50_000_000):
    for number in range(count):
        stamp = BASE_NS + number * step_ns
        values = [stamp * 1e-9 - BASE_NS * 1e-9, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]
        if kind == "tf":
            yield (
                "/tf",
                stamp,
                lambda ros, s=stamp, v=values: ros.transforms([(s, parent, child, v)]),
            )
        else:
            yield kind, stamp, lambda ros, s=stamp, v=values: ros.odometry(s, parent, child, v)


def mounting(parent="base", child="lidar", z=2.0):
    values = [0.0, 0.0, z, 0.0, 0.0, 0.0, 1.0]
    yield "/tf_static", BASE_NS, lambda ros: ros.transforms([(0, parent, child, values)])


def posed(path, **options):
    with lc.io.open_recording(path) as recording:
        scans = lc.io.posed_scans(recording, **options)
        return list(scans), scans


def test_transforms_give_poses_over_the_scan(tmp_path):
    path = recording_of(tmp_path, [*clouds(), *moves("tf", "map", "base"), *mounting()])
    result, scans = posed(path)
    assert (len(result), scans.fixed_frame, scans.source) == (5, "map", "transforms map -> lidar")
    for number, item in enumerate(result):
        start = BASE_NS + number * 10**8
        np.testing.assert_array_equal(item.pose_stamps_ns - start, [0, 50_000_000, 80_000_000])
        expected = (item.pose_stamps_ns - BASE_NS) * 1e-9
        np.testing.assert_allclose(item.world_from_lidar[:, 0, 3], expected, atol=1e-6)
        np.testing.assert_allclose(item.world_from_lidar[:, 2, 3], 2.0)


def test_without_point_times_one_pose_at_the_stamp(tmp_path):
    path = recording_of(tmp_path, [*clouds(times=False), *moves("tf", "map", "lidar")])
    result, _ = posed(path)
    assert all(item.world_from_lidar.shape == (4, 4) for item in result)
    assert all(item.pose_stamps_ns is None for item in result)


def test_odometry_is_used_where_transforms_do_not_move(tmp_path):
    path = recording_of(tmp_path, [*clouds(), *moves("/odom", "odom", "base"), *mounting()])
    result, scans = posed(path)
    assert (len(result), scans.fixed_frame) == (5, "odom")


def test_odometry_without_child_frame_is_the_sensors(tmp_path):
    path = recording_of(tmp_path, [*clouds(), *moves("/odom", "odom", "")])
    result, scans = posed(path)
    assert (len(result), scans.fixed_frame) == (5, "odom")


def test_an_odometry_topic_can_be_chosen(tmp_path):
    messages = [*clouds(), *moves("tf", "map", "lidar"), *moves("/slam", "world", "lidar")]
    path = recording_of(tmp_path, messages)
    _, scans = posed(path, odom="/slam")
    assert scans.fixed_frame == "world"
    with pytest.raises(ConfigError, match=r"odom: no topic '/other' with poses; found /slam"):
        posed(path, odom="/other")


def test_scans_without_pose_are_left_out_and_counted(tmp_path):
    path = recording_of(tmp_path, [*clouds(count=9), *moves("tf", "map", "lidar", count=5)])
    result, scans = posed(path)
    assert len(result) == 3
    assert sum(scans.without_pose.values()) == 6
    assert all("is known from" in reason for reason in scans.without_pose)


def test_static_needs_no_poses(tmp_path):
    result, scans = posed(recording_of(tmp_path, clouds()), pose="static")
    assert len(result) == 5
    assert scans.source.startswith("static")
    np.testing.assert_array_equal(result[0].world_from_lidar, np.eye(4))


def test_missing_poses_say_what_was_found_and_what_helps(tmp_path):
    path = recording_of(tmp_path, [*clouds(), *moves("/odom", "odom", "base")])
    with pytest.raises(FormatError) as caught:
        posed(path)
    text = str(caught.value)
    for part in (
        str(path),
        "no pose for frame 'lidar' of topic '/points'",
        "odom -> base",
        "odometry topics: /odom",
        "fixed_frame=",
        'pose="static"',
    ):
        assert part in text


def test_a_static_tree_is_no_motion_unless_the_frame_is_named(tmp_path):
    path = recording_of(tmp_path, [*clouds(), *mounting("map", "lidar")])
    with pytest.raises(FormatError, match="nothing moves 'lidar'"):
        posed(path)
    result, _ = posed(path, fixed_frame="map")
    assert result[0].world_from_lidar[0, 2, 3] == 2.0


def test_several_clouds_need_a_choice(tmp_path):
    path = recording_of(tmp_path, [*clouds(), *clouds(topic="/rear")])
    with pytest.raises(ConfigError, match=r"several topics .*: /points, /rear; name one"):
        posed(path, pose="static")
    assert len(posed(path, pose="static", cloud="/rear")[0]) == 5
    with pytest.raises(ConfigError, match=r"cloud: no topic '/front'.*found /points, /rear"):
        posed(path, pose="static", cloud="/front")


def test_a_recording_without_clouds_lists_its_topics(tmp_path):
    path = recording_of(tmp_path, moves("/odom", "odom", "base"))
    with pytest.raises(FormatError, match=r"no clouds to read; found /odom \(nav_msgs/msg/Odom"):
        posed(path, pose="static")


# --- poses files ----------------------------------------------------------------------------


def npz_of(tmp_path, count=3):
    scans = [Scan(BASE_NS + k * 10**8, np.ones((2, 3), np.float32)) for k in range(count)]
    lc.io.write_npz(tmp_path / "scans.npz", scans)
    return tmp_path / "scans.npz"


def test_kitti_poses_by_order(tmp_path):
    rng = np.random.default_rng(0)
    matrices = [random_pose(rng, 0).matrix for _ in range(3)]
    file = tmp_path / "poses.txt"
    np.savetxt(file, [matrix[:3].reshape(-1) for matrix in matrices])
    result, scans = posed(npz_of(tmp_path), pose=str(file))
    for item, matrix in zip(result, matrices, strict=True):
        np.testing.assert_allclose(item.world_from_lidar, matrix, atol=1e-9)
    assert scans.source == f"{file}, 3 poses"
    for count in (2, 4):
        with pytest.raises(FormatError, match="3 poses for"):
            posed(npz_of(tmp_path, count), pose=str(file))
    (middle,), _ = posed(npz_of(tmp_path), pose=str(file), start=0.1, end=0.1 + 1e-9)
    np.testing.assert_allclose(middle.world_from_lidar, matrices[1], atol=1e-9)


def test_a_wrong_number_of_poses_is_refused_before_the_first_scan(tmp_path):
    """Where the recording states the number of its scans, and all of them are read."""
    file = tmp_path / "poses.txt"
    np.savetxt(file, [np.eye(4)[:3].reshape(-1)] * 3)
    for count in (2, 4):
        with lc.io.open_recording(npz_of(tmp_path, count)) as recording:
            scans = lc.io.posed_scans(recording, pose=str(file))
            with pytest.raises(FormatError, match=rf"3 poses for {count} scans of \S+scans\.npz"):
                next(iter(scans))
    with lc.io.open_recording(npz_of(tmp_path, 4)) as recording:
        assert len(list(lc.io.posed_scans(recording, pose=str(file), end=0.2))) == 3


@pytest.mark.parametrize(
    ("pose", "near"), [("sttic", "; did you mean static?"), ("flight/poses.txt", "")]
)
def test_a_mistyped_source_of_poses_is_recognised(tmp_path, pose, near):
    with pytest.raises(FileNotFoundError) as told:
        posed(npz_of(tmp_path), pose=pose)
    assert str(told.value) == f"{pose}: no such poses file{near}"


def test_the_ends_of_a_span_belong_to_it(tmp_path):
    path = npz_of(tmp_path, 8)
    for start, end in ((0.0, 0.3), (0.3, 0.6), (0.7, None)):
        result, _ = posed(path, pose="static", start=start, end=end)
        since = [(item.scan.stamp_ns - BASE_NS) * 1e-9 for item in result]
        np.testing.assert_allclose(since, np.arange(start, (end or 0.7) + 0.05, 0.1), atol=1e-9)


def stamped(tmp_path, *since):
    """A recording of scans at these times [s], and at 0 where there is None."""
    stamps = [0 if one is None else BASE_NS + round(one * 1e9) for one in since]
    path = tmp_path / "stamped.npz"
    lc.io.write_recording(path, [Scan(stamp, np.ones((4, 3), np.float32)) for stamp in stamps])
    return path


def times_of(path, **span):
    result, _ = posed(path, pose="static", **span)
    return [round((item.scan.stamp_ns - BASE_NS) * 1e-9, 6) for item in result]


def test_a_stamp_far_ahead_does_not_end_a_span(tmp_path):
    path = stamped(tmp_path, 0, 0.1, 9e6, 0.2, 0.3, *np.arange(0.4, 2, 0.1))
    assert times_of(path, end=0.3) == [0, 0.1, 0.2, 0.3]


def test_a_span_ends_the_reading(tmp_path, monkeypatch):
    path, read = stamped(tmp_path, *np.arange(0, 5, 0.1)), []
    decode = NpzRecording._scan

    def counted(self, archive, number):
        read.append(number)
        return decode(self, archive, number)

    monkeypatch.setattr(NpzRecording, "_scan", counted)
    assert times_of(path, end=0.3) == [0, 0.1, 0.2, 0.3]
    assert read == [0, *range(4 + posed_module.PAST_THE_END)]  # the first one also for its time


def test_a_first_stamp_that_nobody_set_is_not_the_start(tmp_path):
    path = stamped(tmp_path, None, 0, 0.1, 0.2, 0.3)
    assert times_of(path, start=0.1, end=0.2) == [0.1, 0.2]
    with lc.io.open_recording(path) as recording:
        assert recording.first_stamp() == BASE_NS
    clock = [Scan(k * 10**8, np.ones((4, 3), np.float32)) for k in range(5)]
    lc.io.write_recording(tmp_path / "clock.npz", clock)
    with lc.io.open_recording(tmp_path / "clock.npz") as recording:
        assert recording.first_stamp() == 0
    result, _ = posed(tmp_path / "clock.npz", pose="static", start=0.1, end=0.2)
    assert [item.scan.stamp_ns for item in result] == [10**8, 2 * 10**8]


def test_tum_poses_by_time(tmp_path):
    file = tmp_path / "poses.tum"
    lines = ["# t x y z qx qy qz qw"]
    lines += [f"1700000000.{k:01d}50000000 {k} 0 0 0 0 0 1" for k in range(-0, 3)]
    file.write_text("\n".join(lines) + "\n")
    result, _ = posed(npz_of(tmp_path), pose=str(file))
    np.testing.assert_allclose([item.world_from_lidar[0, 3] for item in result], [0, 0.5, 1.5])


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("1 2 3\n", "expected 12 .* or 8 .* got 3"),
        ("", "no poses"),
        ("0 0 0 0 0 0 0 0\n", "is not a rotation"),
        ("0 0 0 0 0 0 0 nan\n", "not finite"),
        ("2 0 0 0 0 1 0 0 0 0 1 0\n", "pose 0: .*expected a"),
        ("a b c\n", "cannot be read"),
    ],
)
def test_broken_poses_files(tmp_path, text, problem):
    file = tmp_path / "poses.txt"
    file.write_text(text)
    with pytest.raises(FormatError, match=problem):
        posed(npz_of(tmp_path), pose=str(file))


def test_a_missing_poses_file(tmp_path):
    with pytest.raises(FileNotFoundError, match="no such poses file"):
        posed(npz_of(tmp_path), pose="nowhere.txt")


def test_poses_are_known_until_the_first_edge_ends():
    poses = buffer()
    for stamp in (0, 100, 200):
        poses.add(Pose(stamp, "world", "base", np.eye(4)))
    for stamp in (0, 150):
        poses.add(Pose(stamp, "base", "arm", np.eye(4)))
    poses.add(Pose(0, "arm", "lidar", np.eye(4), is_static=True))
    assert poses.known_until("world", "lidar") == 150
    assert poses.known_until("arm", "lidar") is None
    with pytest.raises(lc.io.NoTransformError):
        poses.known_until("world", "elsewhere")


def test_forgotten_poses_are_gone_and_the_last_one_stays():
    poses = buffer(max_extrapolation=0)
    for stamp in (300, 100, 200):
        poses.add(Pose(stamp, "world", "lidar", np.eye(4)))
    poses.lookup("world", "lidar", [100])
    poses.forget(150)
    poses.lookup("world", "lidar", [200, 300])
    with pytest.raises(lc.io.NoTransformError):
        poses.lookup("world", "lidar", [100])
    poses.forget(10**9)
    poses.lookup("world", "lidar", [300])
    with pytest.raises(lc.io.NoTransformError):
        poses.lookup("world", "lidar", [299])


@pytest.mark.parametrize("name", ["start", "end"])
@pytest.mark.parametrize("value", [1e300, float("inf"), float("nan")])
def test_a_span_stays_within_times_in_nanoseconds(name, value):
    assert not lc.io.Span.load({"start": 9e9}).holds(0, 0)
    with pytest.raises(ConfigError, match=f"^{name}: "):
        lc.io.Span.load({name: value})
