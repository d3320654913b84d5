"""`lidar-core simulate`."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from lidar_core import ConfigError, sim
from lidar_core.cli import app
from lidar_core.io import open_recording
from lidar_core.messages import LaserScan


def run_command(*arguments):
    return CliRunner().invoke(app, ["simulate", *map(str, arguments)])


def test_the_command_writes_the_same_bytes_again(tmp_path):
    scene = tmp_path / "scene.toml"
    scene.write_text('[lidar]\npreset = "vlp-16"\n[[bodies]]\nshape = {kind = "plane"}\n')
    hashes = set()
    for name in ("a.npz", "b.npz"):
        out = run_command(scene, "-o", tmp_path / name, "--seed", 1, "--scans", 2, "--json", "-")
        assert out.exit_code == 0, out.output
        done = json.loads(out.stdout)
        assert done["scans"] == 2
        assert done["points"] > 1000
        hashes.add(re.search(r'sha256 = "(\w{64})"', Path(done["run"]).read_text())[1])
    assert len(hashes) == 1
    out = run_command("performance-2", "-o", tmp_path / "c.npz", "--scans", 1)
    assert out.exit_code == 0
    assert "1 scans, 98633 points" in out.output


def test_the_command_refuses_what_it_cannot_write(tmp_path):
    out = run_command("demo", "-o", tmp_path / "x.las")
    assert isinstance(out.exception, ConfigError)
    assert "x.las: unknown ending '.las'; writable are: .npz, .mcap" in str(out.exception)
    assert list(tmp_path.iterdir()) == []
    out = run_command(tmp_path / "none.toml", "-o", tmp_path / "x.npz")
    assert isinstance(out.exception, FileNotFoundError)
    assert "no such scene file; built-in scenes are demo, performance-1" in str(out.exception)
    for option, value in (("--sensor", "vlp-16"), ("--threads", 1)):
        out = run_command("overflight", "-o", tmp_path / "x.csv", option, value)
        assert isinstance(out.exception, ConfigError)
        assert f"{option}: says nothing about overflight" in str(out.exception)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("suffix", [".npz", ".mcap"])
def test_planar_scenes_become_recordings_of_2d_scans(tmp_path, suffix):
    path = tmp_path / f"lab{suffix}"
    out = run_command("circles-lab", "-o", path, "--seed", 2, "--scans", 3)
    assert out.exit_code == 0, out.output
    made = list(sim.sweeps(sim.circle_scenes.lab(2), seed=2, scans=3))
    with open_recording(path) as recording:
        scans = [message for message in recording if isinstance(message, LaserScan)]
    assert [scan.stamp_ns for scan in scans] == [one.scan.stamp_ns for one in made]
    for scan, one in zip(scans, made, strict=True):
        np.testing.assert_array_equal(scan.ranges, one.scan.ranges)
        assert abs(scan.time_increment_ns - one.scan.time_increment_ns) <= 1
    rows = np.genfromtxt(
        path.with_suffix(".truth.csv"), delimiter=",", names=True, dtype=None, encoding="utf-8"
    )
    assert rows["kind"].tolist() == ["person", "barrel"] * 3
    np.testing.assert_array_equal(rows["x"].reshape(3, 2), [m.truth.center[:, 0] for m in made])
    np.testing.assert_array_equal(rows["hits"].reshape(3, 2), [m.truth.hits for m in made])


def test_built_in_scenes_of_posts(tmp_path):
    for name, bodies in (("circles", 0), ("circles-room", 4)):
        out = run_command(name, "-o", tmp_path / "a.npz", "--scans", 1)
        assert out.exit_code == 0, out.output
        scene = sim.Scene.read(tmp_path / "a.scene.toml")
        assert (len(scene.bodies), len(scene.targets)) == (bodies, 11)
