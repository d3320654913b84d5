"""Every real recording opens with the counts that its source states, or is refused in words."""

import json

import numpy as np
import pytest
from ros_files import packets_of
from typer.testing import CliRunner

import lidar_core as lc
import lidar_core.io
from lidar_core.errors import FormatError
from lidar_core.io import ReadOptions
from lidar_core.io.messages.velodyne import VelodyneStream
from lidar_core.io.records import Findings
from lidar_core.messages import Pose, Scan

VELODYNE = {
    "3d/velodyne_mrpt/sample_velodyne_hdl32.pcap": [58169, 58078, 30458],
    "3d/velodyne_mrpt/sample_velodyne_vlp16_gps.pcap": [18790, 18701, 18678, 17317],
}
REFERENCE_PCD = {
    "3d/nebula/velodyne/vlp16/1673400472138016708.pcd": 14_831,
    "3d/nebula/velodyne/vls128/1585897255376374245.pcd": 208_680,
    "3d/nebula/hesai/xt32/1673400678101968885.pcd": 63_021,
    "3d/nebula/hesai/64/1673403880898440686.pcd": 93_591,
    "formats/pointcloudset_tree/test_tree.pcd": 102_236,
}
ROSBAG2 = {
    "formats/derived_rosbag2/sick_rms_lms_sqlite3": 442,
    "formats/derived_rosbag2/sick_rms_lms_mcap": 442,
    "formats/derived_rosbag2/datmo_intersection_mcap": 3857,
}


@pytest.mark.parametrize(("name", "counts"), VELODYNE.items())
def test_velodyne_captures_give_the_known_scans(recordings, name, counts):
    with lc.io.open_recording(recordings / name) as recording:
        scans = list(recording)
    assert [len(scan.points) for scan in scans] == counts
    for scan in scans:
        assert np.isfinite(scan.points).all()
        assert scan.no_return is None
        assert scan.point_time_ns.min() >= scan.stamp_ns
        assert scan.point_time_ns.max() - scan.stamp_ns < 115_000_000
        assert scan.ring.max() == (31 if "hdl32" in name else 15)


@pytest.mark.parametrize(("name", "count"), REFERENCE_PCD.items())
def test_reference_clouds_have_the_known_size(recordings, name, count):
    with lc.io.open_recording(recordings / name) as recording:
        (scan,) = recording
    assert scan.points.shape == (count, 3)
    if "nebula" in name:
        assert scan.stamp_ns == int(name.rsplit("/", 1)[1].removesuffix(".pcd"))


@pytest.mark.parametrize("name", ["vlp16", "vls128"])
def test_velodyne_packets_in_ros_messages_are_decoded(recordings, name):
    """Two decoders of the same sensor agree on the number of points to 1 %."""
    folder = recordings / "3d" / "nebula" / "velodyne" / name
    (bag,) = (item for item in folder.iterdir() if item.is_dir())
    (reference,) = folder.glob("*.pcd")
    with lc.io.open_recording(reference) as recording:
        (expected,) = recording
    with lc.io.open_recording(bag) as recording:
        scans = list(recording)
    assert len(scans) == 4
    sizes = [len(scan.points) for scan in scans]
    assert min(abs(size - len(expected.points)) for size in sizes) < 0.01 * len(expected.points)


@pytest.mark.parametrize("name", ["xt32", "64"])
def test_packets_that_no_library_decodes_are_listed(recordings, name):
    (bag,) = (i for i in (recordings / "3d/nebula/hesai" / name).iterdir() if i.is_dir())
    with lc.io.open_recording(bag) as recording:
        info = recording.info()
        assert list(recording) == []
        assert recording.skipped == {"/pandar_packets": 4}
    (topic,) = info.topics
    assert (topic.kind, topic.count) == ("packets", 4)
    assert any("no library decodes them" in defect for defect in info.defects)


def test_ouster_packets_in_a_bag_are_scans(recordings):
    with lc.io.open_recording(recordings / "3d/ouster/512x10_raw.bag") as recording:
        info = recording.info()
    kinds = {topic.name: (topic.kind, topic.count) for topic in info.topics}
    assert kinds["/os_node0/lidar_packets"] == ("scan", 1)
    assert kinds["/os_node0/imu_packets"] == ("packets", 10)


@pytest.mark.parametrize(("name", "count"), ROSBAG2.items())
def test_ros2_recordings_have_the_known_messages(recordings, name, count):
    with lc.io.open_recording(recordings / name) as recording:
        info = recording.info()
        messages = list(recording)
    assert sum(topic.count for topic in info.topics) == count
    assert any(isinstance(message, Pose) for message in messages)
    stamps = [message.stamp_ns for message in messages if isinstance(message, Scan)]
    assert len(stamps) == sum(topic.count for topic in info.topics if topic.kind == "scan")


def test_one_recording_in_three_containers_gives_the_same_clouds(recordings):
    names = ["2d/sick_rms_lms/rms_1xxx_lms_1xx_movement_off.bag", *list(ROSBAG2)[:2]]
    streams = []
    for name in names:
        with lc.io.open_recording(recordings / name) as recording:
            streams.append([m for m in recording if isinstance(m, Scan) and m.topic == "/cloud"])
    assert len(streams[0]) == 89
    for other in streams[1:]:
        for a, b in zip(streams[0], other, strict=True):
            assert a.stamp_ns == b.stamp_ns
            np.testing.assert_array_equal(a.points, b.points)
            np.testing.assert_array_equal(a.no_return, b.no_return)


def test_the_pair_of_clouds_is_a_sequence(recordings):
    with lc.io.open_recording(recordings / "3d/ndt_omp_pair") as recording:
        first, second = recording
        info = recording.info()
    assert (len(first.points), len(second.points)) == (69_088, 69_792)
    assert second.stamp_ns - first.stamp_ns == 100_000_000
    assert any("10 Hz assumed" in defect for defect in info.defects)


def test_every_3d_recording_opens(recordings):
    """`info` works on each file of 3d that is a recording."""
    suffixes = {".bag", ".db3", ".osf", ".pcap", ".pcd"}
    files = [file for file in sorted((recordings / "3d").rglob("*")) if file.suffix in suffixes]
    assert len(files) > 20
    for file in files:
        with lc.io.open_recording(file) as recording:
            info = recording.info()
        assert info.topics
        assert all(topic.count > 0 for topic in info.topics)


def test_other_files_are_refused_with_the_readable_formats(recordings):
    with pytest.raises(FormatError, match=r"unknown format.*readable are: CARMEN log \(\.clf or"):
        lc.io.open_recording(recordings / "3d/ouster/LICENSE")


def test_info_command_prints_json(recordings):
    from lidar_core.cli import app

    file = recordings / "3d/velodyne_mrpt/sample_velodyne_hdl32.pcap"
    result = CliRunner().invoke(app, ["info", str(file), "--json"])
    assert result.exit_code == 0, result.output
    info = json.loads(result.stdout)
    assert info["topics"][0]["count"] == 3
    assert info["topics"][0]["points"] == 58_169


def test_info_command_prints_a_table(recordings):
    from lidar_core.cli import app

    result = CliRunner().invoke(app, ["info", str(recordings / "3d/ndt_omp_pair")])
    assert result.exit_code == 0, result.output
    assert "rays without return of lidar: zero" in result.stdout
    assert "no poses: use --pose FILE" in result.stdout


@pytest.mark.parametrize("child", ["", "lidar"])
def test_info_says_what_poses_without_a_child_frame_are(tmp_path, child):
    from lidar_core.cli import app

    poses = [Pose(number * 10**8, "map", child, np.eye(4), topic="/ego") for number in range(3)]
    lc.io.write_npz(tmp_path / "a.npz", poses)
    result = CliRunner().invoke(app, ["info", str(tmp_path / "a.npz")])
    assert result.exit_code == 0, result.output
    nameless = "poses in map of a body without a frame name: moving" in result.stdout
    assert nameless == (not child)
    assert ("transform map -> lidar: moving" in result.stdout) == bool(child)
    assert "-> (none)" not in result.stdout


def test_names_in_a_pipe_stay_whole(recordings):
    from lidar_core.cli import app

    folder = recordings / "formats/derived_rosbag2/datmo_intersection_mcap"
    result = CliRunner().invoke(app, ["info", str(folder)])
    lines = result.stdout.splitlines()
    assert lines[0].startswith(str(folder))
    assert any("/ego_pose" in line and "PoseStamped" in line for line in lines)


def test_velodyne_packets_that_arrive_one_by_one_give_the_same_scans(recordings):
    path = recordings / "3d/velodyne_mrpt/sample_velodyne_vlp16_gps.pcap"
    stream = VelodyneStream(ReadOptions(), Findings())
    scans = []
    for stamp_ns, packet in packets_of(path):
        scan = stream.scan(stamp_ns, packet, place="packet")
        scans += [] if scan is None else [scan]
    with lc.io.open_recording(path) as recording:
        whole = list(recording)
    assert len(scans) == len(whole) - 1  # the last revolution is not complete
    for live, read in zip(scans, whole, strict=False):
        np.testing.assert_array_equal(live.points, read.points)
        assert live.frame_id == "velodyne"
        assert abs(live.stamp_ns - read.stamp_ns) < 1000
    with pytest.raises(FormatError, match=r"packet: 3 bytes, a Velodyne data packet has 1206"):
        stream.scan(0, b"abc", place="packet")
