"""Ouster's recordings and made packets, against ouster-sdk in its own environment."""

import subprocess
from collections import Counter

import numpy as np
import pytest
from repository import ROOT

import lidar_core.io as lc_io
from lidar_core.io.ouster.packets import PROFILES, FrameCollector, PacketLayout
from lidar_core.io.ouster.sensor import parse_sensor
from lidar_core.messages import Pose, Scan

FILES = (
    "512x10_raw.bag",
    "OS-0-128-U1_v2.3.0_1024x10.pcap",
    "OS-0-128_v3.0.1_1024x10_20241017_141645.osf",
    "OS-0-32-U1_v2.2.0_1024x10.pcap",
    "OS-1-128_v2.3.0_1024x10_lb_n3.osf",
    "OS-1-128_v2.3.0_1024x10_lb_n3.pcap",
    "OS-1-32-G_v2.1.1_1024x10.pcap",
    "OS-2-128-U1_v2.3.0_1024x10.pcap",
    "osf_fw_3.2_10scans.osf",
    "pose_delta_1_128.osf",
    "pose_delta_2_128.osf",
)


@pytest.fixture(scope="session")
def scratch(ouster_python, recordings, tmp_path_factory):
    folder = tmp_path_factory.mktemp("ouster")
    probe = ROOT / "tests/python/helpers/ouster_probe.py"
    command = [ouster_python, probe, recordings, folder]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    return folder


@pytest.fixture(scope="session")
def library(scratch):
    with np.load(scratch / "library.npz") as arrays:
        return dict(arrays)


def frames_of(library, name):
    """Frames of a recording by sensor and number, as the library has them."""
    frames = {}
    for key, array in library.items():
        file, *place = key.split("|")
        if file == name:
            frames.setdefault((int(place[0]), int(place[1])), {})[place[2]] = array
    return frames


@pytest.mark.parametrize("name", FILES)
def test_every_point_is_the_librarys(library, recordings, name):
    expected = frames_of(library, name)
    seen = Counter()
    with lc_io.open_recording(recordings / "3d/ouster" / name) as recording:
        scans = [message for message in recording if isinstance(message, Scan)]
    assert len(scans) == len(expected)
    for scan in scans:
        sensor = int(scan.topic.partition("/")[2]) if scan.topic.startswith("ouster/") else 0
        theirs = expected[sensor, seen[sensor]]
        seen[sensor] += 1
        hit = theirs["ranges"] > 0
        np.testing.assert_array_equal(np.isfinite(scan.points).all(axis=-1), hit)
        points = theirs["points"][hit]  # float64, as the library has them
        tolerance = np.spacing(np.abs(points).astype(np.float32))
        assert (np.abs(scan.points[hit] - points) <= tolerance).all()
        shape = hit.shape
        np.testing.assert_array_equal(scan.no_return.reshape(shape), ~hit & theirs["received"])
        np.testing.assert_array_equal(scan.intensity.reshape(shape), theirs["reflectivity"])
        times = scan.point_time_ns.reshape(shape)[0]
        received = theirs["received"]
        np.testing.assert_array_equal(times[received], theirs["stamps"][received])


@pytest.mark.parametrize("name", [FILES[3], *FILES[-2:]])
def test_second_returns_are_the_librarys(library, recordings, name):
    with lc_io.open_recording(recordings / "3d/ouster" / name, returns="second") as recording:
        scans = [message for message in recording if isinstance(message, Scan)]
    expected = frames_of(library, name)
    seen = Counter()
    for scan in scans:
        sensor = int(scan.topic.partition("/")[2]) if scan.topic.startswith("ouster/") else 0
        theirs = expected[sensor, seen[sensor]]
        seen[sensor] += 1
        hit = theirs["ranges2"] > 0
        assert 0 < hit.sum() < (theirs["ranges"] > 0).sum()
        np.testing.assert_array_equal(np.isfinite(scan.points).all(axis=-1), hit)
        np.testing.assert_array_equal(scan.intensity.reshape(hit.shape), theirs["reflectivity2"])
        assert not scan.no_return.any()


@pytest.mark.parametrize("name", FILES[1:3])
def test_shifted_rows_are_the_librarys(library, recordings, name):
    with lc_io.open_recording(recordings / "3d/ouster" / name, destagger=True) as recording:
        scan = next(message for message in recording if isinstance(message, Scan))
    expected = library[f"{name}|0|0|destaggered"]
    np.testing.assert_array_equal(np.isfinite(scan.points[..., 0]), expected > 0)


def test_the_mounting_of_a_file_is_the_librarys(library, recordings):
    name = "osf_fw_3.2_10scans.osf"
    with lc_io.open_recording(recordings / "3d/ouster" / name) as recording:
        mounting = next(message for message in recording if isinstance(message, Pose))
    np.testing.assert_array_equal(mounting.matrix, library[f"{name}|0|0|mounting"])
    assert abs(mounting.matrix[0, 3]) > 1


@pytest.mark.parametrize("profile", PROFILES)
def test_random_packets_of_every_profile_are_read_alike(library, profile):
    """Every bit of range and reflectivity, states of columns, and times."""
    sensor = parse_sensor(str(library[f"{profile}|metadata"]), profile, max_points=10**6)
    layout = PacketLayout(sensor, profile)
    packets = [packet.tobytes() for packet in library[f"{profile}|packets"]]
    assert all(map(layout.is_lidar, packets))
    collector = FrameCollector(layout)
    (frame,) = [frame for packet in packets for frame in collector.add(packet)]
    np.testing.assert_array_equal(frame.ranges, library[f"{profile}|ranges"])
    np.testing.assert_array_equal(frame.reflectivity, library[f"{profile}|reflectivity"])
    np.testing.assert_array_equal(frame.is_received, library[f"{profile}|received"])
    assert (f"{profile}|ranges2" in library) == (PROFILES[profile].returns == 2)
    if PROFILES[profile].returns == 2:
        collector = FrameCollector(PacketLayout(sensor, profile, is_second=True))
        (second,) = [one for packet in packets for one in collector.add(packet)]
        np.testing.assert_array_equal(second.ranges, library[f"{profile}|ranges2"])
        np.testing.assert_array_equal(second.reflectivity, library[f"{profile}|reflectivity2"])
    received = frame.is_received
    assert 0.8 < received.mean() < 1
    stamps = library[f"{profile}|stamps"].astype(np.int64)
    np.testing.assert_array_equal(frame.stamps_ns[received], stamps[received])


def test_every_profile_of_the_library_is_read(library):
    assert {key.partition("|")[0] for key in library if key.endswith("packets")} == set(PROFILES)


def test_poses_that_the_library_wrote_reach_the_scans(scratch):
    """One metre per second along x, a quarter turned."""
    with lc_io.open_recording(scratch / "moving.osf") as recording:
        posed = list(lc_io.posed_scans(recording))
        edges = {(m.frame_id, m.child_frame_id) for m in recording if isinstance(m, Pose)}
    assert edges == {("body", "os_sensor"), ("world", "body")}
    assert len(posed) == 3
    start = posed[0].pose_stamps_ns[0]
    for item in posed:
        assert len(item.pose_stamps_ns) > 30
        expected = (item.pose_stamps_ns - start) * 1e-9
        np.testing.assert_allclose(item.world_from_lidar[:, 0, 3], expected, atol=1e-6)
        np.testing.assert_allclose(item.world_from_lidar[:, 1, 0], 1, atol=1e-12)
