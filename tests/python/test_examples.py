"""Every example runs, and gives what it promises."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[2] / "examples"
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
SCANS = 200
OS1 = "OS-1-128_v2.3.0_1024x10_lb_n3.pcap"


def output_of(python, name, *arguments):
    done = subprocess.run(
        [python, FOLDER / name, *map(str, arguments)],
        capture_output=True, text=True, check=False, timeout=300,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stdout


def figure(text, name):
    found = re.search(rf"^{name}: ([\d.]+)", text, re.MULTILINE)
    assert found, text
    return float(found[1])


def test_every_example_has_a_test():
    assert {path.name for path in FOLDER.glob("*.py")} == set(TESTED)


def test_quickstart_prints_two_tracks():
    lines = output_of(sys.executable, "quickstart.py").splitlines()
    assert lines[-1].startswith("1.4 s: track 1 at [")
    assert {line.split()[3] for line in lines} == {"0", "1"}


@pytest.mark.parametrize("rule", ["square", "lattice", "disc", "polar"])
def test_both_detectors_of_circles_are_honest(rule):
    """Whatever rule draws the circles."""
    text = output_of(sys.executable, "circle_detectors.py", 5_000, rule)
    assert all(2.6 < figure(text, f"NEES of {name}") < 3.4 for name in ("cnn", "ml"))


def test_elements_of_the_map_are_honest():
    text = output_of(sys.executable, "circle_map_consistency.py", 40)
    assert figure(text, "steps in the 95 % band") >= 0.85
    assert 4.5 < figure(text, "mean") < 5.5


@pytest.mark.parametrize("seed", [0, 1])
def test_a_drone_in_a_real_scan_is_tracked_and_nothing_else(seed, recordings, ouster_python):
    recording = recordings / "3d" / "ouster" / OS1
    text = output_of(
        ouster_python, "real_scan_with_drone.py", recording, "--scans", SCANS, "--seed", seed
    )
    assert figure(text, "sightings") == SCANS - 10
    assert figure(text, "recall of tracks") >= LOWEST_RECALL
    assert figure(text, "other tracks") == 0
