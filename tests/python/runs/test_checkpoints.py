"""Runs that were killed go on, and end as if nothing had happened."""

import json
import os
import random
import signal
import subprocess
import time
from pathlib import Path

import numpy as np
import pytest
from commands import command_line, invoke
from flying_scenes import drone, yard

from lidar_core import ConfigError, FormatError, InputError, runs, sim
from lidar_core.io import PoseOptions, write_recording
from lidar_core.messages import LaserScan
from lidar_core.run_folder import CHECKPOINT, UNFINISHED
from lidar_core.runs.scans.circles_output import CirclesRun
from lidar_core.util.packed import packed, unpacked

pytestmark = pytest.mark.skipif(os.name != "posix", reason="SIGKILL")
QUIET = ("--no-picture", "--pose", "static")
TIMES = ("timing.parquet", "timing.csv", "run.toml", "summary.json")
"""Files that hold times of the computer, or the command."""


@pytest.fixture(scope="module")
def sweeps(tmp_path_factory):
    """A recording of a 2D scanner between things that stand."""
    path = tmp_path_factory.mktemp("sweeps") / "sweeps.npz"
    angles = np.linspace(-np.pi, np.pi, 360)
    ranges = (4.0 + np.sin(7 * angles)).astype(np.float32)
    noise = np.random.default_rng(0)
    write_recording(
        path,
        (
            LaserScan(
                n * 10**8,
                ranges + 0.01 * noise.standard_normal(360).astype(np.float32),
                -np.pi,
                2 * np.pi / 359,
                0.1,
                30.0,
            )
            for n in range(150)
        ),
    )
    return path


@pytest.fixture(scope="module")
def flight(tmp_path_factory):
    """A drone in a yard."""
    path = tmp_path_factory.mktemp("flight") / "yard.npz"
    sim.record(yard(drone((6.0, 4.0, 3.5), (5.0, 6.0, 4.0)), scans=16), path, seed=0)
    return path


@pytest.fixture(scope="module")
def radar_table(tmp_path_factory):
    """Detections of two targets by two sensors, in a table."""
    path, noise = tmp_path_factory.mktemp("table") / "seen.csv", np.random.default_rng(1)
    rows = ["t_ns,sensor,x,y"]
    for step in range(600):
        for side in (-1.0, 1.0):
            x, y = np.array([0.02 * step, 6.0 * side]) + 0.05 * noise.standard_normal(2)
            rows.append(f"{step * 50_000_000},lidar,{x},{y}")
    path.write_text("\n".join(rows) + "\n")
    return path


def results(folder):
    """Contents of all files but those with times, and the summary without them."""
    files = {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.name not in TIMES
    }
    summary = json.loads((folder / "summary.json").read_text())
    summary.pop("ms_per_scan", None)
    summary.pop("us_per_scan", None)
    return files, summary


def whole(command, recording, folder):
    done = invoke(command, recording, "-o", folder, "--no-picture", "--no-mcap", *poses(command))
    assert done.exit_code == 0, done.exception
    return results(folder)


def poses(command):
    return {
        "circles": ("--pose", "static"),
        "detect": ("--threads", 1),
        "fuse": ("--association", "integrated"),
    }[command]


def killed(command, recording, folder, delay, *options):
    """A run that is killed `delay` seconds after its first checkpoint; False if it was faster."""
    told = command_line(command, recording, "-o", folder, "--no-picture", *poses(command), *options)
    with subprocess.Popen(told, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE) as process:
        while not (folder / CHECKPOINT).exists() and process.poll() is None:
            time.sleep(0.001)
        time.sleep(delay)
        process.send_signal(signal.SIGKILL)
        told = process.communicate()[1].decode()
    assert process.returncode in (0, -signal.SIGKILL), told
    return process.returncode != 0


@pytest.mark.parametrize("command", ["detect", "circles", "fuse"])
def test_a_run_that_was_killed_goes_on_to_the_same_results(
    command, flight, sweeps, radar_table, tmp_path
):
    recording = {"detect": flight, "circles": sweeps, "fuse": radar_table}[command]
    expected = whole(command, recording, tmp_path / "whole")
    folder, chance, n_killed = tmp_path / "run", random.Random(0), 0
    for attempt in range(3):
        options = ("--checkpoint", 0.001, *(("--resume",) if attempt else ()))
        n_killed += killed(command, recording, folder, 0.2 * chance.random(), *options)
        if not (folder / CHECKPOINT).exists():
            break
        assert (folder / UNFINISHED).exists()
    assert n_killed
    if (folder / CHECKPOINT).exists():
        done = invoke(command, recording, "-o", folder, "--no-picture", "--resume", *poses(command))
        assert done.exit_code == 0, done.exception
    assert results(folder) == expected


def cut_short(recording, folder, scans, **options):
    """A run in this process that is cut off after some scans, as by a kill."""

    class Killed(BaseException):
        pass

    def on_progress(_what, done, _total):
        if done == scans:
            raise Killed

    with pytest.raises(Killed):
        runs.circles(
            recording,
            None,
            folder,
            pose=STATIC,
            picture=False,
            checkpoint=1e-6,
            on_progress=on_progress,
            **options,
        )


STATIC = PoseOptions(pose="static")


@pytest.mark.nightly
@pytest.mark.parametrize("scans", [1, 2, 149])
def test_it_goes_on_from_any_scan(sweeps, tmp_path, scans):
    expected = whole("circles", sweeps, tmp_path / "whole")
    folder = tmp_path / "run"
    cut_short(sweeps, folder, scans)
    taken = []
    result = runs.circles(
        sweeps, None, folder, pose=STATIC, picture=False, resume=True, on_progress=spy(taken)
    )
    assert result.ended_by is None
    assert results(folder) == expected
    assert not list(folder.glob(".*"))
    assert not (folder / CHECKPOINT).exists()


def spy(taken):
    return lambda *values: taken.append(values)


def test_what_it_has_done_is_not_done_again(sweeps, tmp_path, monkeypatch):
    cut_short(sweeps, tmp_path / "run", 100)
    count, take = [], CirclesRun.take
    monkeypatch.setattr(CirclesRun, "take", lambda run, item: (count.append(1), take(run, item)))
    runs.circles(sweeps, None, tmp_path / "run", pose=STATIC, picture=False, resume=True)
    assert len(count) == 50


@pytest.mark.parametrize(
    ("what", "change"),
    [
        ("recording", {"recording": True}),
        (r"circles \(map\.merge_gap was \S+, now 0\.3\)", {"config": ["map.merge_gap=0.3"]}),
        (r"pose \(end was none, now 5\.0\)", {"pose": PoseOptions(pose="static", end=5.0)}),
    ],
)
def test_another_recording_or_configuration_is_refused(sweeps, tmp_path, what, change):
    folder = tmp_path / "run"
    cut_short(sweeps, folder, 20)
    before = results_of_checkpoint(folder)
    recording = sweeps
    if "recording" in change:
        recording = tmp_path / "other.npz"
        row = np.full(360, 4.0, np.float32)
        others = (LaserScan(n * 10**8, row, -np.pi, 0.0175, 0.1, 30.0) for n in range(150))
        write_recording(recording, others)
    choice = runs.ConfigChoice("best", None, tuple(change.get("config", ())))
    with pytest.raises(InputError, match=f"of a run with another {what}"):
        runs.circles(
            recording,
            choice,
            folder,
            pose=change.get("pose", STATIC),
            picture=False,
            resume=True,
        )
    assert results_of_checkpoint(folder) == before


def test_another_command_neither_goes_on_nor_destroys(sweeps, flight, radar_table, tmp_path):
    """Also where its results are of other classes, and where it writes no checkpoints itself."""
    folder = tmp_path / "run"
    cut_short(sweeps, folder, 20)
    before = results_of_checkpoint(folder)
    with pytest.raises(InputError, match="of a run with another"):
        runs.detect(flight, None, folder, picture=False, mcap=False, resume=True)
    one_target = tmp_path / "one.csv"
    head, *rows = radar_table.read_text().splitlines()
    one_target.write_text("\n".join([head, *rows[::2]]) + "\n")
    for table, association in ((radar_table, "integrated"), (one_target, None)):
        with pytest.raises(InputError, match=r"run.checkpoint: it is of .*overwrite=True"):
            runs.fuse(table, None, folder, association=association, resume=True)
    assert results_of_checkpoint(folder) == before


def results_of_checkpoint(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_another_build_is_refused(sweeps, tmp_path, monkeypatch):
    cut_short(sweeps, tmp_path / "run", 3)
    monkeypatch.setattr("lidar_core.runs.checkpoints.build_digest", lambda: "f" * 64)
    with pytest.raises(InputError, match="another build"):
        runs.circles(sweeps, None, tmp_path / "run", pose=STATIC, picture=False, resume=True)


def test_the_same_recording_in_another_place_is_the_same(sweeps, tmp_path):
    expected = whole("circles", sweeps, tmp_path / "whole")
    cut_short(sweeps, tmp_path / "run", 30)
    moved = tmp_path / sweeps.name
    moved.write_bytes(sweeps.read_bytes())
    runs.circles(moved, None, tmp_path / "run", pose=STATIC, picture=False, resume=True)
    files, summary = results(tmp_path / "run")
    assert files == expected[0]
    assert summary | {"recording": ""} == expected[1] | {"recording": ""}


def test_every_byte_of_a_checkpoint_is_checked(sweeps, tmp_path):
    folder = tmp_path / "run"
    cut_short(sweeps, folder, 3)
    for path in (folder / CHECKPOINT, folder / ".checkpoint-0"):
        content = path.read_bytes()
        step = max(1, len(content) // 6)
        for place in range(0, len(content), step):
            damaged = bytearray(content)
            damaged[place] ^= 0x40
            for broken in (bytes(damaged), content[:place]):
                path.write_bytes(broken)
                with pytest.raises(FormatError):
                    runs.circles(sweeps, None, folder, pose=STATIC, picture=False, resume=True)
        path.write_bytes(content)
    other = folder / ".checkpoint-1"
    other.write_bytes((folder / ".checkpoint-0").read_bytes())
    with pytest.raises(FormatError, match="not the part"):
        runs.circles(sweeps, None, folder, pose=STATIC, picture=False, resume=True)


def test_overwriting_removes_the_checkpoint_and_a_complete_run_is_not_resumed(sweeps, tmp_path):
    folder = tmp_path / "run"
    cut_short(sweeps, folder, 3)
    with pytest.raises(FileExistsError, match="overwrite=True replaces it, resume=True goes on"):
        runs.circles(sweeps, None, folder, pose=STATIC, picture=False)
    runs.circles(sweeps, None, folder, pose=STATIC, picture=False, mcap=False, overwrite=True)
    assert not [path for path in folder.iterdir() if "checkpoint" in path.name]
    with pytest.raises(FileExistsError, match="complete run"):
        runs.circles(sweeps, None, folder, pose=STATIC, picture=False, resume=True)


def test_options_that_contradict_each_other_are_refused(sweeps, tmp_path):
    for options in ({"mcap": True, "checkpoint": 1.0}, {"overwrite": True, "resume": True}):
        with pytest.raises(ConfigError):
            runs.circles(sweeps, None, tmp_path / "run", pose=STATIC, **options)
    assert not (tmp_path / "run").exists()


def test_packed_values_come_back_to_the_bit():
    value = {
        "a": [1, 2.5, None, "x", b"\x00\xff"],
        ("t", 1): np.array([[1.0, np.nan]]),
        "n": np.float32(3),
    }
    again = unpacked(packed(value))
    assert repr(again) == repr(value)
    with pytest.raises(TypeError):
        packed(Path("x"))
    content = packed([1, np.arange(3.0)])
    for length in range(len(content)):
        with pytest.raises(FormatError):
            unpacked(content[:length])
