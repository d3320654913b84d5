"""`lidar-core simulate`."""

import hashlib
import json
import os
import re
import subprocess
import sys
import tomllib
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from commands import invoke

from lidar_core import ConfigError, sim
from lidar_core.io import open_recording
from lidar_core.io.files.sole import sole_writer
from lidar_core.messages import LaserScan

run_command = partial(invoke, "simulate")


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


def test_the_help_names_the_files_that_are_written(tmp_path):
    out = run_command("demo", "-o", tmp_path / "street.npz", "--scans", 1)
    assert out.exit_code == 0, out.output
    told = " ".join(run_command("--help").output.split())
    names = {path.name for path in tmp_path.iterdir()} - {"street.npz"}
    assert len(names) == 3
    for name in names:
        assert name in told


def test_the_command_refuses_what_it_cannot_write(tmp_path):
    out = run_command("demo", "-o", tmp_path / "x.las")
    assert isinstance(out.exception, ConfigError)
    assert "x.las: unknown suffix '.las'; formats for a recording: .mcap" in str(out.exception)
    assert list(tmp_path.iterdir()) == []
    out = run_command(tmp_path / "none.toml", "-o", tmp_path / "x.npz")
    assert isinstance(out.exception, FileNotFoundError)
    assert "no such scene file; built-in scenes are demo, performance-1" in str(out.exception)
    for option, value in (("--sensor", "vlp-16"), ("--threads", 1)):
        out = run_command("overflight", "-o", tmp_path / "x.csv", option, value)
        assert isinstance(out.exception, ConfigError)
        assert f"{option}: does not apply to overflight" in str(out.exception)
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
        out = run_command(name, "-o", tmp_path / f"{name}.npz", "--scans", 1)
        assert out.exit_code == 0, out.output
        scene = sim.Scene.read(tmp_path / f"{name}.scene.toml")
        assert (len(scene.bodies), len(scene.targets)) == (bodies, 11)


# One writer at a time

CALL = "from lidar_core.cli import main; main()"
POSIX = pytest.mark.skipif(os.name != "posix", reason="locks of files are POSIX")
HOLDS = """
import sys
from pathlib import Path
from lidar_core.io.files.sole import sole_writer
sys.argv = ["lidar-core", "simulate", "demo", "-o", "same.npz", "--seed", "1"]
with sole_writer(Path(sys.stdin.readline().strip())):
    print("held", flush=True)
    sys.stdin.read()
"""


def started(*arguments, **more):
    return subprocess.Popen(
        [sys.executable, "-c", *map(str, arguments)],
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        **more,
    )


def holding(path):
    """Another process that writes to `path` until its input ends."""
    other = started(HOLDS, stdin=subprocess.PIPE)
    other.stdin.write(f"{path}\n")
    other.stdin.flush()
    assert other.stdout.readline() == "held\n"
    return other


def is_of_one_run(folder):
    """Recording, hash, seed, and truth of the seed that the note names."""
    note = tomllib.loads((folder / "same.run.toml").read_text())
    digest = hashlib.sha256((folder / "same.npz").read_bytes()).hexdigest()
    again = sim.recording.record(
        sim.scenes.demo(note["seed"]), folder / "again.npz", seed=note["seed"], scans=note["scans"]
    )
    same = again.truth.read_bytes() == (folder / "same.truth.csv").read_bytes()
    return digest == note["sha256"] and same


@pytest.mark.nightly
@POSIX
def test_two_simulations_into_one_recording_the_second_is_refused_and_names_the_first(tmp_path):
    path = tmp_path / "same.npz"
    other = holding(path)
    try:
        for name in ("same.npz", "same.mcap"):  # their truth is one file
            done = started(CALL, "simulate", "demo", "-o", tmp_path / name, "--scans", 2)
            _, told = done.communicate(timeout=120)
            assert done.returncode == 2, told
            told = " ".join(told.split())
            assert f"process {other.pid} (lidar-core simulate demo -o same.npz --seed 1)" in told
            assert "is writing there; wait until it ends, or choose another output" in told
            assert [file.name for file in tmp_path.iterdir()] == [".same.lock"]
        assert run_command("demo", "-o", tmp_path / "free.npz", "--scans", 1).exit_code == 0
    finally:
        other.communicate()
    assert run_command("demo", "-o", path, "--scans", 1, "--seed", 2).exit_code == 0
    assert not (tmp_path / ".same.lock").exists()
    assert is_of_one_run(tmp_path)


@POSIX
def test_two_simulations_at_once_leave_the_recording_and_truth_of_one_seed(tmp_path):
    both = [
        started(CALL, "simulate", "demo", "-o", tmp_path / "same.npz", "--scans", 6, "--seed", seed)
        for seed in (1, 2)
    ]
    told = [one.communicate(timeout=200)[1] for one in both]
    codes = sorted(one.returncode for one in both)
    assert codes in ([0, 2], [0, 0]), told  # one after the other, if the first was that quick
    assert is_of_one_run(tmp_path)


@POSIX
def test_the_lock_of_a_killed_simulation_holds_nobody_up(tmp_path):
    path = tmp_path / "same.npz"
    other = holding(path)
    other.kill()
    other.wait()
    assert (tmp_path / ".same.lock").read_text().startswith(f"process {other.pid} ")
    assert run_command("demo", "-o", path, "--scans", 1).exit_code == 0
    assert not (tmp_path / ".same.lock").exists()
    other.communicate()


@POSIX
def test_two_threads_do_not_write_one_recording(tmp_path):
    with sole_writer(tmp_path / "same.npz"):
        with pytest.raises(FileExistsError, match="is writing there"):
            sim.recording.record(sim.scenes.demo(0), tmp_path / "same.npz", seed=0, scans=1)
        with sole_writer(tmp_path / "other.npz"):
            pass


@POSIX
def test_a_file_system_without_locks_goes_without(tmp_path, monkeypatch):
    def refuse(*_):
        raise OSError("no locks")

    monkeypatch.setattr("fcntl.flock", refuse)
    with sole_writer(tmp_path / "same.npz"), sole_writer(tmp_path / "same.npz"):
        assert not list(tmp_path.iterdir())
