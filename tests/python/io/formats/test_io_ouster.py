"""Ouster recordings, read in the environment that holds ouster-sdk."""

import json
import subprocess

import pytest
from repository import ROOT

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
FLOAT32_AT_120_M = 8e-6
"""Spacing of float32 at the farthest return [m]: the only difference from ouster-sdk allowed."""
CUTS = 40
COMMAND = "from lidar_core.cli import main; main()"


@pytest.fixture(scope="session")
def facts(ouster_python, recordings, tmp_path_factory):
    probe = ROOT / "tests/python/helpers/ouster_probe.py"
    scratch = tmp_path_factory.mktemp("ouster")
    command = [ouster_python, probe, recordings, scratch]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.parametrize("name", SHAPES)
def test_scans_are_organised_and_complete(facts, name):
    shape, count = SHAPES[name]
    scans = facts["recordings"][name]["scans"]
    assert len(scans) == count
    for scan in scans:
        assert scan["shape"] == shape
        assert scan["points"] > 6000
        assert scan["both"] == 0
        assert scan["rings"] == shape[0]


def test_known_numbers_of_points(facts):
    scans = facts["recordings"]["OS-1-128_v2.3.0_1024x10_lb_n3.pcap"]["scans"]
    assert [scan["points"] for scan in scans] == [107_647, 107_357, 107_532]
    scans = facts["recordings"]["osf_fw_3.2_10scans.osf"]["scans"]
    assert all(6000 < scan["points"] < 6200 for scan in scans)


def test_capture_and_osf_of_one_drive_agree(facts):
    pair = [facts["recordings"][f"OS-1-128_v2.3.0_1024x10_lb_n3.{s}"] for s in ("pcap", "osf")]
    assert pair[0]["scans"] == pair[1]["scans"]


@pytest.mark.parametrize("name", SHAPES)
def test_every_ray_is_a_point_or_has_no_return(facts, name):
    """Columns that were not received are neither; only one file has a scan with such."""
    for number, scan in enumerate(facts["recordings"][name]["scans"]):
        rays = scan["shape"][0] * scan["shape"][1]
        if (name, number) == ("OS-0-128_v3.0.1_1024x10_20241017_141645.osf", 0):
            assert scan["points"] + scan["no_return"] == 384 * 128
        else:
            assert scan["points"] + scan["no_return"] == rays


@pytest.mark.parametrize("name", SHAPES)
def test_directions_are_unit_and_along_the_points(facts, name):
    """Beams start up to 40 mm beside the sensor's origin: near points lie off their direction."""
    for scan in facts["recordings"][name]["scans"]:
        assert scan["unit_error"] < 1e-6
        assert scan["worst_cosine"] > 0.97


@pytest.mark.parametrize("name", SHAPES)
def test_columns_carry_their_times(facts, name):
    for scan in facts["recordings"][name]["scans"]:
        assert scan["first_ns"] == 0
        assert 35e6 < scan["span_ns"] < 101e6


def test_points_equal_the_librarys_own(facts):
    for worst in facts["geometry"].values():
        assert worst["staggered"] <= FLOAT32_AT_120_M
        assert worst["destaggered"] <= FLOAT32_AT_120_M


def test_two_sensors_are_two_topics(facts):
    scans = facts["recordings"]["pose_delta_1_128.osf"]["scans"]
    assert sorted(scan["topic"] for scan in scans) == ["ouster/0", "ouster/1"]


def test_poses_of_an_osf_file_reach_the_scans(facts):
    poses = facts["poses"]
    assert poses["edges"] == [["body", "os_sensor"], ["world", "body"]]
    assert poses["scans"] == 3
    assert poses["poses_per_scan"] > 30
    assert poses["worst"] < 1e-6


def test_kitti_poses_fit_the_capture(facts):
    assert facts["poses"]["kitti_x"] == pytest.approx([0.0, 0.2454, 0.4978], abs=1e-4)


def test_identity_poses_are_no_poses(facts):
    text = facts["poses"]["without"]
    assert "no pose for frame 'os_sensor'" in text
    assert 'pose="static"' in text


@pytest.mark.parametrize(
    ("name", "what"),
    [
        ("bad_crc32.osf", "Invalid chunk"),
        ("bad_encoding.osf", "could not decode field"),
        ("single_scan_major_version.osf", "schema version 9999.0.0"),
    ],
)
def test_broken_files_are_refused_in_a_sentence(facts, name, what):
    result = facts["recordings"][name]
    assert result["error"] == "FormatError"
    for part in (name, what, "take it from the source again"):
        assert part in result["text"]


def test_cut_files_are_refused(facts):
    for outcomes in facts["damage"].values():
        assert set(outcomes) == {"FormatError"}
        assert outcomes["FormatError"] >= CUTS


@pytest.mark.parametrize(
    "name", ["bad_crc32.osf", "bad_encoding.osf", "single_scan_major_version.osf"]
)
def test_the_command_refuses_broken_files_with_status_2(ouster_python, recordings, name):
    file = recordings / "formats/ouster_broken" / name
    done = subprocess.run(
        [ouster_python, "-c", COMMAND, "info", file], capture_output=True, text=True, check=False
    )
    assert done.returncode == 2, done.stderr
    assert done.stderr.startswith(f"error: {file}: ")
    assert done.stderr.count("\n") == 1


def test_the_command_shows_a_capture(ouster_python, recordings):
    file = recordings / "3d/ouster/OS-2-128-U1_v2.3.0_1024x10.pcap"
    done = subprocess.run(
        [ouster_python, "-c", COMMAND, "info", file, "--json"],
        capture_output=True,
        text=True,
        check=True,
    )
    (topic,) = json.loads(done.stdout)["topics"]
    assert (topic["rays"], topic["points"]) == (131_072, 119_682)
