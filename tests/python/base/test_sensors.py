"""LiDARs that are sold: simulator, detector and circles see them as their data sheets do."""

import runpy
import tomllib
from typing import get_args

import numpy as np
import pytest
from repository import ROOT
from typer.testing import CliRunner

from lidar_core import ConfigError, sim
from lidar_core.circles import CirclesConfig, Scanner
from lidar_core.cli import app
from lidar_core.cli.simulate import BUILT_IN
from lidar_core.flying import FlyingConfig, SensorConfig
from lidar_core.flying.sensor_config import BEAM_TABLES, Beams
from lidar_core.io import open_recording
from lidar_core.messages import LaserScan
from lidar_core.sensors import LONGEST_2D, LONGEST_3D, SENSORS, far_median

SPATIAL = {
    "os0-32": (32, 1024, -45, 45),
    "os0-64": (64, 1024, -45, 45),
    "os0-128": (128, 1024, -45, 45),
    "os1-32": (32, 1024, -22.5, 22.5),
    "os1-64": (64, 1024, -22.5, 22.5),
    "os1-128": (128, 1024, -22.5, 22.5),
    "os2-32": (32, 1024, -11.25, 11.25),
    "os2-64": (64, 1024, -11.25, 11.25),
    "os2-128": (128, 1024, -11.25, 11.25),
    "vlp-16": (16, 1800, -15, 15),
    "hdl-32e": (32, 2170, -30.67, 10.67),
    "hdl-64e": (64, 2083, -24.33, 2),
    "vls-128": (128, 1876, -25, 15),
    "xt32": (32, 2000, -16, 15),
    "pandar64": (64, 1800, -25, 15),
    "qt128": (128, 900, -52.6, 52.6),
    "rs16": (16, 1800, -15, 15),
}
"""Rows, columns and elevations [deg] of data sheets."""
PLANAR = {
    "utm-30lx": (1081, 270, 40, 30),
    "urg-04lx": (683, 239.77, 10, 4.095),
    "rplidar-s1": (920, 359.6, 10, 40),
    "lms111": (541, 270, 50, 20),
    "lms151": (541, 270, 50, 50),
    "tim551": (271, 270, 15, 10),
    "tim571": (811, 270, 15, 25),
}
"""Rays, angle [deg], rate [Hz] and range [m] of data sheets."""
LIVOX = {
    "livox-mid360": (20_000, 360, -7, 52),
    "livox-avia": (24_000, 70.4, -38.6, 38.6),
    "livox-hap": (45_200, 120, -12.5, 12.5),
    "livox-horizon": (24_000, 81.7, -12.55, 12.55),
}
"""Rays in 0.1 s, azimuth and elevations [deg]."""


def angles(scan):
    x, y, z = scan.directions.T.astype(np.float64)
    return np.rad2deg(np.arctan2(y, x)), np.rad2deg(np.arcsin(z))


def test_every_sensor_is_here():
    assert set(SENSORS) == {*SPATIAL, *PLANAR, *LIVOX}
    assert all(sensor.note and sensor.title for sensor in SENSORS.values())
    assert set(get_args(Beams)) == {*BEAM_TABLES, "auto", "given", "learnt"}
    assert {*SPATIAL} <= {*BEAM_TABLES}


@pytest.mark.parametrize("name", SPATIAL)
def test_rows_that_turn_have_the_rays_and_the_field_of_view(name):
    rows, columns, low, high = SPATIAL[name]
    (made,) = sim.simulate(
        sim.Scene(lidar=sim.LidarModel.preset(name, ideal=True), scans=1), seed=0
    )
    assert made.scan.points.shape == (rows, columns, 3)
    azimuth, elevation = angles(made.scan)
    np.testing.assert_allclose((elevation.min(), elevation.max()), (low, high), atol=0.01)
    elevation = elevation.reshape(rows, columns)
    assert (np.diff(elevation[:, 0]) < 0).all()  # top row first
    turned = np.unwrap(np.deg2rad(azimuth.reshape(rows, columns)[0]))
    assert abs(turned[-1] - turned[0]) == pytest.approx(2 * np.pi * (1 - 1 / columns), abs=1e-5)


@pytest.mark.parametrize("name", PLANAR)
def test_2d_sensors_have_the_rays_the_angle_and_the_rate(name):
    beams, angle, rate, reach = PLANAR[name]
    lidar = sim.LidarModel.preset(name, ideal=True)
    assert (lidar.scan_rate, lidar.range_max) == (rate, reach)
    (made,) = sim.sweeps(sim.Scene(lidar=lidar, scans=1), seed=0)
    scan = made.scan
    assert scan.ranges.shape == (beams,)
    assert np.rad2deg(scan.angle_increment) * (beams - 1) == pytest.approx(angle, abs=0.02)
    assert scan.angle_min == pytest.approx(-np.deg2rad(angle) / 2, abs=2e-4)
    config = CirclesConfig.load({"scanner": {"preset": name}})
    assert config.scanner.n_beams == beams
    assert config.scanner.range_max == reach
    np.testing.assert_allclose(
        config.scanner.bearings(), scan.angle_min + scan.angle_increment * np.arange(beams)
    )


@pytest.mark.parametrize("name", LIVOX)
def test_patterns_that_do_not_repeat_fill_the_field_of_view(name):
    rays, width, low, high = LIVOX[name]
    scene = sim.Scene(lidar=sim.LidarModel.preset(name, ideal=True), scans=6)
    cells, shares, first = set(), [], None
    for made in sim.simulate(scene, seed=0):
        azimuth, elevation = angles(made.scan)
        assert azimuth.shape == (rays,)
        assert np.abs(azimuth).max() <= width / 2 + 1e-3
        assert elevation.min() >= low - 1e-3
        assert elevation.max() <= high + 1e-3
        cells |= set(
            zip(
                np.floor(azimuth).astype(int).tolist(),
                np.floor(elevation).astype(int).tolist(),
                strict=True,
            )
        )
        shares.append(len(cells) / (width * (high - low)))
        assert first is None or (first != azimuth).mean() > 0.99
        first = azimuth
    assert shares[0] < shares[-1] or shares[0] > 0.99  # a dense one fills it at once
    assert shares[-1] > 0.9


@pytest.mark.parametrize("name", ["vlp-16", "vls-128", "qt128", "livox-avia"])
def test_a_preset_of_the_detector_knows_what_its_driver_drops(name):
    config = SensorConfig.preset(name)
    assert config.beams == ("auto" if name == "livox-avia" else name)
    assert config.min_range >= max(0.3, SENSORS[name].model.get("range_min", 0))
    if config.beams != "auto":
        kind, elevations, columns = config.beam_table
        assert (kind, len(elevations), columns) == ("rows", *SPATIAL[name][:2])


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (lambda: SensorConfig.preset("utm-30lx"), "expected a 3D LiDAR, got 'utm-30lx'"),
        (lambda: SensorConfig.preset("x"), "expected one of os0-32, .*got 'x'"),
        (lambda: Scanner.load({"preset": "vlp-16"}), "expected one of utm-30lx, .*got 'vlp-16'"),
        (lambda: sim.LidarModel.preset("x"), "expected one of os0-32, .*got 'x'"),
    ],
)
def test_what_is_no_preset_is_refused(call, text):
    with pytest.raises(ConfigError, match=text):
        call()


def test_what_is_given_stands_before_the_preset():
    scanner = Scanner.load({"preset": "tim571", "range_max": 8.0})
    assert (scanner.n_beams, scanner.range_max) == (811, 8.0)


def output_of(*arguments):
    out = CliRunner().invoke(app, [str(one) for one in arguments])
    assert out.exit_code == 0, out.output
    return out.stdout


@pytest.mark.parametrize("model", ["flying", "circles", "scene"])
def test_config_writes_a_file_of_a_preset(model, tmp_path):
    name = "tim571" if model == "circles" else "hdl-64e"
    path = tmp_path / "c.toml"
    output_of("config", "init", "--model", model, "--preset", name, "-o", path)
    read = {"flying": FlyingConfig, "circles": CirclesConfig, "scene": sim.Scene}[model].read(path)
    if model == "flying":
        assert read == FlyingConfig(sensor=SensorConfig.preset(name))
    elif model == "circles":
        assert read.scanner == Scanner.load({"preset": name})
    else:
        assert read.lidar == sim.LidarModel.preset(name)
    shown = output_of("config", "show", "--model", model, "--preset", name, "--changed")
    assert {"flying": "sensor.beams", "circles": "scanner.n_beams", "scene": "lidar.range_max"}[
        model
    ] in shown


@pytest.mark.parametrize("name", BUILT_IN)
def test_config_writes_a_built_in_scene_that_can_be_changed(name, tmp_path):
    path = tmp_path / "scene.toml"
    output_of("config", "init", "--model", "scene", "--preset", name, "-o", path)
    assert sim.Scene.read(path).scans >= 1


@pytest.mark.parametrize("name", PLANAR)
def test_circles_takes_a_file_of_a_preset_for_any_recording(name, tmp_path):
    config, recording = tmp_path / "c.toml", tmp_path / "a.npz"
    output_of("config", "init", "--model", "circles", "--preset", name, "-o", config)
    output_of("simulate", "circles", "-o", recording, "--scans", 2)
    output_of(
        "circles",
        recording,
        "-o",
        tmp_path / "run",
        "--config",
        config,
        "--no-picture",
        "--no-mcap",
    )
    note = tomllib.loads((tmp_path / "run" / "run.toml").read_text())["config"]["circles"]
    (found,) = note["scanners"].values()
    limits = Scanner.load({"preset": name})
    with open_recording(recording) as opened:
        scan = next(one for one in opened if isinstance(one, LaserScan))
    assert found["n_beams"] == len(scan.ranges)
    assert found["range_max"] == min(limits.range_max, scan.range_max)


def test_a_model_without_presets_says_so():
    out = CliRunner().invoke(app, ["config", "show", "--model", "poses", "--preset", "vlp-16"])
    assert isinstance(out.exception, ConfigError)
    assert "poses has no presets; flying, circles and scene have" in str(out.exception)


@pytest.mark.parametrize(("scene", "name"), [("demo", "xt32"), ("circles", "tim551")])
def test_simulate_sees_a_scene_with_another_sensor(scene, name, tmp_path):
    path = tmp_path / "r.npz"
    output_of("simulate", scene, "-o", path, "--sensor", name, "--scans", 1)
    with open_recording(path) as recording:
        scans = [one for one in recording if hasattr(one, "points") or hasattr(one, "ranges")]
    (scan,) = scans
    if name == "xt32":
        assert scan.points.shape == (32, 2000, 3)
    else:
        assert scan.ranges.shape == (271,)


def test_the_page_of_the_guide_has_a_row_per_sensor():
    page = runpy.run_path(str(ROOT / "docs/generate_parameters.py"))["sensors_page"]()
    rows = [line for line in page.splitlines() if line.startswith("| `")]
    assert [line.split("`")[1] for line in rows] == list(SENSORS)
    assert "| `vlp-16` | Velodyne VLP-16 | 16 x 1,800 | -15 to 15 | 360 | 10 | 0.5 to 100 |" in page


@pytest.mark.parametrize("no_return", [0, 65535])
def test_ranges_in_millimetres_are_far_for_any_mark_of_no_return(no_return):
    metres = np.linspace(0.6, 8.0, 720)
    counted = (1000 * metres).astype(np.uint16)
    counted[200:600] = no_return
    assert far_median(counted, LONGEST_2D) == pytest.approx(2000, rel=0.5)
    assert far_median(np.stack([counted, counted * 0, counted * 0], axis=1), LONGEST_3D) is not None


def test_ranges_that_a_sensor_measures_are_not_far():
    longest = {True: LONGEST_2D, False: LONGEST_3D}
    for sensor in SENSORS.values():
        limit = longest[sensor.is_planar]
        assert far_median(np.full(100, sensor.model["range_max"], np.float32), limit) is None
        assert far_median(np.linspace(0, sensor.model["range_max"], 100), limit) is None
    for mark in (np.inf, np.nan, 0.0, 65535.0, 1e9):  # of rays that met nothing
        ranges = np.full(720, mark)
        assert far_median(ranges, LONGEST_2D) is None
        ranges[:100] = 5.0
        assert far_median(ranges, LONGEST_2D) is None
    assert far_median(np.empty(0), LONGEST_2D) is None
    assert far_median(np.empty((0, 3), np.float32), LONGEST_3D) is None
