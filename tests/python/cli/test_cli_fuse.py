"""`lidar-core fuse`: measurements in, run folders out."""

import csv
import signal
import subprocess
import sys
import time
import tomllib
from functools import partial

import numpy as np
import pytest
from commands import invoke, json_of
from matplotlib.image import imread

import lidar_core as lc
from lidar_core import ConfigError, FormatError, InputError
from lidar_core.extras import install_command
from lidar_core.fusion import (
    FusionConfig,
    Measurement,
    TableOptions,
    read_laser_radar,
    read_measurements,
    run,
    smooth,
)
from lidar_core.fusion.states import STATES, dimensions, state_names, velocities
from lidar_core.io.tables.columns import read_columns
from lidar_core.runs.settings import ConfigChoice
from lidar_core.runs.targets.noise import names_told
from lidar_core.viz import Playback

OBJ_POSE = "fusion/obj_pose-laser-radar-synthetic-input.txt"
EXACT = 1e-12
"""Decimal text and back."""
SEED = 6200


command, result_of = partial(invoke, "fuse"), partial(json_of, "fuse")
fit = partial(invoke, "config", "fit")


def rows(count=60):
    """A target that goes straight, LiDAR and radar in turn: dicts, as a table has them."""
    rng = np.random.default_rng(SEED)
    for k in range(count):
        at, speed = np.array([5 + 0.05 * k, 2.0]), np.array([1.0, 0.0])
        row = {"t_ns": 50_000_000 * k, "sensor": "RL"[k % 2]}
        row |= dict(zip(("true_x", "true_y", "true_vx", "true_vy"), [*at, *speed], strict=True))
        seen = at + rng.normal(0, 0.1, 2)
        distance = np.hypot(*seen)
        polar = [distance, np.arctan2(seen[1], seen[0]), seen @ speed / distance]
        row |= dict.fromkeys(("x", "y", "range", "bearing", "range_rate"), "")
        names = ("x", "y") if k % 2 else ("range", "bearing", "range_rate")
        yield row | dict(zip(names, seen if k % 2 else polar, strict=True))


def write(path, content):
    content = list(content)
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, list(content[0]))
        writer.writeheader()
        writer.writerows(content)
    return path


@pytest.fixture
def table(tmp_path):
    return write(tmp_path / "table.csv", rows())


def test_a_recording_becomes_a_run_folder(recordings, tmp_path):
    folder = tmp_path / "run"
    result = result_of(recordings / OBJ_POSE, "-o", folder)
    recording = read_laser_radar(recordings / OBJ_POSE)
    expected = run(recording.measurements)
    error = expected.states[:, :2] - recording.truth.position
    rmse = np.sqrt((error**2).mean(axis=0))
    assert [result["rmse"]["x"], result["rmse"]["y"]] == pytest.approx(rmse.tolist())
    assert result["measurements"] == {"lidar": 250, "radar": 250}
    assert result["outcomes"] == {"started": 1, "updated": 499}
    assert 0.9 < result["nis"]["radar"]["share_below_limit"] <= 1
    assert result["nis"]["lidar"]["mean"] == pytest.approx(np.nanmean(expected.nis[0::2]))
    assert set(result["files"]) <= {path.name for path in folder.iterdir()}
    pytest.importorskip("pyarrow")
    states = read_columns(folder / "states.parquet")
    np.testing.assert_array_equal(states["vy"], expected.states[:, 3])
    np.testing.assert_array_equal(states["cov_x_w"], expected.covariances[:, 0, 4])
    np.testing.assert_array_equal(states["innovation_3"], expected.innovations[:, 2])
    assert states["sensor"].tolist()[:2] == ["lidar", "radar"]
    note = tomllib.loads((folder / "run.toml").read_text())
    assert note["config"]["fusion"]["model"] == "ct"
    assert note["input"]["recording"]["bytes"] == (recordings / OBJ_POSE).stat().st_size
    lines = (folder / "tracks_tum" / "track_0.txt").read_text().splitlines()
    assert len(lines) == len(expected.stamps_ns)
    assert imread(folder / "picture.png").shape[:2] == (630, 1080)


def test_a_run_is_scored_by_evaluate(recordings, tmp_path):
    folder = tmp_path / "run"
    result_of(recordings / OBJ_POSE, "-o", folder, "--no-picture")
    scores = json_of("evaluate", folder, folder)["track_scores"]
    assert scores["n_found"] == scores["n_eligible"] == 500
    assert scores["n_matched"] == scores["n_estimates"]


def test_smoothing_is_better_and_the_run_file_is_a_configuration(recordings, tmp_path):
    arguments = (recordings / OBJ_POSE, "--no-picture", "--method", "ukf")
    filtered = result_of(*arguments, "-o", tmp_path / "a", "--set", "turn_noise=0.4")
    smoothed = result_of(
        *arguments, "-o", tmp_path / "b", "--lag", 0.5, "--config", tmp_path / "a" / "run.toml"
    )
    assert smoothed["rmse"]["position_2d"] < 0.8 * filtered["rmse"]["position_2d"]
    recording = read_laser_radar(recordings / OBJ_POSE)
    config = FusionConfig(method="ukf", turn_noise=0.4)
    expected = smooth(recording.measurements, config, lag=0.5).states[:, 0]
    error = expected - recording.truth.position[:, 0]
    assert smoothed["rmse"]["x"] == pytest.approx(np.sqrt((error**2).mean()))


def test_the_published_filter_runs(recordings, tmp_path):
    result = result_of(recordings / OBJ_POSE, "-o", tmp_path / "run", "--mode", "paper")
    assert result["model"] == "paper"
    assert result["states"][-1] == "w_d"


@pytest.mark.parametrize("model", list(STATES))
@pytest.mark.parametrize("method", ["ekf", "imm"])
def test_states_have_names(model, method, table):
    if model == "paper" and method == "imm":
        method = "ekf"
    for gyro in ("input", "none"):
        config = FusionConfig(model=model, method=method, gyro=gyro)
        seen, size = read_measurements(table).measurements, dimensions(config)
        if size == 3:  # what starts a target in space has a height
            seen = [Measurement(m.stamp_ns, "lidar", [*m.values[:2], 1.0]) for m in seen]
        states = run(seen, config).states
        assert len(state_names(config)) == states.shape[1]
        assert velocities(states, config).shape == (len(states), size)


# Viewers


def looking_around(count=60):
    """The target of `rows`, seen by LiDAR from a platform that moves and turns."""
    rng = np.random.default_rng(SEED + 1)
    for k in range(count):
        x, y, yaw = 0.02 * k, -0.01 * k, 0.05 * k
        away = np.array([5 + 0.05 * k - x, 2.0 - y]) + rng.normal(0, 0.1, 2)
        c, s = np.cos(yaw), np.sin(yaw)
        yield {
            "t_ns": 50_000_000 * k,
            "pose_x": x,
            "pose_y": y,
            "pose_yaw": yaw,
            "x": c * away[0] + s * away[1],
            "y": -s * away[0] + c * away[1],
        }


def test_a_run_is_played_in_the_world(tmp_path):
    pytest.importorskip("foxglove")
    path, folder = write(tmp_path / "moving.csv", looking_around()), tmp_path / "run"
    assert "run.mcap" in result_of(path, "-o", folder, "--no-picture")["files"]
    played = Playback(folder)
    assert played.capability == "fusion"
    moments = list(played.moments())
    assert len(moments) == 60
    for moment in moments:
        (place,), (track,) = moment.points, moment.objects.position
        assert np.linalg.norm(place - track) < 1.0
        assert moment.objects.covariance[0, 0, 0] > 0
    tracks, truth = read_columns(folder / "run.mcap"), [8.0 - 0.05, 2.0]
    assert len(tracks["t_ns"]) == 60
    np.testing.assert_allclose([tracks["x"][-1], tracks["y"][-1]], truth, atol=0.5)
    drawn = invoke("view", folder, "--png", tmp_path / "a.png")
    assert drawn.exit_code == 0, drawn.output
    assert not (tmp_path / "none").exists()
    none = result_of(path, "-o", tmp_path / "none", "--no-picture", "--no-mcap")
    assert "run.mcap" not in none["files"]


def test_times_before_1970_leave_no_file_for_viewers(tmp_path):
    content = [row | {"t_ns": row["t_ns"] - 10**9} for row in looking_around()]
    path = write(tmp_path / "early.csv", content)
    assert "run.mcap" not in result_of(path, "-o", tmp_path / "a", "--no-picture")["files"]
    told = lc.runs.fuse(path, None, tmp_path / "b", picture=False).notes
    assert told == ("no run.mcap: MCAP holds no times below 0, and the first is -1 s",)
    assert lc.runs.fuse(path, None, tmp_path / "c", picture=False, mcap=False).notes == ()


# Tables


def test_a_table_is_read(table, tmp_path):
    log = read_measurements(table)
    expected = list(rows())
    assert [m.sensor for m in log.measurements[:3]] == ["radar", "lidar", "radar"]
    for m, row in zip(log.measurements, expected, strict=True):
        names = ("x", "y") if m.sensor == "lidar" else ("range", "bearing", "range_rate")
        np.testing.assert_allclose(m.values, [row[name] for name in names], rtol=EXACT)
        assert m.stamp_ns == row["t_ns"]
    assert log.truth.position[-1].tolist() == [expected[-1]["true_x"], 2.0]
    result = result_of(table, "-o", tmp_path / "run")
    assert result["rmse"]["position_2d"] < 0.2
    assert result["format"] == "table (csv)"


def test_without_a_column_of_sensors_rows_give_what_they_hold(tmp_path):
    content = [{name: value for name, value in row.items() if name != "sensor"} for row in rows()]
    content[1] |= {"range": 5.4, "bearing": 0.3, "range_rate": 0.9}
    log = read_measurements(write(tmp_path / "wide.csv", content))
    assert [m.sensor for m in log.measurements[:4]] == ["radar", "lidar", "radar", "radar"]
    assert len(log.measurements) == len(log.truth.stamps_ns) == len(content) + 1


def test_columns_and_units_are_mapped(tmp_path):
    content = []
    for row in rows():
        a, b, c = (
            (row["x"], row["y"], "")
            if row["sensor"] == "L"
            else (row["range"], np.degrees(row["bearing"]), row["range_rate"])
        )
        content.append(
            {"time": f"{row['t_ns'] * 1e-9:.3f}", "kind": row["sensor"], "a": a, "b": b, "c": c}
        )
    path = write(tmp_path / "other.csv", content)
    names = {
        "t_ns": "time",
        "sensor": "kind",
        "x": "a",
        "y": "b",
        "range": "a",
        "bearing": "b",
        "range_rate": "c",
    }
    log = read_measurements(path, TableOptions(columns=names, time_unit="s", angle_unit="deg"))
    for m, row in zip(log.measurements, rows(), strict=True):
        assert m.stamp_ns == row["t_ns"]
        if m.sensor == "radar":
            assert m.values[1] == pytest.approx(row["bearing"], rel=EXACT)
    assert log.truth is None
    options = [f"--column={ours}={theirs}" for ours, theirs in names.items()]
    result = result_of(
        path, "-o", tmp_path / "run", *options, "--time-unit", "s", "--angle-unit", "deg"
    )
    assert result["rmse"] is None
    assert result["measurements"] == {"radar": 30, "lidar": 30}


def test_columns_of_other_units_and_signs_are_scaled_as_they_were_read(table, tmp_path):
    content = [
        {
            "t_ns": row["t_ns"],
            "R [mm]": row["range"] and 1000 * row["range"],
            "bearing": row["bearing"],
            "closing": row["range_rate"] and -row["range_rate"],
            "x": row["x"],
            "y": row["y"],
        }
        for row in rows()
    ]
    path = write(tmp_path / "scaled.csv", content)
    names = {"range": "R [mm]", "range_rate": "closing"}
    options = [f"--column={ours}={theirs}" for ours, theirs in names.items()]
    factors = {"range": 0.001, "range_rate": -1}
    log = read_measurements(path, TableOptions(columns=names, scale=factors))
    for m, expected in zip(log.measurements, read_measurements(table).measurements, strict=True):
        np.testing.assert_allclose(m.values, expected.values, rtol=EXACT)
    refused = command(path, "-o", tmp_path / "run", *options, "--scale=range_rate=-1")
    assert "--scale range=0.001" in str(refused.exception)
    out = ["-o", tmp_path / "run", "--no-picture", *options]
    told = result_of(path, *out, "--scale", "range=0.001", "--scale", "range_rate=-1")
    assert told["nis"]["radar"]["mean"] < 4
    note = tomllib.loads((tmp_path / "run/run.toml").read_text())
    assert note["config"]["fusion_table"]["scale"] == factors


def test_a_truth_of_positions_alone_gives_their_errors(table, tmp_path):
    whole = result_of(table, "-o", tmp_path / "whole", "--no-picture")["rmse"]
    assert whole["vx"] > 0
    content = [
        {name: value for name, value in row.items() if name not in ("true_vx", "true_vy")}
        for row in rows()
    ]
    path, folder = write(tmp_path / "places.csv", content), tmp_path / "places"
    known = result_of(path, "-o", folder)["rmse"]
    assert known == whole | {"vx": None, "vy": None}
    printed = command(path, "-o", tmp_path / "printed", "--no-picture").output
    assert "RMSE x" in printed
    assert "RMSE vx" not in printed
    assert {"true_x", "true_y"} <= set(states := read_columns(folder / "states.parquet"))
    assert not {"true_vx", "true_vy"} & set(states)
    scores = json_of("evaluate", folder, folder)["track_scores"]
    assert scores["n_found"] == scores["n_eligible"] == 60


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({"true_x": 1.0}, "true_x without true_y; "),
        ({"true_x": 1.0, "true_y": 2.0, "true_vy": 0.0}, "true_x, true_y, true_vy without true_vx"),
        ({"true_vx": 1.0, "true_vy": 2.0}, "true_vx, true_vy without true_x, true_y"),
    ],
)
def test_a_truth_that_lacks_a_column_is_refused_with_its_name(tmp_path, given, told):
    path = write(tmp_path / "part.csv", [{"t_ns": 0, "x": 1.0, "y": 2.0, **given}])
    with pytest.raises(InputError, match=told) as refused:
        read_measurements(path)
    assert 'columns={"true_' in str(refused.value)


def test_poses_bring_their_deviations(tmp_path):
    known = {"pose_std_x": 0.1, "pose_std_y": 0.2, "pose_std_yaw": 3.0}
    content = [
        row | (dict.fromkeys(known, "") if row["t_ns"] else known) for row in looking_around(4)
    ]
    log = read_measurements(write(tmp_path / "told.csv", content), TableOptions(angle_unit="deg"))
    first, second = [m for m in log.measurements if m.sensor == "pose"][:2]
    expected = np.diag([0.01, 0.04, np.radians(3) ** 2])
    np.testing.assert_allclose(first.covariance, expected, rtol=EXACT)
    assert second.covariance is None


def test_rows_may_come_in_any_order(table, tmp_path):
    content = list(rows())
    mixed = write(tmp_path / "mixed.csv", content[30:] + content[:30])
    same = result_of(table, "-o", tmp_path / "a", "--no-picture")
    other = result_of(mixed, "-o", tmp_path / "b", "--no-picture")
    assert other["rmse"] == same["rmse"]


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (lambda row: {"time": row["t_ns"]}, "no column t_ns among time"),
        (lambda row: {"t_ns": row["t_ns"], "x": 1.0}, "no sensor has all its columns"),
        (lambda row: row | {"sensor": "sonar"}, "row 1: column sensor: expected one of"),
        (lambda row: row | {"x": "east"}, "row 1: column x: expected a number, got 'east'"),
        (lambda row: row | {"t_ns": "nan"}, "row 1: column t_ns: expected a time"),
        (lambda row: row | {"t_ns": 10**19}, "row 1: column t_ns: expected a time"),
        (lambda row: row | {"true_x": "nan"}, "a true value is not finite"),
        (lambda row: {"t_ns": row["t_ns"], "x": "", "y": ""}, "no row holds all values"),
    ],
)
def test_broken_tables_are_told(tmp_path, change, text):
    path = write(tmp_path / "broken.csv", map(change, rows(4)))
    with pytest.raises(FormatError, match=text):
        read_measurements(path)


@pytest.mark.parametrize(
    ("arguments", "error", "text"),
    [
        (("--column", "x"), ConfigError, "expected OURS=THEIRS"),
        (("--column", "w=x"), InputError, "expected names among t_ns"),
        (("--column", "x=east"), FormatError, "no column 'east'"),
        (("--time-unit", "day"), ConfigError, "time_unit"),
        (("--model", "ballistic"), ConfigError, "model"),
        (("--method", "kf"), ConfigError, "expected model cv, ca, cv-3d"),
        (("--azimuth", "bearing=left"), ConfigError, "azimuth"),
        (("--clock", "radar=late"), ConfigError, "expected seconds"),
        (("--scale", "range"), ConfigError, "such as range=0.001"),
        (("--scale", "range=mm"), ConfigError, "--scale range=mm: expected a number"),
        (("--scale", "range=0"), ConfigError, "factors other than 0"),
        (("--scale", "range=nan"), ConfigError, "scale"),
        (("--scale", "t_ns=1000"), ConfigError, "expected columns among x, y"),
        (("--scale", "z=2"), InputError, "scale: no column z among t_ns"),
        (("--lag", "-1"), InputError, "lag"),
        (("--association", "any"), ConfigError, "association"),
        (("--topic", "radar=/front"), ConfigError, "--topic does not apply to a table"),
        (("--set", "on_bad_scan=count"), ConfigError, "on_bad_scan"),
    ],
)
def test_what_cannot_be_meant_is_refused_before_anything_is_written(
    table, tmp_path, arguments, error, text
):
    out = command(table, "-o", tmp_path / "run", *arguments)
    assert isinstance(out.exception, error), out.exception
    assert text in str(out.exception)
    assert not (tmp_path / "run").exists()


def test_a_part_of_a_table_is_fused(table, tmp_path):
    folder = tmp_path / "run"
    told = result_of(table, "-o", folder, "--start", 0.5, "--end", 1.0, "--no-picture")
    assert told["measurements"] == {"radar": 6, "lidar": 5}
    assert read_columns(folder / "truth.parquet")["t_ns"].tolist() == [
        50_000_000 * k for k in range(10, 21)
    ]
    note = tomllib.loads((folder / "run.toml").read_text())
    assert note["config"]["span"] == {"start": 0.5, "end": 1.0}
    empty = command(table, "-o", tmp_path / "no", "--start", 99)
    assert isinstance(empty.exception, InputError)
    text = f"{table}: no measurements from 99 s on, counted from the first stamp; they end at"
    assert str(empty.exception).startswith(text)


@pytest.mark.parametrize(
    ("name", "option", "value"),
    [
        ("a.bag", "--column", "x=y"),
        ("a.bag", "--time-unit", "s"),
        ("a.json", "--topic", "radar=/a"),
        ("a.json", "--angle-unit", "deg"),
        ("a.txt", "--column", "x=y"),
        ("a.txt", "--time-unit", "s"),
        ("a.txt", "--scale", "range=2"),
    ],
)
def test_options_of_other_recordings_are_refused(tmp_path, name, option, value):
    (tmp_path / name).write_text("")
    out = command(tmp_path / name, "-o", tmp_path / "run", option, value)
    assert isinstance(out.exception, ConfigError)
    assert f"{name}: {option} does not apply to" in str(out.exception)


def test_a_run_without_matplotlib_says_what_brings_the_picture(table, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    out = command(table, "-o", tmp_path / "run")
    assert out.exit_code == 0
    assert install_command("plot") in out.stderr
    assert not (tmp_path / "run" / "picture.png").exists()


def test_a_target_that_is_never_seen_leaves_whole_files(tmp_path):
    path = write(tmp_path / "gyro.csv", [{"t_ns": k, "turn_rate": 0.1} for k in range(5)])
    result = result_of(path, "-o", tmp_path / "run")
    assert result["outcomes"] == {"told": 5}
    assert (tmp_path / "run" / "picture.png").exists()


def noisy(path, lidar_std, seed, count=400):
    """A target on a circle, seen by a LiDAR with this noise."""
    rng = np.random.default_rng(seed)
    lines = ["t_ns,x,y"]
    for k in range(count):
        turned = 0.02 * k
        x, y = 10 * np.cos(turned), 10 * np.sin(turned)
        x, y = np.array([x, y]) + rng.normal(0, lidar_std, 2)
        lines.append(f"{50_000_000 * k},{x},{y}")
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.mark.ci_cases("0.05")
@pytest.mark.parametrize("std", [0.05, 0.6])
def test_config_fit_finds_the_noise_and_fuse_reads_its_file(tmp_path, std):
    """The noise that made the recordings comes out, and the filter with it is consistent."""
    places = [noisy(tmp_path / f"{seed}.csv", std, SEED + seed) for seed in range(2)]
    done = fit(*places, "-o", tmp_path / "fit.toml", "--overwrite", "--method", "ukf")
    assert done.exit_code == 0, done.output or done.exception
    assert "lidar_std" in done.output
    fitted = FusionConfig.read(tmp_path / "fit.toml")
    assert fitted.method == "ukf"
    assert fitted.lidar_std == pytest.approx((std, std), rel=0.1)
    out = ["-o", tmp_path / "run", "--overwrite", "--no-picture"]
    summary = result_of(places[0], *out, "--config", tmp_path / "fit.toml")
    assert summary["nis"]["lidar"]["mean"] == pytest.approx(2, abs=0.35)


def test_fuse_with_fit_noise_is_fuse_with_the_file_of_config_fit(tmp_path):
    place = noisy(tmp_path / "a.csv", 0.6, SEED)
    assert fit(place, "-o", tmp_path / "fit.toml").exit_code == 0
    assert lc.runs.fit_config([place]) == FusionConfig.read(tmp_path / "fit.toml")
    out = ["-o", tmp_path / "run", "--overwrite", "--no-picture"]
    states = []
    for ways in (["--fit-noise"], ["--config", tmp_path / "fit.toml"], []):
        result_of(place, *out, *ways)
        states.append(read_columns(tmp_path / "run" / "states.parquet"))
    of_fit, of_file, plain = ({n: np.asarray(s[n]) for n in ("x", "y")} for s in states)
    assert all(np.array_equal(of_fit[name], of_file[name]) for name in of_fit)
    assert not np.array_equal(of_fit["x"], plain["x"])


@pytest.mark.parametrize(
    ("config", "ways", "told"),
    [
        (None, (), set()),
        (ConfigChoice(values=("fusion.lever_arm=[1.0, 0.0]",)), (), {"lever_arm"}),
        (ConfigChoice(values=('model="cv"',)), (), {"model"}),
        (ConfigChoice(values=('fusion.method = "imm"',)), (), {"method"}),
        (ConfigChoice(file="a.toml"), (), {"lever_arm"}),
        (ConfigChoice("paper"), (), {"model"}),
        (None, ("method",), {"method"}),
        (FusionConfig(sensor_noise="estimated"), (), {"model", "sensor_noise"}),
    ],
)
def test_a_fit_leaves_what_somebody_told(tmp_path, monkeypatch, config, ways, told):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.toml").write_text("lever_arm = [1.0, 0.0]\n")
    assert names_told(config, ways) == told


def test_a_fit_says_what_it_found_and_keeps_what_was_told(tmp_path):
    place = noisy(tmp_path / "a.csv", 0.6, SEED)
    free = lc.runs.fuse(place, None, tmp_path / "free", fit_noise=True, picture=False)
    (note,) = [one for one in free.notes if "found" in one]
    assert "the likelier one of ct and ctrv" in note
    assert "sensor_noise configured" in note
    chosen = ConfigChoice(values=('model="cv"', 'sensor_noise="estimated"'))
    kept = lc.runs.fuse(place, chosen, tmp_path / "kept", fit_noise=True, picture=False)
    (note,) = [one for one in kept.notes if "found" in one]
    assert "likelier" not in note
    assert "sensor_noise estimated" in note


def test_config_fit_prints_with_a_dash_as_without_a_file(tmp_path, monkeypatch):
    place = noisy(tmp_path / "a.csv", 0.6, SEED)
    monkeypatch.chdir(tmp_path)
    printed = [fit(place, *ways).output for ways in ([], ["-o", "-"])]
    assert "lidar_std" in printed[0]
    assert printed[0] == printed[1]
    assert [path.name for path in tmp_path.iterdir()] == ["a.csv"]


def test_config_fit_uses_the_span_alone(tmp_path):
    """Noise of the first half is .05 m, of the second .6 m."""
    quiet, loud = (noisy(tmp_path / f"{s}.csv", s, SEED).read_text() for s in (0.05, 0.6))
    later = [line for line in loud.splitlines()[1:] if int(line.split(",")[0]) >= 10**10]
    head = quiet.splitlines()[:201]
    both = tmp_path / "both.csv"
    both.write_text("\n".join([*head, *later]) + "\n")
    first = lc.runs.fit_config(both, span=lc.io.Span(end=9.9))
    second = lc.runs.fit_config(both, span=lc.io.Span(start=10.1))
    assert first.lidar_std[0] == pytest.approx(0.05, rel=0.15)
    assert second.lidar_std[0] == pytest.approx(0.6, rel=0.15)


def test_config_fit_refuses_what_it_cannot_use(tmp_path):
    short = noisy(tmp_path / "short.csv", 0.1, SEED, count=12)
    with pytest.raises(InputError, match="measurements"):
        lc.runs.fit_config(short)
    with pytest.raises(InputError, match="expected at least one"):
        lc.runs.fit_config([])
    place = noisy(tmp_path / "a.csv", 0.1, SEED)
    done = fit(place, "--mode", "paper")
    assert isinstance(done.exception, ConfigError), done.output
    kept = tmp_path / "kept.toml"
    kept.write_text("mine")
    done = fit(place, "-o", kept)
    assert isinstance(done.exception, FileExistsError)
    assert kept.read_text() == "mine"
    done = fit(tmp_path / "nothing.csv")
    assert isinstance(done.exception, OSError), done.exception


def test_the_noise_of_many_targets_is_not_sought(recordings, tmp_path):
    boats = recordings / "2d/autoferry/scenario17/scenario17_detections.json"
    with pytest.raises(ConfigError, match="many targets"):
        lc.runs.fit_config(boats)
    with pytest.raises(ConfigError, match="fit_noise"):
        lc.runs.fuse(boats, None, tmp_path / "run", fit_noise=True)
    assert not (tmp_path / "run").exists()


def lines_of(recordings):
    return (recordings / "fusion/sample-laser-radar-measurement-data-1.txt").read_text().split("\n")


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("change", "shown"),
    [
        (lambda w: [w[0], w[2], w[1], *w[3:]] if w[0] == "L" else w, "x and y of the LiDAR"),
        (
            lambda w: [w[0], w[1], str(np.rad2deg(float(w[2]))), *w[3:]] if w[0] == "R" else w,
            "degrees",
        ),
        (lambda w: [w[0], w[1], str(-float(w[2])), *w[3:]] if w[0] == "R" else w, "clockwise"),
    ],
    ids=["exchanged", "degrees", "mirrored"],
)
def test_a_fit_does_not_take_a_mistake_for_noise(recordings, tmp_path, change, shown):
    """Whether the model is told, or found."""
    words = [line.split() for line in lines_of(recordings) if line.strip()]
    place = tmp_path / "wrong.txt"
    place.write_text("\n".join("\t".join(change(one)) for one in words) + "\n")
    with pytest.raises(
        InputError, match=rf"mistake that noise cannot explain\. The data shows: .*{shown}"
    ):
        lc.runs.fit_config(place, model="ct")
    with pytest.raises(InputError, match="mistake"):
        lc.runs.fuse(place, None, tmp_path / "run", fit_noise=True)
    assert not (tmp_path / "run").exists()
    assert lc.runs.fit_config(place, model="ct", force=True).lidar_std != FusionConfig().lidar_std


def test_a_fit_needs_every_recording_to_be_long_and_possible(recordings, tmp_path):
    short = tmp_path / "short.txt"
    short.write_text("\n".join(lines_of(recordings)[:5]) + "\n")
    good = noisy(tmp_path / "a.csv", 0.1, SEED)
    with pytest.raises(InputError, match=r"short\.txt: expected more than 10 measurements"):
        lc.runs.fit_config([good, short])
    far = tmp_path / "far.csv"
    far.write_text(good.read_text().replace("\n500000000,", "\n500000000,1e300,0\n500000001,"))
    with pytest.raises(InputError, match=r"far\.csv: .*possible with some noise"):
        lc.runs.fit_config(far)


def test_a_fit_leaves_what_it_does_not_need(tmp_path):
    """Values without influence on the likelihood, and noises that no mixed model has."""
    begin = FusionConfig(method="imm", imm_models=("cv", "ctrv"))
    fitted = lc.runs.fit_config(noisy(tmp_path / "a.csv", 0.1, SEED), begin)
    assert fitted.jerk_noise == begin.jerk_noise
    assert fitted.radar_std == begin.radar_std
    assert fitted.acceleration_noise != begin.acceleration_noise


def test_config_fit_does_not_replace_what_it_reads(tmp_path):
    place = noisy(tmp_path / "a.csv", 0.1, SEED)
    kept = place.read_text()
    done = fit(place, "-o", place, "--overwrite")
    assert isinstance(done.exception, ConfigError)
    assert "is also an input" in str(done.exception)
    assert place.read_text() == kept


@pytest.mark.nightly
@pytest.mark.skipif(sys.platform == "win32", reason="POSIX signals")
def test_ctrl_c_ends_a_fit_soon(tmp_path):
    place = noisy(tmp_path / "long.csv", 0.5, SEED, count=60_000)
    out = tmp_path / "fit.toml"
    command = [sys.executable, "-m", "lidar_core", "config", "fit", str(place), "-o", str(out)]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as running:
        time.sleep(6)
        assert running.poll() is None, "the fit is too short for this test"
        start = time.monotonic()
        running.send_signal(signal.SIGINT)
        assert running.wait(20) == 130
        assert time.monotonic() - start < 5
    assert not out.exists()
