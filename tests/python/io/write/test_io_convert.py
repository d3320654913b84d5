"""Recordings in other formats: what goes in comes out, with rosbags as the judge of its formats."""

import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from ros_files import ROS1, ROS2
from rosbags.highlevel import AnyReader
from small_messages import BASE_NS, assert_same_fields, make_pose, make_scan
from typer.testing import CliRunner

import lidar_core as lc
import lidar_core.io
from lidar_core.cli import app
from lidar_core.errors import ConfigError, InputError
from lidar_core.messages import LaserScan, Pose, Scan

NAMES = ["a.npz", "a.mcap", "a.bag", "a"]
ROS = ["a.bag", "a"]


def make_sweep(seed=0, rays=7, stamp_ns=BASE_NS):
    rng = np.random.default_rng(seed)
    ranges = rng.uniform(0.2, 9, rays).astype(np.float32)
    ranges[::3], ranges[1::5] = np.inf, np.nan
    return LaserScan(
        stamp_ns=stamp_ns,
        ranges=ranges,
        angle_min=-1.5,
        angle_increment=0.25,
        range_min=0.125,
        range_max=10.0,
        intensity=rng.random(rays).astype(np.float32),
        time_increment_ns=1_000_000,
        topic="/scan",
    )


def everything(seed=0):
    """A mounting without a time, then scans and poses of every sort in time order."""
    step = 50_000_000
    covariance = np.diag(np.arange(1.0, 7.0)) * 1e-3
    return [
        replace(make_pose(seed, 0, is_static=True), child_frame_id="os_sensor"),
        make_pose(seed + 1, BASE_NS),
        make_scan(seed, stamp_ns=BASE_NS + step),
        make_sweep(seed, stamp_ns=BASE_NS + 2 * step),
        replace(make_pose(seed + 2, BASE_NS + 3 * step), covariance=covariance, topic="/odom"),
        make_scan(seed + 3, shape=(1, 9), stamp_ns=BASE_NS + 4 * step),
    ]


def read(path):
    with lc.io.open_recording(path) as recording:
        return list(recording)


def assert_same(given, found, *, covariance=True):
    assert type(given) is type(found)
    if isinstance(given, Scan):
        assert_same_fields(replace(given, points=given.points.reshape(found.points.shape)), found)
    elif isinstance(given, Pose):
        np.testing.assert_allclose(found.matrix, given.matrix, rtol=0, atol=1e-9)
        for name in ("stamp_ns", "frame_id", "child_frame_id", "is_static", "topic"):
            assert getattr(found, name) == getattr(given, name), name
        if given.covariance is not None and covariance:
            np.testing.assert_array_equal(found.covariance, given.covariance)
    else:
        np.testing.assert_array_equal(found.ranges, given.ranges)
        np.testing.assert_array_equal(found.intensity, given.intensity)
        for name in ("angle_min", "angle_increment", "range_min", "range_max"):
            assert getattr(found, name) == pytest.approx(getattr(given, name), rel=1e-6), name
        for name in ("stamp_ns", "frame_id", "time_increment_ns", "topic"):
            assert getattr(found, name) == getattr(given, name), name


def stored_arrivals(path):
    with lc.io.open_recording(path) as recording:
        return [(type(one), one.stamp_ns, arrival) for one, arrival in recording.arrivals()]


@pytest.fixture
def sent_early(tmp_path):
    """A ROS 2 recording: transforms come 0.3 s before their times, scans 0.1 s after theirs."""
    second = 10**9
    with lidar_core.io.RosWriter(tmp_path / "in") as writer:
        for number in range(8):
            at = BASE_NS + number * second // 10
            writer.write(make_pose(number, at + 3 * second // 10), log_time_ns=at)
            scan = make_scan(number, stamp_ns=at - second // 10)
            writer.write(scan, log_time_ns=at + 1000)
    return tmp_path / "in"


@pytest.mark.parametrize("name", ["b.mcap", "b.bag", "b"])
def test_times_of_arrival_are_kept_beside_stamps(sent_early, tmp_path, name):
    before = stored_arrivals(sent_early)
    assert len(before) == 16
    assert all(arrival not in (None, stamp) for _, stamp, arrival in before)
    result = CliRunner().invoke(app, ["convert", str(sent_early), str(tmp_path / name)])
    assert result.exit_code == 0, result.output
    assert stored_arrivals(tmp_path / name) == before


@pytest.mark.parametrize("name", ["c.mcap", "c.bag", "c"])
def test_a_format_without_arrivals_gives_copies_at_the_times_of_the_stamps(tmp_path, name):
    lc.io.write_recording(tmp_path / "a.npz", everything()[1:])
    assert {arrival for *_, arrival in stored_arrivals(tmp_path / "a.npz")} == {None}
    result = CliRunner().invoke(app, ["convert", str(tmp_path / "a.npz"), str(tmp_path / name)])
    assert result.exit_code == 0, result.output
    assert all(stamp == arrival for _, stamp, arrival in stored_arrivals(tmp_path / name))


def test_counted_stamps_are_no_arrivals(sent_early):
    with lc.io.open_recording(sent_early, stamps="counted", scan_rate=10) as recording:
        assert {arrival for _, arrival in recording.arrivals()} == {None}


@pytest.mark.parametrize("name", NAMES)
def test_what_goes_in_comes_out(tmp_path, name):
    items = everything()
    if name == "a.mcap":  # its poses have one topic and no covariance
        items[4] = replace(items[4], topic="/tf")
    lc.io.write_recording(tmp_path / name, items)
    found = read(tmp_path / name)
    assert len(found) == len(items)
    by_stamp = sorted(items, key=lambda item: item.stamp_ns)
    for given_item, item in zip(by_stamp, found, strict=True):
        assert_same(given_item, item, covariance=name != "a.mcap")


@pytest.mark.nightly
@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), rows=st.integers(1, 5), columns=st.integers(1, 9))
def test_clouds_of_any_size_come_out_of_bags(tmp_path_factory, seed, rows, columns):
    folder = tmp_path_factory.mktemp("bags")
    scan = make_scan(seed, shape=(rows, columns))
    for name in ROS:
        lc.io.write_recording(folder / name, [scan])
        assert_same(scan, read(folder / name)[0])


@pytest.mark.parametrize("name", ROS)
def test_ros_tools_read_what_is_written(tmp_path, name):
    """rosbags' own reader and definitions: types, times, and the values of every message."""
    items = everything()
    lc.io.write_ros(tmp_path / name, items)
    with AnyReader([tmp_path / name]) as reader:
        types = {item.topic: item.msgtype for item in reader.connections}
        stored = [
            (item.topic, time, reader.deserialize(raw, item.msgtype))
            for item, time, raw in reader.messages()
        ]
    assert types == {
        "/tf_static": "tf2_msgs/msg/TFMessage",
        "/tf": "tf2_msgs/msg/TFMessage",
        "/points": "sensor_msgs/msg/PointCloud2",
        "/scan": "sensor_msgs/msg/LaserScan",
        "/odom": "nav_msgs/msg/Odometry",
    }
    assert [time for _, time, _ in stored] == [BASE_NS, *(item.stamp_ns for item in items[1:])]
    cloud = next(message for topic, _, message in stored if topic == "/points")
    assert (cloud.height, cloud.width, cloud.is_dense) == (4, 6, False)
    assert cloud.header.frame_id == "os_sensor"
    x = np.ndarray(24, "<f4", cloud.data.data, 0, cloud.point_step)
    np.testing.assert_array_equal(x, items[2].points.reshape(-1, 3)[:, 0])
    sweep = next(message for topic, _, message in stored if topic == "/scan")
    assert sweep.angle_max == pytest.approx(-1.5 + 6 * 0.25)
    assert sweep.scan_time == pytest.approx(0.007)
    odometry = next(message for topic, _, message in stored if topic == "/odom")
    np.testing.assert_array_equal(odometry.pose.covariance, items[4].covariance.reshape(-1))
    store = ROS1 if name == "a.bag" else ROS2
    assert "sensor_msgs/msg/PointCloud2" in store.types


@pytest.mark.parametrize("name", NAMES)
def test_a_failure_leaves_nothing_and_ctrl_c_a_whole_file_or_nothing(tmp_path, name):
    def broken(error):
        yield from everything()[:3]
        raise error

    with pytest.raises(ValueError, match="no more"):
        lc.io.write_recording(tmp_path / name, broken(ValueError("no more")))
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(KeyboardInterrupt):
        lc.io.write_recording(tmp_path / name, broken(KeyboardInterrupt()))
    left = list(tmp_path.iterdir())
    assert left in ([], [tmp_path / name])
    if left:
        assert len(read(tmp_path / name)) == 3


def test_mountings_alone_are_kept(tmp_path):
    mounting = make_pose(0, BASE_NS, is_static=True)
    lc.io.write_ros(tmp_path / "a.bag", [mounting])
    assert_same(mounting, read(tmp_path / "a.bag")[0])


@pytest.mark.parametrize(
    ("item", "text"),
    [
        (make_pose(0, -1), "ROS 1 holds times from 1970 on to 4294967295 s, got -1"),
        (make_pose(0, 2**32 * 10**9), "got 4294967296000000000"),
        (replace(make_scan(), point_time_ns=np.full(24, BASE_NS + 3 * 10**9)), "within 2.1 s"),
    ],
)
def test_times_that_ros_cannot_hold_are_refused(tmp_path, item, text):
    with pytest.raises(InputError, match=text):
        lc.io.write_ros(tmp_path / "a.bag", [item])
    assert list(tmp_path.iterdir()) == []


def test_folders_and_endings_are_checked_before_anything_is_written(tmp_path):
    with pytest.raises(InputError, match="exists already; a ROS 2 recording is a new folder"):
        lc.io.write_recording(tmp_path, everything())
    with pytest.raises(ConfigError, match=r"suffix '\.las'; formats for a recording: \.mcap"):
        lc.io.write_recording(tmp_path / "a.las", everything())
    assert list(tmp_path.iterdir()) == []


def convert(*arguments):
    return CliRunner().invoke(app, ["convert", *map(str, arguments)])


@pytest.fixture
def source(tmp_path):
    path = tmp_path / "in.npz"
    lc.io.write_recording(path, everything())
    return path


def test_the_command_converts_a_span_of_some_topics(source, tmp_path):
    output = tmp_path / "out.bag"
    told = convert(
        source, output, "--topic", "/points", "--start", 0.1, "--end", 0.2, "--json", "-"
    )
    assert told.exit_code == 0, told.output
    result = json.loads(told.stdout)
    assert result["written"] == {"/tf_static": 1, "/odom": 1, "/points": 1}
    assert result["left_out"] == {}
    found = read(output)
    assert [type(item).__name__ for item in found] == ["Pose", "Pose", "Scan"]
    assert found[-1].stamp_ns == BASE_NS + 200_000_000


def test_the_command_says_what_is_wrong(source, tmp_path):
    refused = convert(source, tmp_path / "b.mcap", "--topic", "/other")
    assert isinstance(refused.exception, ConfigError)
    assert "no scans on '/other'" in str(refused.exception)
    assert "found /points, /scan" in str(refused.exception)
    same = convert(source, source)
    assert isinstance(same.exception, InputError)
    assert "is also the input; choose another file to write" in str(same.exception)
    assert not (tmp_path / "b.mcap").exists()


@pytest.mark.parametrize(
    ("arguments", "error", "text"),
    [
        (("b.mcap", "--class", "x"), ConfigError, "--class: does not apply to a recording"),
        (("b.mcap", "--resolution", 1), ConfigError, "--resolution: does not apply to a rec"),
        (("b.ply", "--start", 1), ConfigError, "--start: does not apply to one cloud or map as"),
        (("b.ply", "--resolution", 1), ConfigError, "--resolution: does not apply to one cloud"),
        (
            ("b.mcap", "--start", 2, "--end", 2),
            ConfigError,
            "end: expected more than start",
        ),
        (("b.mcap", "--start", 1e6), InputError, "in.npz: no scans or moving poses from 1e+06"),
        (("no/b.las",), ConfigError, "unknown suffix '.las'; formats for a recording"),
    ],
)
def test_the_command_refuses_what_would_do_nothing(source, tmp_path, arguments, error, text):
    name, *more = arguments
    out = convert(source, tmp_path / name, *more)
    assert isinstance(out.exception, error), out.output
    assert text in str(out.exception)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["in.npz"]


def test_the_command_makes_the_folders_that_are_missing(source, tmp_path):
    cloud = tmp_path / "a.ply"
    lc.io.write_cloud(cloud, np.ones((3, 3)))
    for item, name in ((source, "a/b/c.mcap"), (source, "d/e"), (cloud, "f/g/h.pcd")):
        told = convert(item, tmp_path / name)
        assert told.exit_code == 0, told.exception
        assert (tmp_path / name).exists()
    (tmp_path / "file").touch()
    refused = convert(source, tmp_path / "file/a.npz")
    assert isinstance(refused.exception, OSError)
    with pytest.raises(FileNotFoundError, match=r"no such folder, to write a\.npz in"):
        lc.io.write_recording(tmp_path / "none/a.npz", everything())


@pytest.mark.parametrize("name", ["map.lcvm", "map.bt", "part.stl"])
def test_a_map_as_another_format_names_those_of_a_map(tmp_path, name):
    (tmp_path / name).write_bytes(b"x")
    for output in ("m.stl", "m.mcap"):
        refused = convert(tmp_path / name, tmp_path / output)
        assert isinstance(refused.exception, ConfigError)
        assert str(refused.exception).startswith(
            f"{tmp_path / output}: unknown suffix '{Path(output).suffix}'; formats for a cloud or"
            " map: .bt (OctoMap), .pcd"
        )


REAL = {
    "formats/derived_rosbag2/sick_rms_lms_sqlite3": "sick.bag",
    "formats/derived_rosbag2/sick_rms_lms_mcap": "sick",
    "3d/velodyne_mrpt/sample_velodyne_vlp16_gps.pcap": "vlp16",
    "3d/nebula/velodyne/vls128/1585897255376374245.pcd": "vls128.bag",
}


@pytest.mark.parametrize(("name", "output"), REAL.items())
def test_real_recordings_come_out_as_they_went_in(recordings, tmp_path, name, output):
    """In the order of their stamps: that is when the copy stores them."""
    told = convert(recordings / name, tmp_path / output)
    assert told.exit_code == 0, told.output
    given_items, found = read(recordings / name), read(tmp_path / output)
    kinds = (Scan, LaserScan)
    scans, again = (
        sorted((x for x in items if isinstance(x, kinds)), key=lambda x: (x.stamp_ns, x.topic))
        for items in (given_items, found)
    )
    assert len(scans) == len(again) > 0
    assert len(given_items) == len(found)
    for one, other in zip(scans, again, strict=True):
        assert one.stamp_ns == other.stamp_ns
        field = "points" if isinstance(one, Scan) else "ranges"
        np.testing.assert_array_equal(getattr(one, field), getattr(other, field))
    if isinstance(scans[0], Scan) and scans[0].point_time_ns is not None:
        times = [(a.point_time_ns, b.point_time_ns) for a, b in zip(scans, again, strict=True)]
        for mine, theirs in times:
            np.testing.assert_array_equal(mine, theirs)


def test_a_simulation_can_be_recorded_for_ros(tmp_path):
    target = tmp_path / "demo"
    told = CliRunner().invoke(app, ["simulate", "circles", "-o", str(target), "--scans", "3"])
    assert told.exit_code == 0, told.output
    assert sorted(Path(path).name for path in os.listdir(target)) == ["demo.mcap", "metadata.yaml"]
    with lc.io.open_recording(target) as recording:
        assert sum(isinstance(item, LaserScan) for item in recording) == 3
