"""Ouster recordings: captures, OSF files and bags of packets."""

import json
import os
import subprocess
import sys
from functools import cache

import numpy as np
import pytest
from commands import command_line

import lidar_core.io as lc_io
from lidar_core.errors import FormatError
from lidar_core.io.formats.ouster import SENSOR_KEY
from lidar_core.io.ouster.sensor import MOST_METADATA_BYTES
from lidar_core.messages import Pose, Scan

SHAPES = {
    "512x10_raw.bag": ([128, 512, 3], 1),
    "OS-0-128-U1_v2.3.0_1024x10.pcap": ([128, 1024, 3], 1),
    "OS-0-128_v3.0.1_1024x10_20241017_141645.osf": ([128, 1024, 3], 3),
    "OS-0-32-U1_v2.2.0_1024x10.pcap": ([32, 1024, 3], 1),
    "OS-1-128_v2.3.0_1024x10_lb_n3.osf": ([128, 1024, 3], 3),
    "OS-1-128_v2.3.0_1024x10_lb_n3.pcap": ([128, 1024, 3], 3),
    "OS-1-32-G_v2.1.1_1024x10.pcap": ([32, 1024, 3], 1),
    "OS-2-128-U1_v2.3.0_1024x10.pcap": ([128, 1024, 3], 1),
    "osf_fw_3.2_10scans.osf": ([8, 2048, 3], 10),
    "pose_delta_1_128.osf": ([128, 2048, 3], 2),
    "pose_delta_2_128.osf": ([128, 2048, 3], 2),
}
CUTS = 40
BROKEN = {
    "bad_crc32.osf": "invalid chunk at byte 60: its checksum does not fit",
    "bad_encoding.osf": "could not decode a field",
    "single_scan_major_version.osf": "schema version 9999.0.0",
}
DRIVE = "OS-1-128_v2.3.0_1024x10_lb_n3"


@cache
def messages_of(path):
    with lc_io.open_recording(path) as recording:
        return list(recording)


def scans_of(recordings, name):
    messages = messages_of(recordings / "3d/ouster" / name)
    return [message for message in messages if isinstance(message, Scan)]


@pytest.mark.parametrize("name", SHAPES)
def test_scans_are_organised_and_complete(recordings, name):
    """Columns that were not received are neither; only one file has a scan with such."""
    shape, count = SHAPES[name]
    scans = scans_of(recordings, name)
    assert len(scans) == count
    for number, scan in enumerate(scans):
        assert list(scan.points.shape) == shape
        is_hit = np.isfinite(scan.points.reshape(-1, 3)).all(axis=1)
        assert is_hit.sum() > 6000
        assert not (is_hit & scan.no_return).any()
        assert scan.ring.max() + 1 == shape[0]
        is_cut = (name, number) == ("OS-0-128_v3.0.1_1024x10_20241017_141645.osf", 0)
        assert is_hit.sum() + scan.no_return.sum() == (384 if is_cut else shape[1]) * shape[0]
        assert scan.point_time_ns.min() == scan.stamp_ns
        assert 35e6 < np.ptp(scan.point_time_ns) < 101e6


@pytest.mark.parametrize("name", SHAPES)
def test_directions_are_unit_and_along_the_points(recordings, name):
    """Beams start up to 40 mm beside the sensor's origin: near points lie off their direction."""
    for scan in scans_of(recordings, name):
        rows = scan.points.reshape(-1, 3)
        is_hit = np.isfinite(rows).all(axis=1)
        along = np.sum(rows[is_hit] * scan.directions[is_hit], axis=1)
        assert np.abs(np.linalg.norm(scan.directions, axis=1) - 1).max() < 1e-6
        assert (along / np.linalg.norm(rows[is_hit], axis=1)).min() > 0.97


def test_known_numbers_of_points(recordings):
    counts = [
        np.isfinite(scan.points[..., 0]).sum() for scan in scans_of(recordings, f"{DRIVE}.pcap")
    ]
    assert counts == [107_647, 107_357, 107_532]
    scans = scans_of(recordings, "osf_fw_3.2_10scans.osf")
    assert all(6000 < np.isfinite(scan.points[..., 0]).sum() < 6200 for scan in scans)


def test_capture_and_osf_of_one_drive_agree(recordings):
    pairs = zip(*(scans_of(recordings, f"{DRIVE}.{end}") for end in ("pcap", "osf")), strict=True)
    for capture, osf in pairs:
        np.testing.assert_array_equal(capture.points, osf.points)
        np.testing.assert_array_equal(capture.point_time_ns, osf.point_time_ns)


def test_two_sensors_are_two_topics(recordings):
    scans = scans_of(recordings, "pose_delta_1_128.osf")
    assert sorted(scan.topic for scan in scans) == ["ouster/0", "ouster/1"]


def test_kitti_poses_fit_the_capture(recordings):
    folder = recordings / "3d/ouster"
    with lc_io.open_recording(folder / f"{DRIVE}.pcap") as recording:
        posed = lc_io.posed_scans(recording, pose=str(folder / f"{DRIVE}_poses_kitti.txt"))
        along = [item.world_from_lidar[0, 3] for item in posed]
    assert along == pytest.approx([0.0, 0.2454, 0.4978], abs=1e-4)


def test_identity_poses_are_no_poses(recordings):
    with (
        lc_io.open_recording(recordings / "3d/ouster" / f"{DRIVE}.osf") as recording,
        pytest.raises(FormatError, match="no pose for frame 'os_sensor'") as caught,
    ):
        list(lc_io.posed_scans(recording))
    assert 'pose="static"' in str(caught.value)


def test_packets_of_a_bag_keep_its_other_topics(recordings):
    with lc_io.open_recording(recordings / "3d/ouster/512x10_raw.bag") as recording:
        (scan,) = recording
        assert recording.skipped == {"/os_node0/imu_packets": 10, "/os_node0/metadata": 1}
    assert (scan.topic, scan.frame_id) == ("/os_node0/lidar_packets", "os_sensor")
    assert not any(isinstance(one, Pose) for one in messages_of(recording.path))


@pytest.mark.parametrize("name", BROKEN)
def test_broken_files_are_refused_in_a_sentence(recordings, name):
    path = recordings / "formats/ouster_broken" / name
    with pytest.raises(FormatError) as caught, lc_io.open_recording(path) as recording:
        list(recording)
    for part in (str(path), BROKEN[name], "take it from the source again"):
        assert part in str(caught.value)


def test_a_capture_that_was_killed_is_read_to_its_last_whole_packet(recordings, tmp_path):
    original = recordings / "3d/ouster/OS-1-32-G_v2.1.1_1024x10.pcap"
    content, copy = original.read_bytes(), tmp_path / "cut.pcap"
    copy.with_suffix(".json").write_bytes(original.with_suffix(".json").read_bytes())
    for length, note in ((len(content), 0), (len(content) - 1, 1), (len(content) * 2 // 3, 1)):
        copy.write_bytes(content[:length])
        with lc_io.open_recording(copy) as recording:
            assert any(isinstance(one, Scan) for one in recording)
            assert sum("cut inside" in one for one in recording.noticed().notes) == note


def test_cut_files_are_refused(recordings, tmp_path):
    original = recordings / "3d/ouster/osf_fw_3.2_10scans.osf"
    content, copy = original.read_bytes(), tmp_path / "cut.osf"
    for length in range(1, len(content), len(content) // CUTS):
        copy.write_bytes(content[:length])
        with pytest.raises(FormatError, match=copy.name), lc_io.open_recording(copy) as recording:
            list(recording)


def test_the_command_refuses_broken_files_with_status_2(recordings):
    file = recordings / "formats/ouster_broken/bad_crc32.osf"
    done = subprocess.run(
        command_line("info", file), capture_output=True, text=True, check=False, timeout=60
    )
    assert done.returncode == 2, done.stderr
    assert done.stderr.startswith(f"error: {file}")
    assert done.stderr.count("\n") == 1


def test_a_capture_without_poses_is_not_shown_as_one_with_poses(recordings):
    file = recordings / "3d/ouster/OS-2-128-U1_v2.3.0_1024x10.pcap"
    done = subprocess.run(
        command_line("info", file), capture_output=True, text=True, check=True, timeout=60
    )
    assert "scan+mounting" in done.stdout
    assert "scan+pose" not in done.stdout
    assert "no poses: use --pose FILE" in done.stdout


def test_the_command_shows_a_capture(recordings):
    file = recordings / "3d/ouster/OS-2-128-U1_v2.3.0_1024x10.pcap"
    done = subprocess.run(
        command_line("info", file, "--json"),
        capture_output=True,
        text=True,
        check=True,
        timeout=60,
    )
    (topic,) = json.loads(done.stdout)["topics"]
    assert (topic["rays"], topic["points"]) == (131_072, 119_682)


@pytest.mark.skipif(sys.platform != "linux", reason="/dev/zero")
@pytest.mark.parametrize("kind", ["device", "pipe", "large file"])
def test_what_has_no_end_beside_a_capture_is_not_read(recordings, tmp_path, kind):
    """A link to /dev/zero under the name of the metadata took all memory before."""
    capture = recordings / "3d/velodyne_mrpt/sample_velodyne_vlp16_gps.pcap"
    expected = len(messages_of(capture))
    copied, beside = tmp_path / "a_b.pcap", tmp_path / "a.json"
    copied.symlink_to(capture)
    if kind == "device":
        beside.symlink_to("/dev/zero")
    elif kind == "pipe":
        os.mkfifo(beside)
    else:
        beside.write_bytes(SENSOR_KEY + bytes(MOST_METADATA_BYTES))
    assert len(messages_of(copied)) == expected > 0
    with pytest.raises(FormatError, match=r"a\.json"):
        list(lc_io.open_recording(copied, metadata=str(beside)))
