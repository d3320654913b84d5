"""Every example runs, and gives what it promises."""

import re
import subprocess
import sys

import numpy as np
import pytest
from repository import ROOT

import lidar_core as lc
import lidar_core.io
from lidar_core.messages import Pose

FOLDER = ROOT / "examples"
TESTED = {
    "circle_detectors.py": "here",
    "circle_map_consistency.py": "here",
    "motion_capture_truth.py": "test_cli_circles.py",
    "quickstart.py": "here",
    "real_scan_with_drone.py": "here",
    "robot_on_zenoh.py": "test_live.py",
    "score_seeds.py": "test_demo_scene.py",
}
LOWEST_RECALL = 0.95
SCANS = 40
OS1 = "OS-1-128_v2.3.0_1024x10_lb_n3.pcap"


def output_of(python, name, *arguments):
    done = subprocess.run(
        [python, FOLDER / name, *map(str, arguments)],
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def figure(text, name):
    found = re.search(rf"^{name}: ([\d.]+)", text, re.MULTILINE)
    assert found, text
    return float(found[1])


def test_every_example_has_a_test():
    assert {path.name for path in FOLDER.glob("*.py")} == set(TESTED)


@pytest.mark.nightly
def test_motion_capture_of_a_frame_without_a_name_is_a_truth(tmp_path):
    """As many systems publish it: the truth is the same as with a name."""
    truths = {}
    for frame in ("", "map"):
        poses = []
        for number in range(20):
            matrix = np.eye(4)
            matrix[0, 3] = 0.1 * number
            poses.append(Pose(number * 100_000_000, frame, "robot", matrix))
        recording, run = tmp_path / f"poses{frame}.mcap", tmp_path / f"run{frame}"
        lc.io.write_mcap(recording, poses)
        run.mkdir()
        (run / "timing.csv").write_text("t_ns\n0\n500000000\n1200000000\n")
        truth = tmp_path / f"truth{frame}.csv"
        output_of(sys.executable, "motion_capture_truth.py", recording, "/tf", run, truth)
        truths[frame] = truth.read_text().splitlines()
    assert truths[""] == truths["map"]
    times, _, x, _, _, vx, _, _ = zip(*(row.split(",") for row in truths[""][1:]), strict=True)
    assert times == ("0", "500000000", "1200000000")
    assert [float(value) for value in x] == pytest.approx([0.0, 0.5, 1.2])
    assert [float(value) for value in vx[1:]] == pytest.approx([1.0, 1.0])


def test_motion_capture_on_another_topic_is_named(tmp_path):
    recording = tmp_path / "a.mcap"
    lc.io.write_mcap(recording, [Pose(0, "map", "robot", np.eye(4))])
    (tmp_path / "timing.csv").write_text("t_ns\n0\n")
    with pytest.raises(AssertionError, match="no poses on topic '/red'; topics with poses: /tf"):
        output_of(sys.executable, "motion_capture_truth.py", recording, "/red", tmp_path, "t.csv")


def test_quickstart_prints_two_tracks():
    lines = output_of(sys.executable, "quickstart.py").splitlines()
    assert lines[-1].startswith("1.4 s: track 1 at [")
    assert {line.split()[3] for line in lines} == {"0", "1"}


@pytest.mark.ci_cases("polar", "disc")
@pytest.mark.parametrize("rule", ["square", "lattice", "disc", "polar"])
def test_both_detectors_of_circles_are_honest(rule):
    """Whatever rule draws the circles."""
    text = output_of(sys.executable, "circle_detectors.py", 5_000, rule)
    assert all(2.6 < figure(text, f"NEES of {name}") < 3.4 for name in ("cnn", "ml"))


@pytest.mark.nightly
def test_elements_of_the_map_are_honest():
    text = output_of(sys.executable, "circle_map_consistency.py", 40)
    assert figure(text, "steps in the 95 % band") >= 0.8
    assert 2.6 < figure(text, "mean") < 3.4


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.nightly)])
def test_a_drone_in_a_real_scan_is_tracked_and_nothing_else(seed, recordings):
    recording = recordings / "3d" / "ouster" / OS1
    text = output_of(
        sys.executable, "real_scan_with_drone.py", recording, "--scans", SCANS, "--seed", seed
    )
    assert figure(text, "sightings") == SCANS - 10
    assert figure(text, "recall of tracks") >= LOWEST_RECALL
    assert figure(text, "other tracks") == 0
