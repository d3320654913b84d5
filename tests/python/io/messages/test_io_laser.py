"""2D scans: conventions of drivers, ROS messages, CARMEN logs, round trips, poses."""

import bz2
import gzip
import json
import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from ros_files import Ros
from small_messages import BASE_NS, assert_same_fields
from typer.testing import CliRunner

import lidar_core as lc
import lidar_core.io
from lidar_core.cli import app
from lidar_core.errors import ConfigError, FormatError, LimitError
from lidar_core.io.messages.laser import LaserDecoder
from lidar_core.io.options import ReadOptions
from lidar_core.io.records import Findings
from lidar_core.messages import LaserScan, Pose, Scan

INF, NAN = np.inf, np.nan
STORAGES = [(1, "bag"), (2, "sqlite3"), (2, "mcap")]


def sweep(ranges=(1.0, 2.0, 3.0), **fields):
    values = {"angle_min": -0.1, "angle_increment": 0.05, "range_min": 0.1, "range_max": 10.0}
    made = {"stamp_ns": BASE_NS, "frame_id": "laser", "topic": "/scan"} | values | fields
    return LaserScan(ranges=np.array(ranges, np.float32), **made)


def decode(raw, **options):
    findings = Findings()
    decoder = LaserDecoder(raw.topic, ReadOptions(**options), findings)
    return decoder.scan(raw, place="here"), findings


# What ranges mean


@pytest.mark.parametrize(
    ("ranges", "expected", "verdict"),
    [
        ([1, INF, NAN, -INF], [1, INF, NAN, -INF], "inf: 1 of 4"),
        ([1, INF, 0, 0.05, 12], [1, INF, NAN, NAN, INF], "inf: 1 of 5"),
        ([1, 0, 0, 0.05], [1, INF, INF, NAN], "zero: 2 of 4"),
        ([1, 10, 10.5, NAN], [1, INF, INF, NAN], "max: 2 of 4"),
        ([1, 0.05, NAN, -3], [1, NAN, NAN, NAN], "none seen"),
    ],
)
def test_conventions_are_detected(ranges, expected, verdict):
    scan, findings = decode(sweep(ranges))
    np.testing.assert_array_equal(scan.ranges, np.array(expected, np.float32))
    assert findings.no_return["/scan"].startswith(verdict)


@pytest.mark.parametrize(
    ("choice", "expected"),
    [
        ("zero", [1, INF, NAN, INF, 10]),
        ("nan", [1, NAN, INF, INF, 10]),
        ("max", [1, NAN, NAN, INF, INF]),
        ("none", [1, NAN, NAN, INF, 10]),
    ],
)
def test_the_option_overrides_the_detection(choice, expected):
    scan, findings = decode(sweep([1, 0, NAN, INF, 10]), no_return=choice)
    np.testing.assert_array_equal(scan.ranges, np.array(expected, np.float32))
    assert "set by the option no_return" in findings.no_return["/scan"]


def test_nothing_beyond_the_range_tells_nothing_where_no_mark_is_wanted():
    scan, _ = decode(sweep([1, 10.5]), no_return="none")
    np.testing.assert_array_equal(scan.ranges, [1, NAN])


def test_zeros_after_misses_are_no_information():
    decoder = LaserDecoder("/scan", ReadOptions(), Findings())
    assert not np.isinf(decoder.scan(sweep([1, 2]), place="a").ranges).any()
    assert np.isinf(decoder.scan(sweep([1, INF]), place="b").ranges[1])
    assert np.isnan(decoder.scan(sweep([1, 0]), place="c").ranges[1])


def rays_with(value, *, at=(), others=2.0):
    """100 rays at `others`, those `at` some places with `value`."""
    ranges = np.full(100, others)
    ranges[list(at)] = value
    return sweep(ranges, angle_increment=0.01)


def test_one_value_of_another_kind_does_not_change_the_meaning():
    """A zero of a bad ray in the first scan is no miss; one +inf later does not stop zeros."""
    findings = Findings()
    decoder = LaserDecoder("/scan", ReadOptions(), findings)
    assert np.isnan(decoder.scan(rays_with(0, at=[5]), place="a").ranges[5])
    assert findings.no_return["/scan"].startswith("none seen")
    for _ in range(5):
        scan = decoder.scan(rays_with(0, at=range(20, 50)), place="b")
        assert np.isposinf(scan.ranges[20:50]).all()
    mixed = rays_with(0, at=range(20, 50))
    mixed.ranges[60] = INF
    scan = decoder.scan(mixed, place="c")
    assert np.isposinf(scan.ranges[[*range(20, 50), 60]]).all()
    assert findings.no_return["/scan"] == "zero: 30 of 100 ranges of a scan are zero"


def test_nan_of_rays_that_work_is_no_return_and_a_mask_is_not():
    """A robot drives off: other rays have no return in every scan; ten rays never have one."""
    findings = Findings()
    decoder = LaserDecoder("/scan", ReadOptions(), findings)
    for number in range(60):
        gap = {(number + ray) % 90 for ray in range(30)}
        scan = decoder.scan(rays_with(NAN, at=gap | set(range(90, 100))), place="a")
    assert findings.no_return["/scan"].startswith("nan: ")
    assert np.isposinf(scan.ranges[sorted(gap - set(range(80, 90)))]).all()
    assert np.isnan(scan.ranges[90:]).all()
    masked = LaserDecoder("/scan", ReadOptions(), findings)
    for _ in range(60):
        scan = masked.scan(rays_with(NAN, at=range(90, 100)), place="b")
    assert np.isnan(scan.ranges[90:]).all()
    assert findings.no_return["/scan"].startswith("none seen")


@given(
    st.lists(st.floats(width=32), min_size=1, max_size=40),
    st.sampled_from(["auto", "zero", "nan", "max", "none"]),
)
def test_every_range_is_a_hit_a_miss_or_no_information(ranges, choice):
    scan, _ = decode(sweep(ranges, angle_increment=0.01), no_return=choice)
    hits = scan.ranges[np.isfinite(scan.ranges)]
    assert ((hits >= np.float32(0.1)) & (hits <= 10)).all()
    raw = np.array(ranges, np.float32)
    inside = (raw >= np.float32(0.1)) & (raw < 10)
    np.testing.assert_array_equal(scan.ranges[inside], raw[inside])


@pytest.mark.parametrize(
    ("step", "kept", "verdict"),
    [
        (25_000, 25_000, "time_increment of 25000 ns, a sweep of 25 ms"),
        (0, 0, "none: time_increment is zero"),
        (200, 0, "ignored: time_increment of 200 ns, a sweep of 0.2 ms, which no scanner takes"),
        (-25_000, 0, "ignored: time_increment of -25000 ns"),
    ],
)
def test_the_time_of_a_sweep_is_used_if_it_can_be(step, kept, verdict):
    raw = sweep(np.ones(1001), angle_increment=0.005, time_increment_ns=step)
    scan, findings = decode(raw)
    assert scan.time_increment_ns == kept
    assert findings.point_time["/scan"].startswith(verdict)
    assert decode(raw, point_time="none")[0].time_increment_ns == 0


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"angle_increment": 0.0}, "at most one turn"),
        ({"angle_increment": 3.0}, "at most one turn"),
        ({"angle_min": NAN}, "at most one turn"),
        ({"range_max": 0.1}, "expected 0 <= range_min < range_max"),
        ({"range_min": -1.0}, "expected 0 <= range_min < range_max"),
        ({"range_max": NAN}, "expected 0 <= range_min < range_max"),
    ],
)
def test_scanners_that_cannot_be_are_refused(changes, text):
    with pytest.raises(FormatError, match=text):
        decode(sweep(**changes))


def test_too_many_rays_name_the_option():
    with pytest.raises(LimitError, match="max_points"):
        decode(sweep(), max_points=2)


def test_intensities_that_do_not_fit_are_left_out():
    scan, findings = decode(sweep(intensity=np.ones(2, np.float32)))
    assert scan.intensity is None
    assert findings.notes == ["/scan: intensities left out, not one per ray"]


# ROS


def ros_scan(ros, scan, kind="LaserScan"):
    ranges, intensities = scan.ranges, scan.intensity
    if kind == "MultiEchoLaserScan":
        echo = ros.types["sensor_msgs/msg/LaserEcho"]
        ranges = [echo(np.array([v, v + 5], np.float32)[: 0 if v == 0 else 2]) for v in ranges]
        intensities = []
    elif intensities is None:
        intensities = np.empty(0, np.float32)
    return ros.types[f"sensor_msgs/msg/{kind}"](
        ros.header(scan.stamp_ns, scan.frame_id),
        scan.angle_min,
        scan.angle_min + scan.angle_increment * (len(scan.ranges) - 1),
        scan.angle_increment,
        scan.time_increment_ns * 1e-9,
        0.1,
        scan.range_min,
        scan.range_max,
        ranges,
        intensities,
    )


@pytest.mark.parametrize(("version", "storage"), STORAGES)
@pytest.mark.parametrize("kind", ["LaserScan", "MultiEchoLaserScan"])
def test_ros_scans(tmp_path, version, storage, kind):
    ros = Ros(version)
    given_scan = sweep(
        [1, 0, 3], time_increment_ns=10**7, range_min=0.125, angle_min=-0.5, angle_increment=0.25
    )  # exact in float32
    path = ros.write(
        tmp_path / ("a.bag" if version == 1 else "a"),
        [("/scan", BASE_NS, ros_scan(ros, given_scan, kind))],
        storage,
    )
    with lc.io.open_recording(path) as recording:
        (scan,) = recording
        info = recording.info()
    assert_same_fields(
        scan,
        sweep(
            [1, INF, 3],
            time_increment_ns=10**7,
            range_min=0.125,
            angle_min=-0.5,
            angle_increment=0.25,
        ),
    )
    (topic,) = info.topics
    assert (topic.kind, topic.rays, topic.points) == ("planar", 3, 2)
    assert info.no_return == {"/scan": "zero: 1 of 3 ranges of a scan are zero"}
    assert any("first echo" in text for text in info.defects) == (kind != "LaserScan")


def test_a_ros_scan_that_cannot_be_is_counted(tmp_path):
    ros = Ros(1)
    scans = [sweep(range_max=0.0), sweep(stamp_ns=BASE_NS + 1)]
    messages = [("/scan", scan.stamp_ns, ros_scan(ros, scan)) for scan in scans]
    path = ros.write(tmp_path / "a.bag", messages, "bag")
    with lc.io.open_recording(path) as recording:
        assert [scan.stamp_ns for scan in recording] == [BASE_NS + 1]
        assert recording.noticed().rejected == {"/scan": 1}
        assert any("range_min < range_max" in text for text in recording.noticed().notes)


# Round trips


def random_sweeps(seed, count):
    rng = np.random.default_rng(seed)
    made = []
    for number in range(count):
        rays = int(rng.integers(1, 30))
        ranges = rng.uniform(0.1, 10, rays).astype(np.float32)
        ranges[rng.random(rays) < 0.2] = INF
        ranges[rng.random(rays) < 0.2] = NAN
        made.append(
            sweep(
                ranges,
                stamp_ns=BASE_NS + number * 50_000_000,
                angle_min=float(rng.uniform(-3, 0)),
                angle_increment=float(rng.choice([-0.1, 0.1])) / 3,
                range_max=float(rng.choice([10.0, 30.0])),
                time_increment_ns=int(rng.integers(0, 20_000)),
                intensity=rng.random(rays).astype(np.float32) if number % 2 else None,
                frame_id="front",
            )
        )
    return made


@pytest.mark.parametrize("name", ["a.npz", "a.mcap"])
@given(seed=st.integers(0, 1000))
def test_2d_scans_come_back_as_written(tmp_path_factory, name, seed):
    path = tmp_path_factory.mktemp("sweeps") / name
    scans = random_sweeps(seed, 3)
    pose = Pose(BASE_NS, "world", "front", np.eye(4), topic="/tf")
    (lc.io.write_npz if name.endswith("npz") else lc.io.write_mcap)(path, [pose, *scans])
    with lc.io.open_recording(path) as recording:
        back = [item for item in recording if isinstance(item, LaserScan)]
        kinds = {topic.name: topic.kind for topic in recording.topics()}
    for a, b in zip(scans, back, strict=True):
        assert_same_fields(a, b)
    assert kinds == {"/scan": "planar", "/tf": "pose"}


def test_2d_and_3d_scans_share_a_file(tmp_path):
    cloud = Scan(BASE_NS + 1, np.ones((2, 3), np.float32), topic="/points")
    lc.io.write_npz(tmp_path / "a.npz", [sweep(), cloud])
    with lc.io.open_recording(tmp_path / "a.npz") as recording:
        assert [type(item) for item in recording] == [LaserScan, Scan]
        assert len(list(recording.records(frozenset({"planar"})))) == 1


def test_an_npz_whose_scanner_is_missing_is_refused(tmp_path):
    lc.io.write_npz(tmp_path / "a.npz", [sweep()])
    with np.load(tmp_path / "a.npz") as members:
        arrays = {name: members[name] for name in members.files if name != "laser_scanner"}
    np.savez(tmp_path / "b.npz", **arrays)
    with pytest.raises(FormatError, match=r"b\.npz"):
        lc.io.open_recording(tmp_path / "b.npz")


# CARMEN logs

HEADER = "# CARMEN Logfile\nPARAM robot_frontlaser_offset 0.0 nohost 0\n"


def flaser(ranges, pose=(1.0, 2.0, 0.5), stamp="100.000000001", name="FLASER"):
    values = " ".join(map(str, ranges))
    x, y, angle = pose
    return f"{name} {len(ranges)} {values} {x} {y} {angle} 0 0 0 {stamp} host 0.1\n"


def log(tmp_path, text, name="a.clf"):
    path = tmp_path / name
    data = text.encode()
    pack = {"bz2": bz2.compress, "gz": gzip.compress}.get(name.rsplit(".")[-1], bytes)
    path.write_bytes(pack(data))
    return path


def read(path, **options):
    with lc.io.open_recording(path, **options) as recording:
        return list(recording)


def assert_same_poses(alone, messages):
    """Poses that were read without the readings beside them are those among all messages."""
    among = [item for item in messages if isinstance(item, Pose)]
    assert len(alone) == len(among) > 0
    for one, other in zip(alone, among, strict=True):
        assert (one.stamp_ns, one.frame_id, one.child_frame_id, one.topic) == (
            other.stamp_ns,
            other.frame_id,
            other.child_frame_id,
            other.topic,
        )
        np.testing.assert_array_equal(one.matrix, other.matrix)


@pytest.mark.parametrize("name", ["a.clf", "a.clf.bz2", "a.log", "a.gfs.log", "a.log.gz"])
def test_a_log_gives_scans_and_the_odometry_they_belong_to(tmp_path, name):
    text = HEADER + "ODOM 1 2 0.5 0 0 0 99.5 host 0\n" + flaser([2.0] * 180)
    odometry, pose, scan = read(log(tmp_path, text, name))
    assert (odometry.frame_id, odometry.child_frame_id) == ("odom", "base_link")
    assert odometry.stamp_ns == 99_500_000_000
    assert (pose.child_frame_id, pose.stamp_ns) == ("front_laser", 100_000_000_001)
    np.testing.assert_allclose(pose.matrix[:2, 3], [1, 2])
    assert np.arctan2(pose.matrix[1, 0], pose.matrix[0, 0]) == pytest.approx(0.5)
    assert scan.frame_id == "front_laser"
    assert scan.angle_min == pytest.approx(-np.pi / 2)
    assert scan.angle_increment == pytest.approx(np.pi / 180)
    assert scan.range_max == 80.0


@pytest.mark.parametrize(("limit", "far"), [(50.0, 50.0), (81.91, 80.0)])
def test_the_limit_of_a_log_is_that_of_its_readings(tmp_path, limit, far):
    """Readings at the greatest value of a log are no returns; so are the codes of a SICK LMS."""
    lines = [flaser([2.0, limit, 3.0] * 60, stamp=f"{n}.0") for n in range(10)]
    messages = read(log(tmp_path, HEADER + "".join(lines)))
    scans = [item for item in messages if isinstance(item, LaserScan)]
    assert {scan.range_max for scan in scans} == {far}
    for scan in scans:
        np.testing.assert_array_equal(scan.ranges, np.array([2, INF, 3] * 60, np.float32))


def test_the_limit_that_a_log_states_counts(tmp_path):
    text = "PARAM robot_front_laser_max 30.0 host 0\n" + flaser([2.0, 40.0] * 90)
    _, scan = read(log(tmp_path, text))
    assert scan.range_max == 30.0
    assert np.isinf(scan.ranges[1::2]).all()


def test_newer_scans_state_their_scanner(tmp_path):
    scanner = "0 -1.0 2.0 0.5 20.0 0.01 1 5 1 2 30 4 5 3 .1 .2 .3"
    text = (
        f"RAWLASER1 {scanner} 7.5 host 7.5\n"
        f"ROBOTLASER1 {scanner} 1 2 0.5 1 2 0.5 0 0 0.1 0.1 0 7.75 host 7.75\n"
    )
    path = log(tmp_path, text)
    raw, pose, scan = read(path)
    with lc.io.open_recording(path) as recording:
        assert_same_poses([one for _, one in recording.poses()], [pose])
    assert (raw.stamp_ns, scan.stamp_ns) == (7_500_000_000, 7_750_000_000)
    for item in (raw, scan):
        assert (item.angle_min, item.angle_increment, item.range_max) == (-1.0, 0.5, 20.0)
        np.testing.assert_array_equal(item.ranges, np.array([1, 2, INF, 4, 5], np.float32))
        assert item.frame_id == "laser_1"
    np.testing.assert_allclose(pose.matrix[:2, 3], [1, 2])


@pytest.mark.parametrize(
    ("line", "text"),
    [
        ("FLASER 180 1 2 3\n", "line 4: FLASER states '180' readings, 4 values follow"),
        ("FLASER x 1 2 3\n", "line 4: FLASER states 'x' readings"),
        ("FLASER\n", "line 4: FLASER states 'no' readings"),
        ("FLASER 2 1 2 0 0 0 0\n", "line 4: FLASER ends early"),
        ("FLASER 2 1 b 0 0 0 0 0 0 1 h 1\n", "line 4: FLASER holds text"),
        ("ODOM 1 2 nan 0 0 0 1.0 h 1\n", "line 4: pose 1.0 2.0 nan is not finite"),
        ("ODOM 1 2 3 0 0 0\n", "line 4: ODOM ends early"),
        ("FLASER 2 1 2 0 0 0 0 0 0 inf h 1\n", "line 4: FLASER has no time"),
    ],
)
def test_broken_lines_are_counted_and_named(tmp_path, line, text):
    good = flaser([2.0] * 180)
    path = log(tmp_path, HEADER + good + line + good.replace("100.0", "101.0"))
    with lc.io.open_recording(path) as recording:
        alone = [pose for _, pose in recording.poses()]
        assert_same_poses(alone, recording)
        for _ in range(2):  # told once, however often it is read
            scans = [item for item in recording if isinstance(item, LaserScan)]
            assert [scan.stamp_ns for scan in scans] == [100_000_000_001, 101_000_000_001]
            assert recording.findings.rejected == {line.split()[0]: 1}
            (note,) = recording.findings.notes
            assert text in note


def test_a_log_with_nothing_but_broken_lines_is_refused(tmp_path):
    with pytest.raises(FormatError, match="line 3: FLASER states '180' readings"):
        read(log(tmp_path, HEADER + "FLASER 180 1 2\n" * 3))


def test_other_texts_and_long_lines_are_refused(tmp_path):
    with pytest.raises(FormatError, match="not a CARMEN log: found none of ODOM, FLASER"):
        lc.io.open_recording(log(tmp_path, "hello\n" * 2000))
    with pytest.raises(LimitError, match="line 1: a line of more than 100 bytes"):
        lc.io.open_recording(log(tmp_path, "x" * 1000), max_record_bytes=100)
    with pytest.raises(FormatError, match="line 1: cannot be read"):
        lc.io.open_recording(log(tmp_path, "x").rename(tmp_path / "b.clf.bz2"))
    with pytest.raises(FormatError, match=r"JSON holds no scans.*lidar-core fuse"):
        lc.io.open_recording(log(tmp_path, "{}", "a.json"))


@given(st.binary(max_size=400))
def test_noise_in_a_log_raises_nothing_else(tmp_path_factory, noise):
    path = tmp_path_factory.mktemp("noise") / "a.clf"
    path.write_bytes(flaser([2.0] * 4).encode() + noise)
    try:
        messages = read(path)
    except (FormatError, LimitError):
        return
    assert isinstance(messages[1], LaserScan)


# Poses of 2D scans


def moving(count=5):
    for number in range(count):
        stamp = BASE_NS + number * 100_000_000
        matrix = np.eye(4)
        matrix[0, 3] = number
        yield Pose(stamp, "map", "body", matrix, topic="/tf")
        yield sweep(stamp_ns=stamp, time_increment_ns=10_000_000)


def posed(path, **options):
    with lc.io.open_recording(path) as recording:
        scans = lc.io.posed_laser_scans(recording, **options)
        return list(scans), scans


def test_a_mounting_stands_in_for_a_missing_transform(tmp_path):
    path = tmp_path / "a.npz"
    lc.io.write_npz(path, moving())
    with pytest.raises(FormatError, match="the mounting of the sensor with mounting="):
        posed(path)
    items, scans = posed(path, mounting=["body laser 0.5 0 1 0 0 1.5707963267948966"])
    assert scans.fixed_frame == "map"
    world_from_laser = items[2].world_from_lidar[0]
    np.testing.assert_allclose(world_from_laser[:3, 3], [2.5, 0, 1], atol=1e-12)
    np.testing.assert_allclose(world_from_laser[:3, 0], [0, 1, 0], atol=1e-12)


def test_poses_follow_the_sweep(tmp_path):
    lc.io.write_npz(tmp_path / "a.npz", moving())
    items, _ = posed(tmp_path / "a.npz", mounting=["body laser 0 0 0 0 0 0"])
    stamps = items[0].pose_stamps_ns - BASE_NS
    np.testing.assert_array_equal(stamps, [0, 20_000_000])
    np.testing.assert_allclose(items[0].world_from_lidar[:, 0, 3], [0, 0.2], atol=1e-12)


def test_a_mounting_also_holds_for_standing_sensors_and_poses_files(tmp_path):
    lc.io.write_npz(tmp_path / "a.npz", [sweep(), sweep(stamp_ns=BASE_NS + 10**8)])
    mounting = ["body laser 0.5 0 1 0 0 0"]
    items, scans = posed(tmp_path / "a.npz", pose="static", mounting=mounting)
    assert scans.fixed_frame == "body"
    np.testing.assert_allclose(items[0].world_from_lidar[:3, 3], [0.5, 0, 1])
    poses = tmp_path / "poses.txt"
    poses.write_text("".join(f"{BASE_NS // 10**9 + n} {n} 0 0 0 0 0 1\n" for n in range(3)))
    items, _ = posed(tmp_path / "a.npz", pose=str(poses), mounting=mounting)
    np.testing.assert_allclose(items[0].world_from_lidar[0, 3], 0.5 + 0.123456789)


@pytest.mark.parametrize(
    "text", ["", "body laser 1 2 3", "body laser 1 2 3 4 5 x", "body laser 1 2 3 4 5 nan"]
)
def test_mountings_that_cannot_be_read(text):
    with pytest.raises(ConfigError, match="mounting"):
        lc.io.PoseOptions(mounting=[text])


def test_roll_pitch_and_yaw_turn_about_fixed_axes():
    rng = np.random.default_rng(900)
    rotations = pytest.importorskip("scipy.spatial.transform")
    for angles in rng.uniform(-3, 3, (20, 3)):
        text = " ".join(map(repr, angles.tolist()))
        (pose,) = lc.io.PoseOptions(mounting=[f"a b 0 0 0 {text}"]).mountings()
        expected = rotations.Rotation.from_euler("xyz", angles).as_matrix()
        np.testing.assert_allclose(pose.matrix[:3, :3], expected, atol=1e-12)


def test_clouds_and_2d_scans_are_not_mixed_up(tmp_path):
    lc.io.write_npz(tmp_path / "a.npz", moving())
    with lc.io.open_recording(tmp_path / "a.npz") as recording:
        with pytest.raises(FormatError, match="no clouds to read; found /scan"):
            lc.io.posed_scans(recording)
        with pytest.raises(ConfigError, match="scan: no topic '/no' with 2D scans"):
            lc.io.posed_laser_scans(recording, cloud="/no")


# Real recordings

BAGS = {
    "datmo/intersection.bag": {"/scan": (85, 360, "inf")},
    "datmo/overtake_ego.bag": {"/scan": (135, 360, "inf")},
    "datmo/overtake_red.bag": {"/scan": (130, 360, "inf")},
    "datmo/parallel.bag": {"/scan": (219, 360, "inf")},
    "leg_tracker/demo_stationary_simple_environment.bag": {"/scan": (1265, 512, "inf")},
    "leg_tracker/positive_6.bag": {"/rear_scan": (355, 768, "zero")},
    "leg_tracker/positive_6_extracted.bag": {"/training_scan": (187, 768, "zero")},
    "obstacle_detector/scans_demo.bag": {
        "/front_scan": (331, 726, "none"),
        "/rear_scan": (330, 726, "nan"),
    },
    "sick_rms_lms/rms_1xxx_lms_1xx_movement_off.bag": {"/sick_lms_1xx/scan": (89, 541, "zero")},
    "radish/aces.clf.bz2": {"FLASER": (7374, 180, "max")},
    "radish/fr079.clf.bz2": {"FLASER": (4934, 360, "max")},
    "radish/intel.clf.bz2": {"FLASER": (13631, 180, "max")},
    "radish/mit-csail.clf.bz2": {"FLASER": (1988, 361, "max")},
}


LONG = {"radish/fr079.clf.bz2", "radish/intel.clf.bz2"}
"""Logs that take long to unpack; two others have their format."""


@pytest.mark.ci_cases(
    "datmo/intersection*", "leg_tracker/positive_6.bag*", "obstacle*", "sick*", "radish/mit*"
)
@pytest.mark.parametrize(
    ("name", "expected"),
    [
        pytest.param(*one, marks=[pytest.mark.nightly] if one[0] in LONG else [])
        for one in BAGS.items()
    ],
)
def test_info_opens_every_2d_recording(recordings, name, expected):
    result = CliRunner().invoke(app, ["info", str(recordings / "2d" / name), "--json"])
    assert result.exit_code == 0, result.output
    info = json.loads(result.stdout)
    found = {
        topic["name"]: (topic["count"], topic["rays"], re.match(r"\w+", verdict)[0])
        for topic in info["topics"]
        if topic["kind"].startswith("planar")
        for verdict in [info["no_return"][topic["name"]]]
    }
    assert found == expected
    assert info["duration_s"] > 0.3


def test_every_file_of_2d_opens_or_is_refused_in_words(recordings):
    for file in sorted((recordings / "2d").rglob("*")):
        known = str(file.relative_to(recordings / "2d")) in BAGS
        if file.is_file() and not known:
            with pytest.raises(
                FormatError, match=r"holds no scans|unknown format|not read|not a recording"
            ):
                lc.io.open_recording(file)


def test_a_moving_sensor_with_motion_capture(recordings):
    items, scans = posed(
        recordings / "2d/datmo/parallel.bag", mounting=["ego_pose laser -0.12 0 0 0 0 0"]
    )
    assert scans.fixed_frame == "map"
    assert 200 <= len(items) <= 219
    moved = np.ptp([item.world_from_lidar[:2, 3] for item in items], axis=0)
    assert moved.max() > 1


def test_two_scanners_of_one_robot(recordings):
    mounting = [
        "robot front_scanner 0.23565 -0.0005 0.06795 0 0 0",
        "robot rear_scanner -0.23832 0.00542 0.09888 0 0 3.141592",
    ]
    sums = {}
    for topic in ("/front_scan", "/rear_scan"):
        items, _ = posed(
            recordings / "2d/obstacle_detector/scans_demo.bag",
            cloud=topic,
            pose="static",
            mounting=mounting,
        )
        sums[topic] = items[0].world_from_lidar[0, 3]
    assert sums == {"/front_scan": 0.23565, "/rear_scan": -0.23832}
