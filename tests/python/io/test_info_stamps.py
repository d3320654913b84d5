"""Stamps that are zero, repeat or go backwards: `info` sees them, and tells what works."""

import json
import re
import shlex

import numpy as np
import pytest
from ros_files import Ros
from typer.testing import CliRunner

from lidar_core.cli import app
from lidar_core.io import (
    PoseOptions,
    ReadOptions,
    open_recording,
    posed_laser_scans,
    write_recording,
)
from lidar_core.io import info as info_module
from lidar_core.io.stamp_unit import stamp_unit_note
from lidar_core.messages import LaserScan, Pose, Scan
from lidar_core.runs.scans.source import ScanSource

BASE_NS = 1_700_000_000_000_000_000
STEP_NS = 10**8


def sweep(stamp_ns, topic="/scan"):
    return LaserScan(stamp_ns, np.full(90, 3.0, np.float32), 0.0, 0.05, 0.1, 10.0, topic=topic)


def told(path, *options):
    """What `info` prints, and the command that goes on."""
    done = CliRunner().invoke(app, ["info", str(path), *options])
    assert done.exit_code == 0, done.output
    steps = [
        line.removeprefix("next: ").partition("  (")[0]
        for line in done.stdout.splitlines()
        if line.startswith("next: ")
    ]
    return done.stdout, steps


def notes_of(path, *options):
    said, _ = told(path, *options)
    return [line.removeprefix("note ") for line in said.splitlines() if line.startswith("note ")]


def run(step, folder):
    words = shlex.split(step)
    words[words.index("run/")] = str(folder / "run")
    file = folder / "told.json"
    done = CliRunner().invoke(
        app, [*words[1:], "--no-picture", "--no-mcap", "--overwrite", "--json", str(file)]
    )
    assert done.exit_code == 0, done.exception
    return json.loads(file.read_text())


def carmen(folder, stamps):
    """A log whose messages have these times [s]."""
    ranges = " ".join(f"{3 + 0.01 * beam:.2f}" for beam in range(90))
    lines = [
        f"FLASER 90 {ranges} {k * 0.1} 0 0 {k * 0.1} 0 0 {stamp} robot {stamp}"
        for k, stamp in enumerate(stamps)
    ]
    path = folder / "a.clf"
    path.write_text("\n".join(lines) + "\n")
    return path


def test_a_log_whose_stamps_are_all_zero_is_counted(tmp_path):
    path = carmen(tmp_path, [0.0] * 40)
    said, (step,) = told(path)
    assert "FLASER: all 40 stamps are 0; --stamps counted gives others" in said
    assert step == f"lidar-core circles {path} -o run/ --stamps counted"
    scans = run(step, tmp_path)["scans"]
    assert (scans["processed"], scans["rejected"]) == (40, {})


def bag(folder, stamps):
    """A bag that stored a scan every 0.1 s, whose headers say `stamps` [ns]."""
    ros = Ros(2)
    rows = np.zeros(30, np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4")]))
    rows["x"] = np.arange(1, 31)
    items = [
        ("/points", BASE_NS + k * STEP_NS, ros.cloud(rows, stamp, "lidar"))
        for k, stamp in enumerate(stamps)
    ]
    return ros.write(folder / "bag", items, "sqlite3")


@pytest.mark.parametrize(
    ("stamps", "defect"),
    [
        ([0] * 30, "all 30 stamps are 0"),
        ([BASE_NS] * 30, "29 of 30 stamps repeat the one before"),
        ([BASE_NS + 10**11 - k * STEP_NS for k in range(30)], "29 of 30 stamps go backwards"),
        ([0] * 25 + [BASE_NS + k for k in range(5)], "25 of 30 stamps are 0"),
    ],
)
def test_a_bag_with_such_stamps_is_read_by_its_own_times(tmp_path, stamps, defect):
    path = bag(tmp_path, stamps)
    said, (step,) = told(path)
    assert f"/points: {defect}; --stamps recorded gives others" in said
    assert step == f"lidar-core detect {path} -o run/ --stamps recorded --pose static"
    scans = run(step, tmp_path)["scans"]
    assert (scans["processed"], scans["rejected"]) == (30, {})


def test_a_few_such_stamps_are_told_and_change_no_command(tmp_path):
    stamps = [BASE_NS + k * STEP_NS for k in range(30)]
    stamps[20] = stamps[19]
    stamps[25] = stamps[20]
    said, (step,) = told(bag(tmp_path, stamps))
    assert "/points: 1 of 30 stamps repeat the one before; --stamps recorded gives others" in said
    assert "/points: 1 of 30 stamps go backwards; --stamps recorded gives others" in said
    assert "--stamps" not in step


def test_times_that_are_no_better_are_not_advised(tmp_path):
    """A log stores no other times than its stamps."""
    said, (step,) = told(carmen(tmp_path, [*range(1, 31), *range(10, 20)]))
    assert "FLASER: 1 of 40 stamps go backwards; --stamps counted gives others" in said
    assert "--stamps" not in step


def test_stamps_after_the_tenth_scan_are_seen(tmp_path):
    stamps = [BASE_NS + k * STEP_NS for k in range(200)]
    stamps[150:] = [stamps[150]] * 50
    write_recording(tmp_path / "a.npz", map(sweep, stamps))
    said, _ = told(tmp_path / "a.npz")
    assert "/scan: 49 of 200 stamps repeat the one before" in said
    assert "looked at" not in said


def test_a_large_recording_says_what_share_was_looked_at(tmp_path, monkeypatch):
    write_recording(tmp_path / "a.npz", [sweep(BASE_NS + k * STEP_NS) for k in range(60)])
    monkeypatch.setattr(info_module, "EFFORT", 20 * (info_module.EFFORT_PER_SCAN + 90))
    said, _ = told(tmp_path / "a.npz")
    assert "looked at the first 20 of 60 scans of /scan" in said
    with open_recording(tmp_path / "a.npz") as recording:
        assert recording.info().looked_at == {"/scan": (20, 60)}


def test_every_topic_is_looked_at_however_large_another_is(tmp_path, monkeypatch):
    monkeypatch.setattr(info_module, "EFFORT", 1)
    first = [sweep(BASE_NS + k, "/a") for k in range(40)]
    second = [sweep(BASE_NS + 10**9 + k, "/b") for k in range(40)]
    write_recording(tmp_path / "a.npz", [*first, *second])
    with open_recording(tmp_path / "a.npz") as recording:
        assert recording.info().looked_at == {"/a": (10, 40), "/b": (10, 40)}


def moved(stamp_ns, place, *, is_static=False):
    matrix = np.eye(4)
    matrix[0, 3] = place
    child = ("base", "lidar") if is_static else ("map", "base")
    return Pose(stamp_ns, *child, matrix, is_static=is_static)


def test_counted_times_are_those_of_the_rate_for_scans_and_their_poses(tmp_path):
    messages = [moved(0, 0.5, is_static=True)]
    for number in range(4):
        messages += [moved(0, float(number)), Scan(0, np.ones((2, 3), np.float32), "lidar")]
    write_recording(tmp_path / "a.npz", messages)
    with open_recording(tmp_path / "a.npz", stamps="counted", scan_rate=5.0) as recording:
        found = list(recording)
        scans = [message.stamp_ns for message in found if isinstance(message, Scan)]
        assert scans == [0, 200_000_000, 400_000_000, 600_000_000]
        assert [one.stamp_ns for one in found if isinstance(one, Pose) and one.is_static] == [0]
        assert recording.first_stamp() == 0


def test_clouds_and_2d_scans_without_topics_are_counted_apart(tmp_path):
    ranges = np.ones(30, np.float32)
    messages = []
    for _ in range(3):
        messages.append(Scan(0, np.ones((2, 3), np.float32)))
        messages.append(LaserScan(0, ranges, 0.0, 0.1, 0.1, 10.0))
    write_recording(tmp_path / "a.npz", messages)
    with open_recording(tmp_path / "a.npz", stamps="counted") as recording:
        found = list(recording)
    for kind in (Scan, LaserScan):
        stamps = [message.stamp_ns for message in found if isinstance(message, kind)]
        assert stamps == [0, STEP_NS, 2 * STEP_NS]


def test_times_of_points_move_with_their_scan(tmp_path):
    times = np.array([5, 15], np.int64)
    scans = [Scan(5, np.ones((2, 3), np.float32), point_time_ns=times) for _ in range(2)]
    write_recording(tmp_path / "a.npz", scans)
    with open_recording(tmp_path / "a.npz", stamps="counted") as recording:
        first, second = (message for message in recording if isinstance(message, Scan))
    assert first.point_time_ns.tolist() == [0, 10]
    assert second.point_time_ns.tolist() == [STEP_NS, STEP_NS + 10]


def test_poses_and_scans_of_one_log_stay_together(tmp_path):
    path = carmen(tmp_path, [0.0] * 12)
    with open_recording(path, stamps="counted") as recording:
        scans = list(posed_laser_scans(recording))
    assert [item.scan.stamp_ns for item in scans] == [k * STEP_NS for k in range(12)]
    places = [item.world_from_lidar.reshape(-1, 4, 4)[0, 0, 3] for item in scans]
    np.testing.assert_allclose(places, 0.1 * np.arange(12), atol=1e-9)


def test_options_that_were_given_are_in_the_command(tmp_path):
    path = bag(tmp_path, [0] * 5)
    _, (step,) = told(path, "--stamps", "counted", "--scan-rate", "5", "--no-return", "none")
    assert step == (
        f"lidar-core detect {path} -o run/ --no-return none --stamps counted --scan-rate 5.0"
        " --pose static"
    )
    assert run(step, tmp_path)["scans"]["processed"] == 5


def test_what_recovers_a_recording_is_written_first(tmp_path):
    path = tmp_path / "a.mcap"
    write_recording(path, [Scan(BASE_NS + k, np.ones((2, 3), np.float32)) for k in range(3)])
    _, (step,) = told(path, "--recover")
    assert step == f"lidar-core convert {path} recovered.npz --recover"


@pytest.mark.parametrize(
    ("step_ns", "expected"),
    [
        (
            100_000,
            "scans are 100 us apart, closer .* these seem to be microseconds; .* --scan-rate 10$",
        ),
        (50, "scans are 50 ns apart, .* these seem to be milliseconds; .* --scan-rate 20$"),
        (1, "scans are 1 ns apart, .* these seem to be seconds; .* --scan-rate 1$"),
        (3, "scans are 3 ns apart, .* these are not; .* --scan-rate HZ$"),
        (
            100 * 10**9,
            "scans are 100 s apart, farther .* seem to be 1,000 times as many; .* --scan-rate 10$",
        ),
        (10**8, None),
        (2_000_000, None),  # a fast 2D scanner
        (20 * 10**9, None),  # a scanner on a tripod
    ],
)
def test_stamps_in_another_unit_are_named(tmp_path, step_ns, expected):
    path = tmp_path / "scans.npz"
    write_recording(path, [sweep(k * step_ns) for k in range(20)])
    told = [note for note in notes_of(path) if "LiDAR: stamps" in note]
    arguments = ["circles", str(path), "-o", str(tmp_path / "run"), "--pose", "static"]
    done = CliRunner().invoke(app, [*arguments, "--no-picture", "--no-mcap"])
    assert done.exit_code == 0, done.output
    printed = [line for line in done.stdout.splitlines() if "LiDAR: stamps" in line]
    assert len(told) == len(printed) == (expected is not None)
    if expected is not None:
        assert re.match(f"/scan: {expected}", told[0])
        assert printed == [f"note: {told[0]}"]


def test_the_advice_for_another_unit_works(tmp_path):
    path = tmp_path / "scans.npz"
    write_recording(path, [sweep(k * 50_000) for k in range(20)])
    advice = ["--stamps", "counted", "--scan-rate", "20"]
    assert (
        " and ".join(f"{one} {value}" for one, value in zip(advice[::2], advice[1::2], strict=True))
        in notes_of(path)[0]
    )
    assert not [note for note in notes_of(path, *advice) if "LiDAR: stamps" in note]


def test_two_lidars_that_measure_together_have_no_such_note(tmp_path):
    """10 Hz each, 100 us from one to the other."""
    path = tmp_path / "scans.npz"
    scans = [
        sweep(k * STEP_NS + 10**5 * (name == "/b"), name)
        for k in range(20)
        for name in ("/a", "/b")
    ]
    write_recording(path, scans)
    assert not [note for note in notes_of(path) if "apart" in note]
    with ScanSource(
        path,
        ReadOptions(),
        PoseOptions(pose="static", mounting=["base laser 0 0 0 0 0 0"]),
        ("/a", "/b"),
        1,
        LaserScan,
    ) as source:
        assert len(list(source)) == 40
        assert not [note for note in source.notes if "apart" in note]


@pytest.mark.parametrize(
    "stamps",
    [
        [0, 1000, 2000, 3000],  # too few
        [0] * 25 + [BASE_NS + k for k in range(5)],
        [BASE_NS + k // 10 for k in range(100)],
        [BASE_NS - k for k in range(30)],
    ],
)
def test_stamps_that_repeat_or_go_back_have_their_own_notes(stamps):
    assert stamp_unit_note(stamps) is None
