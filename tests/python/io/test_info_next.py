"""What `lidar-core info` says to do next."""

import shlex
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from ros_files import Ros
from typer.testing import CliRunner

import lidar_core as lc
import lidar_core.io
from lidar_core.cli import app
from lidar_core.messages import LaserScan, Pose, Scan

BASE_NS = 1_700_000_000_000_000_000
LEVEL = np.eye(4)


def cloud(number, topic="/points", frame="lidar"):
    points = np.random.default_rng(number).normal(size=(40, 3)).astype(np.float32)
    return Scan(BASE_NS + number * 10**8, points, frame, topic=topic)


def sweep(number):
    ranges = np.full(90, 3.0, np.float32)
    return LaserScan(BASE_NS + number * 10**8, ranges, 0.0, 0.05, 0.1, 10.0)


def pose(number, child="lidar", *, is_static=False):
    moved = LEVEL.copy()
    moved[0, 3] = 0.0 if is_static else number
    return Pose(BASE_NS + number * 10**8, "map", child, moved, is_static=is_static)


def next_of(path, *messages):
    lc.io.write_recording(path, messages)
    done = CliRunner().invoke(app, ["info", str(path)])
    assert done.exit_code == 0, done.output
    return [line.removeprefix("next: ") for line in done.stdout.splitlines() if "next: " in line]


def test_scans_with_poses_need_nothing(tmp_path):
    path = tmp_path / "a b.npz"
    (step,) = next_of(path, pose(0), cloud(0), pose(1), cloud(1))
    assert shlex.split(step) == ["lidar-core", "detect", str(path), "-o", "run/"]


def test_scans_without_poses_are_taken_to_stand(tmp_path):
    (step,) = next_of(tmp_path / "a.npz", sweep(0), sweep(1))
    command, _, remark = step.partition("  (")
    assert command == f"lidar-core circles {tmp_path}/a.npz -o run/ --pose static"
    assert remark == "if the sensor moved: --pose FILE)"
    (step,) = next_of(tmp_path / "b.npz", pose(0, is_static=True), sweep(0), sweep(1))
    assert "--pose static" in step
    (step,) = next_of(tmp_path / "c.npz", cloud(0), cloud(1))
    assert step.endswith("--pose static  (if the sensor moved: --pose kiss, or --pose FILE)")


def test_several_topics_ask_for_one_and_name_the_others(tmp_path):
    steps = next_of(tmp_path / "a.npz", pose(0), cloud(0, "/front"), cloud(1, "/rear"), pose(1))
    assert steps == [
        f"lidar-core detect {tmp_path}/a.npz -o run/ --cloud /front"
        "  (left out: /rear; --cloud can be repeated)"
    ]
    names = [f"/lidar{number}" for number in range(6)]
    (step,) = next_of(tmp_path / "b.npz", *(cloud(0, name) for name in names))
    assert step.endswith(
        "; left out: /lidar1, /lidar2, /lidar3, 2 more; --cloud can be repeated, each with"
        " --mounting 'robot FRAME x y z roll pitch yaw')"
    )


def test_several_scanners_at_one_place_are_told_how_each_is_mounted(tmp_path):
    path = tmp_path / "a.npz"
    sides = ("front", "rear")
    scans = [replace(sweep(n), topic=f"/{side}", frame_id=side) for n in range(3) for side in sides]
    (step,) = next_of(path, *scans)
    assert "left out: /rear; --scan can be repeated, each with --mounting" in step
    words = ["circles", str(path), "-o", str(tmp_path / "run"), "--pose", "static"]
    words += ["--scan", "/front", "--scan", "/rear", "--no-picture"]
    done = CliRunner().invoke(app, words)
    assert str(done.exception).startswith(
        "pose: static would put several LiDARs at one place; give the mounting of each, such as"
        " --mounting 'robot front x y z roll pitch yaw' --mounting 'robot rear x y z roll pitch"
        " yaw', or leave pose out"
    )
    for side in sides:
        words += ["--mounting", f"robot {side} 0.2 0 0 0 0 0"]
    done = CliRunner().invoke(app, words)
    assert done.exit_code == 0, done.output


def test_a_sensor_that_nothing_carries_needs_its_mounting(tmp_path):
    messages = [pose(0, "base"), cloud(0), pose(1, "base"), cloud(1)]
    (step,) = next_of(tmp_path / "a.npz", *messages)
    command, _, remark = step.partition("  (")
    asked = "--mounting 'base lidar 0 0 0 0 0 0'"
    assert command == f"lidar-core detect {tmp_path}/a.npz -o run/ {asked}"
    assert "zeros: the sensor sits at the origin of base; else put x y z roll pitch yaw" in remark


def test_the_command_that_is_told_works(tmp_path):
    (step,) = next_of(tmp_path / "a.npz", *(cloud(number) for number in range(3)))
    words = shlex.split(step.partition("  (")[0])[1:]
    words[words.index("run/")] = str(tmp_path / "run")
    done = CliRunner().invoke(app, [*words, "--no-picture", "--no-mcap"])
    assert done.exit_code == 0, done.output


def test_scans_and_poses_without_topics_are_two_streams(tmp_path):
    path = tmp_path / "a.npz"
    lc.io.write_recording(path, [pose(0), sweep(0), pose(1), sweep(1)])
    with lc.io.open_recording(path) as recording:
        topics = recording.info().topics
    assert sorted((topic.kind, topic.count) for topic in topics) == [("planar", 2), ("pose", 2)]


def recipe(path, numbers):
    """A file of own arrays as the guide writes it: nothing names a topic."""
    points = np.random.default_rng(0).uniform(-9, 9, (len(numbers), 500, 3)).astype(np.float32)
    messages = []
    for number, cloud_points in zip(numbers, points, strict=True):
        stamp_ns = number * 100_000_000
        messages.append(lc.io.Pose(stamp_ns, "world", "lidar", np.eye(4)))
        messages.append(lc.io.Scan(stamp_ns, cloud_points, frame_id="lidar"))
    lc.io.write_recording(path, messages)


def test_a_folder_of_own_arrays_is_read_with_its_poses(tmp_path):
    folder = tmp_path / "four"
    folder.mkdir()
    recipe(folder / "c0.npz", range(20))
    recipe(folder / "c1.npz", range(20, 40))
    with lc.io.open_recording(folder) as recording:
        found = [(topic.name, topic.kind, topic.count) for topic in recording.topics()]
        posed = list(lc.io.posed_scans(recording))
    assert found == [("", "pose", 40), ("", "scan", 40)]
    assert [item.scan.stamp_ns for item in posed] == [number * 10**8 for number in range(40)]
    done = CliRunner().invoke(app, ["info", str(folder)])
    assert f"next: lidar-core detect {folder} -o run/\n" in done.stdout
    words = ["detect", str(folder), "-o", str(tmp_path / "run"), "--no-picture", "--no-mcap"]
    done = CliRunner().invoke(app, words)
    assert done.exit_code == 0, done.output


def test_a_folder_of_named_topics_adds_them_up(tmp_path):
    for number in range(2):
        path = tmp_path / f"{number}.npz"
        lc.io.write_recording(path, [cloud(number, "/front"), cloud(number, "/rear")])
    with lc.io.open_recording(tmp_path) as recording:
        found = [(topic.name, topic.kind, topic.count) for topic in recording.topics()]
    assert found == [("/front", "scan", 2), ("/rear", "scan", 2)]


@pytest.mark.parametrize("storage", ["sqlite3"])
def test_a_pose_without_a_frame_of_its_own_is_the_sensors(tmp_path, storage):
    ros = Ros(2)
    rows = np.zeros(30, np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4")]))
    rows["x"] = np.arange(1, 31)
    messages = []
    for number in range(3):
        stamp = BASE_NS + number * 10**8
        messages.append(("/points", stamp, ros.cloud(rows, stamp, "lidar")))
        place = [float(number), 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]
        messages.append(("/odom", stamp, ros.odometry(stamp, "map", "", place)))
    path = ros.write(tmp_path / "a", messages, storage)
    done = CliRunner().invoke(app, ["info", str(path)])
    assert f"next: lidar-core detect {path} -o run/\n" in done.stdout


def test_the_package_runs_as_a_module():
    done = subprocess.run(
        [sys.executable, "-m", "lidar_core", "--version"],
        capture_output=True,
        text=True,
        check=True,
        timeout=60,
    )
    assert done.stdout == f"lidar-core {lc.__version__}\n"
