"""`lidar-core circles`: recordings in, run folders out; the map lies where the truth says."""

import json
import signal
import subprocess
import sys
import time
import tomllib
from dataclasses import replace
from functools import partial
from itertools import count

import numpy as np
import pytest
from commands import invoke, json_of, running
from repository import ROOT

import lidar_core.io
from lidar_core import ConfigError, FormatError, InputError, sim
from lidar_core.circles import CirclePipeline, CirclesConfig
from lidar_core.cli import main
from lidar_core.io import PosedScan, open_recording, posed_laser_scans, read_columns, write_npz
from lidar_core.messages import LaserScan, Pose
from lidar_core.runs.scans.circles_output import CirclesRun
from lidar_core.runs.scans.times import ScanTimes
from lidar_core.viz.film import film_ending

SCANS, RADIUS = 60, 0.3
POSITION_ERROR, RADIUS_ERROR = 0.02, 0.01
"""Of an element that has been seen for a second [m]."""
run_command, result_of = partial(invoke, "circles"), partial(json_of, "circles")


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """A cylinder on a circle before a moving, tilting scanner, in lidar_core's own format."""
    path = tmp_path_factory.mktemp("recording") / "post.npz"
    scene = sim.circle_scenes.single(RADIUS, 2, sensor="swinging")
    sim.record(scene, path, seed=1100, scans=SCANS)
    return path


@pytest.fixture(scope="module")
def run(recording, tmp_path_factory):
    """Folder and result of a run on it."""
    folder = tmp_path_factory.mktemp("circles") / "run"
    return folder, result_of(recording, "-o", folder)


def test_a_part_of_a_recording_is_mapped(recording, tmp_path):
    plain = ("--no-picture", "--no-mcap")
    cut = result_of(recording, "-o", tmp_path / "run", "--start", 0.5, "--end", 1.0, *plain)
    stamps = read_columns(tmp_path / "run" / "timing.parquet")["t_ns"]
    with open_recording(recording) as opened:
        first_ns = opened.first_stamp()
    assert len(stamps) == cut["scans"]["processed"] < SCANS
    assert 0.5 <= (stamps.min() - first_ns) * 1e-9 < (stamps.max() - first_ns) * 1e-9 <= 1.0


def test_the_folder_is_complete_and_noted(recording, run):
    folder, result = run
    names = {path.name for path in folder.iterdir()}
    assert names == set(result["files"])
    assert {
        "circles.parquet",
        "detections.parquet",
        "map.parquet",
        "shapes.parquet",
        "timing.parquet",
        "tracks_tum",
        "run.toml",
        "run.mcap",
        "picture.png",
        "summary.json",
    } == names
    note = tomllib.loads((folder / "run.toml").read_text())
    assert note["input"]["recording"]["path"] == str(recording)
    (scanner,) = note["config"]["circles"]["scanners"].values()
    assert scanner["n_beams"] == 1081
    assert result["scans"] == {"received": SCANS, "processed": SCANS, "rejected": {}}
    assert result["elements"] == 1


def test_a_film_needs_no_picture(recording, tmp_path):
    told = ("--film", "--no-picture", "--no-mcap", "--end", 0.3)
    made = result_of(recording, "-o", tmp_path / "run", *told)
    film = f"film{film_ending()}"
    assert film in made["files"]
    assert (tmp_path / "run" / film).stat().st_size > 10_000
    assert "picture.png" not in made["files"]


def test_the_table_names_what_moves_at_the_end(recording, tmp_path):
    """In the first scans nothing is known to move."""
    few, file = ("--no-picture", "--no-mcap", "--overwrite", "-o", tmp_path / "run"), tmp_path / "a"
    out = run_command(recording, *few, "--json", file)
    ((number, speed),) = (
        tuple(one.values()) for one in json.loads(file.read_text())["moving_at_end"]
    )
    table = read_columns(next((tmp_path / "run").glob("circles.*")))
    assert number == table["track_id"][-1]
    assert speed == pytest.approx(np.hypot(table["vx"][-1], table["vy"][-1]))
    assert f"{number} ({speed:.1f} m/s)" in out.output
    none = run_command(recording, *few, "--json", file, "--end", 0.1)
    assert json.loads(file.read_text())["moving_at_end"] == []
    assert "m/s)" not in none.output


def test_the_element_lies_where_the_truth_says(recording, run):
    folder, _ = run
    found = read_columns(folder / "circles.parquet")
    truth = read_columns(recording.with_suffix(".truth.csv"))
    late = found["t_ns"] - truth["t_ns"].min() > 1_500_000_000
    assert late.sum() > SCANS // 3
    rows = np.searchsorted(truth["t_ns"], found["t_ns"][late])
    for axis in ("x", "y"):
        assert np.abs(found[axis][late] - truth[axis][rows]).max() < POSITION_ERROR
    assert np.abs(found["radius"][late] - RADIUS).max() < RADIUS_ERROR


def test_the_folder_can_be_scored(recording, run):
    folder, _ = run
    result = json_of("evaluate", folder, recording)
    assert result["track_scores"]["position_error"]["rmse"] < 2 * POSITION_ERROR
    assert result["detection_scores"]["n_false"] == 0
    assert result["latency_ms"]["total"]["mean"] > 0


def test_the_mcap_file_holds_scans_poses_and_elements(run):
    folder, _ = run
    with open_recording(folder / "run.mcap") as recording:
        messages = list(recording)
        assert recording.skipped == {"/circles": SCANS, "/shapes": SCANS}
    assert sum(isinstance(item, LaserScan) for item in messages) == SCANS
    assert sum(isinstance(item, Pose) for item in messages) == SCANS


def test_a_run_is_repeated_by_its_note(recording, run, tmp_path):
    folder, first = run
    again = result_of(
        recording,
        "-o",
        tmp_path / "b",
        "--config",
        folder / "run.toml",
        "--no-picture",
        "--no-mcap",
    )
    assert again["circles"] == first["circles"]
    one, other = (read_columns(place / "circles.parquet") for place in (folder, tmp_path / "b"))
    for name, column in one.items():
        np.testing.assert_array_equal(column, other[name])


def test_limits_and_values_come_from_the_configuration(recording, tmp_path):
    result_of(
        recording,
        "-o",
        tmp_path / "a",
        "--set",
        "scanner.range_max=2",
        "--mode",
        "paper",
        "--set",
        "map.report_existence=0.8",
        "--no-picture",
        "--no-mcap",
    )
    config = tomllib.loads((tmp_path / "a" / "run.toml").read_text())["config"]["circles"]
    (scanner,) = config["scanners"].values()
    assert scanner["range_max"] == 2
    assert config["map"]["filter"] == "paper"
    assert config["map"]["report_existence"] == 0.8
    assert config["on_bad_scan"] == "count"


@pytest.mark.parametrize(
    ("arguments", "error", "text"),
    [
        (["--set", "scanner.range_max=-1"], ConfigError, "scanner.range_max"),
        (["--scan", "/none"], ConfigError, "scan: no topic '/none' with 2D scans"),
        (["--mounting", "a b c"], ConfigError, "PARENT FRAME x y z"),
        (["--pose", "nowhere.txt"], FileNotFoundError, "nowhere.txt"),
        (
            ["--set", "scanner.n_beams=5"],
            ConfigError,
            "scanner.n_beams: the recording states this value",
        ),
    ],
)
def test_what_cannot_be_meant_is_refused_before_anything_is_written(
    recording, tmp_path, arguments, error, text
):
    out = run_command(recording, "-o", tmp_path / "run", *arguments)
    assert isinstance(out.exception, error)
    assert text in str(out.exception)
    assert not (tmp_path / "run").exists()


def test_clouds_are_no_2d_scans(tmp_path):
    cloud = lidar_core.messages.Scan(0, np.zeros((1, 3), np.float32))
    write_npz(tmp_path / "a.npz", [cloud])
    out = run_command(tmp_path / "a.npz", "-o", tmp_path / "run")
    assert isinstance(out.exception, FormatError)
    assert "no 2D scans to read" in str(out.exception)


def half(recording, first, topic):
    """The recording's scans with every ray of one half missing, under another name."""
    with open_recording(recording) as opened:
        for item in opened:
            if isinstance(item, Pose):
                yield item if topic == "left" else replace(item, child_frame_id="right")
            else:
                ranges = item.ranges.copy()
                ranges[slice(0, 540) if first else slice(540, None)] = np.nan
                yield replace(
                    item,
                    ranges=ranges,
                    topic=topic,
                    frame_id=item.frame_id if topic == "left" else "right",
                )


def test_two_scanners_feed_one_map(recording, tmp_path):
    both = [*half(recording, True, "left"), *half(recording, False, "right")]
    write_npz(tmp_path / "a.npz", sorted(both, key=lambda item: item.stamp_ns))
    out = run_command(tmp_path / "a.npz", "-o", tmp_path / "run")
    assert "several topics with 2D scans" in str(out.exception)
    result = result_of(
        tmp_path / "a.npz",
        "-o",
        tmp_path / "run",
        "--scan",
        "left",
        "--scan",
        "right",
        "--no-picture",
        "--no-mcap",
    )
    assert result["scans"]["processed"] == 2 * SCANS
    assert result["elements"] == 1
    sensors = read_columns(tmp_path / "run" / "detections.parquet")["sensor"]
    assert set(sensors.tolist()) == {"left", "right"}


def test_a_scan_that_cannot_be_used_is_counted(recording, tmp_path):
    with open_recording(recording) as opened:
        items = list(opened)
    scans = [n for n, item in enumerate(items) if isinstance(item, LaserScan)]
    items[scans[5]] = replace(items[scans[5]], ranges=items[scans[5]].ranges[:100])
    write_npz(tmp_path / "a.npz", items)
    result = result_of(tmp_path / "a.npz", "-o", tmp_path / "run", "--no-picture", "--no-mcap")
    assert result["scans"]["processed"] == SCANS - 1
    assert sum(result["scans"]["rejected"].values()) == 1
    out = run_command(
        tmp_path / "a.npz",
        "-o",
        tmp_path / "b",
        "--no-picture",
        "--no-mcap",
        "--set",
        "on_bad_scan=raise",
    )
    assert isinstance(out.exception, InputError)
    summary = json.loads((tmp_path / "b" / "summary.json").read_text())
    assert summary["scans"]["processed"] == 5


def test_scans_without_a_pose_are_received_and_have_one_reason(recording, tmp_path):
    with open_recording(recording) as opened:
        items = list(opened)
    begin = min(item.stamp_ns for item in items if isinstance(item, LaserScan))
    poses = [n for n, item in enumerate(items) if isinstance(item, Pose) and not item.is_static]
    early = {n for n in poses if items[n].stamp_ns < begin + 4 * 10**8}
    write_npz(tmp_path / "a.npz", [item for n, item in enumerate(items) if n not in early])
    folder = tmp_path / "run"
    result = result_of(tmp_path / "a.npz", "-o", folder, "--no-picture", "--no-mcap")
    ((reason, count),) = result["without_pose"].items()
    assert "is known from" in reason
    assert count >= 2
    assert result["scans"]["received"] == SCANS
    assert result["scans"]["processed"] == SCANS - count
    assert json.loads((folder / "summary.json").read_text())["scans"] == result["scans"]


def log_of(path, lengths):
    """A CARMEN log with a scan of each of these numbers of readings."""
    lines = [
        f"FLASER {rays} {'2.0 ' * rays}0 0 0 0 0 0 {number}.0 host 0\n"
        for number, rays in enumerate(lengths)
    ]
    path.write_text("".join(lines))
    return path


QUICK = ("--no-picture", "--no-mcap")


def test_scans_of_two_lengths_are_two_scanners(tmp_path):
    log = log_of(tmp_path / "a.clf", [180] * 5 + [181] * 15)
    result = result_of(log, "-o", tmp_path / "run", *QUICK)
    assert result["scans"] == {"received": 20, "processed": 20, "rejected": {}}
    config = tomllib.loads((tmp_path / "run" / "run.toml").read_text())["config"]["circles"]
    assert config["scanners"]["FLASER"]["n_beams"] == 181
    assert config["scanners"]["FLASER, 180 rays"]["n_beams"] == 180
    again = result_of(log, "-o", tmp_path / "b", "--config", tmp_path / "run" / "run.toml", *QUICK)
    assert again["scans"] == result["scans"]


def test_a_run_that_rejects_most_scans_fails_and_says_why(tmp_path):
    log = log_of(tmp_path / "a.clf", [180] * 5 + [181] * 15)
    arguments = [
        "--set",
        "scanners.FLASER.n_beams=180",
        "--set",
        "scanners.FLASER.angle_increment=0.017",
        *QUICK,
    ]
    out = run_command(log, "-o", tmp_path / "run", *arguments)
    assert "15 of 20 scans were rejected" in str(out.exception)
    reason = "ranges: expected 180 rows"
    assert reason in str(out.exception)
    assert f"15 rejected: 15 x {reason}" in " ".join(out.output.replace("│", " ").split())
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert summary["scans"]["rejected"] == {reason: 15}


@pytest.mark.parametrize(("unit", "most"), [(1e-3, 10_000.0), (1e-3, 10.0), (1.0, 10.0)])
def test_ranges_in_millimetres_are_named(tmp_path, unit, most):
    """Also if `range_max` is in metres, so that all ranges are misses."""
    ranges = np.round(np.linspace(0.8, 7.0, 181) / unit).astype(np.float32)
    items = [
        LaserScan(number * 10**8, ranges, -1.5, 0.017, 0.1, most, "laser", topic="/scan")
        for number in range(10)
    ]
    path = tmp_path / "scans.npz"
    write_npz(path, items)
    with open_recording(path) as opened:
        told = [one for one in opened.info().defects if "2D LiDAR" in one]
    result = result_of(path, "-o", tmp_path / "run", "--pose", "static", *QUICK)
    noted = [one for one in result["notes"] if "2D LiDAR" in one]
    if unit == 1:
        assert not told
        assert not noted
    else:
        assert told[0].startswith("/scan: half of the ranges are more than 3,8")
        assert "write ranges in millimetres in metres" in told[0]
        assert noted[0].startswith("10 scans: half of the ranges are more than 500 m")


def test_late_scans_have_one_reason(tmp_path):
    scan = LaserScan(0, np.full(181, 2.0, np.float32), -1.5, 0.017, 0.1, 30.0, "laser")
    scanner = lidar_core.circles.Scanner(-1.5, 0.017, 181, 0.1, 10.0)
    run = CirclesRun(CirclePipeline(CirclesConfig(scanner=scanner, on_bad_scan="count")))
    for stamp in (10**12, 1, 2, 3):
        run.take(PosedScan(replace(scan, stamp_ns=stamp), np.eye(4)))
    ((reason, count),) = run.pipeline.health().reasons.items()
    assert count == 3
    assert "later than the map can go back" in reason


def test_a_topic_is_named_once(recording, tmp_path):
    with open_recording(recording) as opened:
        topic = next(item.topic for item in opened if isinstance(item, LaserScan))
    out = run_command(recording, "-o", tmp_path / "run", "--scan", topic, "--scan", topic)
    assert "expected once, it is given 2 times" in str(out.exception)
    assert not (tmp_path / "run").exists()


def test_a_scanner_of_one_ray_is_named_with_its_recording(tmp_path):
    out = run_command(log_of(tmp_path / "onebeam.clf", [1]), "-o", tmp_path / "run")
    assert isinstance(out.exception, FormatError)
    assert "onebeam.clf: FLASER: its scans cannot be used: " in str(out.exception)


def test_a_missing_file_is_told_without_the_number_of_the_error(tmp_path, monkeypatch, capsys):
    arguments = ["circles", str(tmp_path / "no.bag"), "-o", str(tmp_path), "--config", "no.toml"]
    monkeypatch.setattr(sys, "argv", ["lidar-core", *arguments])
    with pytest.raises(SystemExit, match="2"):
        main()
    assert capsys.readouterr().err == "error: no.toml: No such file or directory\n"


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("max_deviation = -1", "a.toml: max_deviation"),
        ("[circles]\nmax_deviation = 1.0", "a.toml: circles: expected its values without"),
    ],
)
def test_problems_of_a_configuration_file_name_it(recording, tmp_path, text, problem):
    (tmp_path / "a.toml").write_text(text)
    out = run_command(recording, "-o", tmp_path / "run", "--config", tmp_path / "a.toml")
    assert isinstance(out.exception, ConfigError)
    assert problem in str(out.exception)


def test_the_first_scan_does_not_count_for_the_time_per_scan():
    times = ScanTimes()
    places = np.diag([1.0, 2.0, 4.0])
    times.add(0, 500.0, {"fit": 1.0}, places[0])
    assert times.ms_per_scan == {"total": 500.0, "fit": 1.0}
    times.add(1, 2.0, {"fit": 1.5}, places[1])
    times.add(2, 4.0, {"fit": 2.5}, places[2])
    assert times.ms_per_scan == {"total": 3.0, "fit": 2.0}
    assert times.table()["total_ms"].tolist() == [500.0, 2.0, 4.0]
    assert times.table()["sensor_y"].tolist() == [0.0, 2.0, 0.0]


def test_points_of_long_runs_are_thinned(recording, monkeypatch):
    monkeypatch.setattr("lidar_core.runs.scans.circles_output.MOST_POINTS", 500)
    with open_recording(recording) as opened:
        items = list(posed_laser_scans(opened))
    scan = items[0].scan
    scanner = lidar_core.circles.Scanner(scan.angle_min, scan.angle_increment, 1081, 0.1, 10.0)
    run = CirclesRun(CirclePipeline(CirclesConfig(scanner=scanner)))
    for item in items:
        run.take(PosedScan(item.scan, item.world_from_lidar, item.pose_stamps_ns))
    points = run.view("a").points
    assert len(points) == len(items)
    assert sum(map(len, points[:-1])) <= 500
    assert len(points[-1]) > 0
    assert len(points[0]) > 0


@pytest.mark.nightly
def test_ctrl_c_leaves_whole_files_and_ends_with_130(recordings, tmp_path):
    folder = tmp_path / "run"
    log = recordings / "2d/radish/mit-csail.clf.bz2"
    with running("circles", log, "-o", folder, "--no-picture") as process:
        for _ in count():
            assert process.poll() is None, process.communicate()
            if folder.exists():
                break
            time.sleep(0.05)
        time.sleep(0.5)
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=120)
    assert process.returncode == 130, errors
    summary = json.loads((folder / "summary.json").read_text())
    assert summary["ended_early"] == "interrupted"
    assert summary["scans"]["processed"] > 0


REAL = {
    "datmo/overtake_red.bag": ["--mounting", "ego_pose laser -0.12 0 0 0 0 0"],
    "leg_tracker/positive_6_extracted.bag": ["--pose", "static"],
    "obstacle_detector/scans_demo.bag": [
        "--pose",
        "static",
        "--scan",
        "/front_scan",
        "--scan",
        "/rear_scan",
        "--mounting",
        "robot front_scanner 0.23565 -0.0005 0.06795 0 0 0",
        "--mounting",
        "robot rear_scanner -0.23832 0.00542 0.09888 0 0 3.141592",
    ],
    "radish/mit-csail.clf.bz2": [],
    "sick_rms_lms/rms_1xxx_lms_1xx_movement_off.bag": ["--pose", "static"],
}


LONG = "radish/mit-csail.clf.bz2"


@pytest.mark.ci_cases("datmo*", "leg*")
@pytest.mark.parametrize(
    ("name", "arguments"),
    [
        pytest.param(*one, marks=[pytest.mark.nightly] if one[0] == LONG else [])
        for one in REAL.items()
    ],
)
def test_real_recordings_are_mapped(recordings, tmp_path, name, arguments):
    result = result_of(recordings / "2d" / name, "-o", tmp_path / "run", "--no-mcap", *arguments)
    scans = result["scans"]
    assert scans["processed"] > 50
    assert sum(scans["rejected"].values()) + sum(result["without_pose"].values()) < 0.05 * (
        scans["received"] + 1
    )
    assert result["elements"] > 0
    table = read_columns(tmp_path / "run" / "circles.parquet")
    assert np.isfinite(table["x"]).all()
    assert (table["radius"] > 0).all()


@pytest.mark.parametrize(
    ("name", "arguments", "persons"),
    [
        ("people/corridor/example1/example1.db3", ["--pose", "static"], 1),
        ("2d/radish/aces.clf.bz2", ["--end", 60.0], 0),
    ],
)
def test_people_are_counted_and_things_are_not(recordings, tmp_path, name, arguments, persons):
    few = (*arguments, "--no-mcap", "--no-picture")
    result = result_of(recordings / name, "-o", tmp_path / "run", *few)
    assert result["elements"] > persons
    assert result["persons"] == persons


ERROR_OF_THE_VEHICLE = 0.25
"""Of the circle from the body of the motion capture, root mean square [m]."""


def test_a_vehicle_is_followed_as_motion_capture_says(recordings, tmp_path):
    bag, run, truth = recordings / "2d/datmo/overtake_red.bag", tmp_path / "run", tmp_path / "t.csv"
    result_of(bag, "-o", run, "--no-mcap", "--no-picture", *REAL["datmo/overtake_red.bag"])
    example = ROOT / "examples" / "motion_capture_truth.py"
    done = subprocess.run(
        [sys.executable, example, bag, "/red_pose", run, truth],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert "129 of 130 scans" in done.stdout
    scores = json_of("evaluate", run, truth, "--gate", 0.5, "--no-identities")["track_scores"]
    assert scores["recall"] > 0.95
    assert scores["position_error"]["rmse"] < ERROR_OF_THE_VEHICLE


def test_paper_mode_refuses_a_recording_of_another_scanner(tmp_path):
    """The paper's network knows one scanner; a fit in its place is for any."""
    scene = sim.circle_scenes.single(RADIUS, 2)
    planar = scene.lidar.pattern.model_copy(update={"beams": 541, "angle_increment": 0.00873})
    lidar = scene.lidar.model_copy(update={"pattern": planar})
    path = tmp_path / "other.npz"
    sim.record(scene.model_copy(update={"lidar": lidar}), path, seed=1101, scans=5)
    out = run_command(path, "-o", tmp_path / "run", "--mode", "paper")
    assert isinstance(out.exception, ConfigError)
    text = str(out.exception)
    assert "paper-cnn was trained for 1081 rays from -135.0 to 135.0 deg" in text
    assert "got 541 rays" in text
    result_of(
        path,
        "-o",
        tmp_path / "run",
        "--mode",
        "paper",
        "--set",
        "detector=taubin",
        "--no-picture",
        "--no-mcap",
    )


def test_the_help_offers_no_poses_that_are_refused():
    text = " ".join(invoke("circles", "--help").output.split())
    assert "KISS" not in text
    assert "KISS" in " ".join(invoke("detect", "--help").output.split())
