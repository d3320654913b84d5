"""Pipes, devices, folders and missing files where a command expects a file: refused, and soon."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from lidar_core import VoxelMap
from lidar_core.cli import app
from lidar_core.errors import FormatError, LidarCoreError, MissingExtraError
from lidar_core.files import check_regular, read_whole
from lidar_core.io import open_recording, read_cloud, read_columns, write_recording
from lidar_core.io.poses.pose_files import read_poses
from lidar_core.messages import LaserScan, Scan

pytestmark = pytest.mark.skipif(os.name != "posix", reason="pipes and devices in the file system")

LONGEST_S = 20
KINDS = ("pipe", "device", "folder", "missing")
OPENED = "{X}"
"""Where the place that is no regular file stands in a command."""
COMMANDS = {
    "info": f"info {OPENED}",
    "info --metadata": f"info cloud.npz --metadata {OPENED}",
    "convert": f"convert {OPENED} out.mcap",
    "simulate": f"simulate {OPENED} -o out.npz",
    "detect": f"detect {OPENED} -o out --pose static",
    "detect --config": f"detect cloud.npz -o out --pose static --config {OPENED}",
    "detect --map": f"detect cloud.npz -o out --pose static --map {OPENED}",
    "detect --pose": f"detect cloud.npz -o out --pose {OPENED}",
    "circles": f"circles {OPENED} -o out --pose static",
    "circles --config": f"circles sweep.npz -o out --pose static --config {OPENED}",
    "circles --pose": f"circles sweep.npz -o out --pose {OPENED}",
    "fuse": f"fuse {OPENED} -o out",
    "fuse --config": f"fuse table.csv -o out --config {OPENED}",
    "evaluate": f"evaluate {OPENED} table.csv",
    "evaluate, truth": f"evaluate table.csv {OPENED}",
    "export": f"export {OPENED} out.onnx",
    "view": f"view {OPENED} --png out.png",
    "report": f"report {OPENED} -o out.html",
    "batch": f"batch {OPENED} -o out",
    "events": f"events all {OPENED}",
    "live --replay": f"live --replay {OPENED} -o out --pose static",
    "live --config": f"live --replay cloud.npz -o out --pose static --config {OPENED}",
    "live --map": f"live --replay cloud.npz -o out --pose static --map {OPENED}",
    "config show": f"config show {OPENED}",
    "train circles": f"train circles -c {OPENED} -o out",
}
ENDINGS = (
    ".csv",
    ".npz",
    ".bag",
    ".db3",
    ".mcap",
    ".pcd",
    ".las",
    ".clf",
    ".pcap",
    ".osf",
    ".txt",
    ".parquet",
    ".json",
    ".db3.zstd",
)
WRITING = {
    "convert": f"convert cloud.npz {OPENED}",
    "simulate": f"simulate circles --scans 2 -o {OPENED}",
    "info --json": f"detect cloud.npz -o out --pose static --json {OPENED}",
    "config init": f"config init --overwrite -o {OPENED}",
}


@pytest.fixture(autouse=True)
def _ends_soon():
    """End a test that waits for a pipe or reads a device for ever."""

    def too_late(*_):
        raise TimeoutError(f"not refused within {LONGEST_S} s")

    before = signal.signal(signal.SIGALRM, too_late)
    signal.alarm(LONGEST_S)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


@pytest.fixture
def place(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    points = np.ones((4, 3), np.float32)
    write_recording(tmp_path / "cloud.npz", [Scan(1, points, "lidar", topic="/points")])
    sweep = LaserScan(1, np.ones(9, np.float32), 0.0, 0.1, 0.0, 9.0)
    write_recording(tmp_path / "sweep.npz", [sweep])
    (tmp_path / "table.csv").write_text("t_ns,track_id,x,y,z\n1,1,0,0,0\n")
    return tmp_path


def special(place, kind, ending=""):
    path = place / f"special{ending}"
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "device":
        path.symlink_to("/dev/zero")
    elif kind == "folder":
        path.mkdir()
    return path


def run(command, path):
    """End of a command in this process: status 0, or the error that `main` prints in a line."""
    words = [word.replace(OPENED, str(path)) for word in command.split()]
    return CliRunner().invoke(app, words)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_refuses_what_is_no_regular_file(place, name, kind):
    done = run(COMMANDS[name], special(place, kind))
    error = done.exception
    if name in ("export", "train circles") and isinstance(error, MissingExtraError):
        return  # torch comes first; Config.read, which train uses, is tested with `simulate`
    assert isinstance(error, LidarCoreError | OSError), (done.output, error)
    assert "special" in str(error), error
    assert "\n" not in str(error)
    assert not list(place.glob("out*")), list(place.iterdir())


@pytest.fixture(scope="module")
def small_run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("report")
    rows = "".join(f"{100_000_000 * k},{k},0,0\n" for k in range(20))
    (folder / "track.csv").write_text("t_ns,x,y,z\n" + rows)
    made = ["fuse", str(folder / "track.csv"), "-o", str(folder / "run"), "--force"]
    done = CliRunner().invoke(app, made)
    assert done.exit_code == 0, (done.output, done.exception)
    return folder / "run"


@pytest.mark.parametrize("kind", KINDS)
def test_a_report_refuses_a_truth_that_is_no_regular_file(place, small_run, kind):
    path = special(place, kind, ".csv")
    done = run(f"report {small_run} -o page.html --truth {OPENED}", path)
    assert isinstance(done.exception, LidarCoreError | OSError), (done.output, done.exception)
    assert "special" in str(done.exception)
    assert not (place / "page.html").exists()


@pytest.mark.ci_cases("pipe-*", "device-.pcd", "device-.json", "folder-.mcap", "folder-.json")
@pytest.mark.parametrize("ending", ENDINGS)
@pytest.mark.parametrize("kind", ["pipe", "device", "folder"])
def test_the_ending_of_its_name_makes_no_difference(place, ending, kind):
    path = special(place, kind, ending)
    for command in ("info {X}", "fuse {X} -o out", "evaluate {X} table.csv"):
        done = run(command, path)
        assert isinstance(done.exception, LidarCoreError | OSError), (command, done.exception)
        assert "\n" not in str(done.exception)


@pytest.mark.parametrize("kind", ["pipe", "device"])
@pytest.mark.parametrize("name", WRITING)
def test_no_command_takes_the_place_of_a_pipe_or_a_device(place, name, kind):
    path = special(place, kind, ".npz")
    done = run(WRITING[name], path)
    assert isinstance(done.exception, LidarCoreError | OSError), (done.output, done.exception)
    assert "special" in str(done.exception)
    assert path.is_fifo() if kind == "pipe" else path.is_symlink()


@pytest.mark.parametrize("kind", ["pipe", "device"])
@pytest.mark.parametrize(
    ("opener", "ending"),
    [
        (VoxelMap.load, ".lcvm"),
        (open_recording, ".npz"),
        (read_cloud, ".lcvm"),
        (read_cloud, ".bt"),
        (read_columns, ".csv"),
        (read_poses, ".txt"),
        (check_regular, ""),
        (read_whole, ""),
    ],
)
def test_every_function_that_opens_a_path_refuses_it(place, opener, ending, kind):
    path = special(place, kind, ending)
    with pytest.raises(FormatError, match=r"special.*: expected a regular file, got a"):
        opener(path)


def test_a_map_is_not_saved_over_a_pipe(place):
    path = special(place, "pipe")
    with pytest.raises(FormatError, match="expected a regular file"):
        VoxelMap().save(path)
    assert path.is_fifo()
    assert sorted(one.name for one in place.iterdir() if one.name.startswith(".")) == []


@pytest.mark.parametrize("kind", ["pipe", "device"])
def test_the_command_says_so_in_a_line(place, kind):
    path = special(place, kind, ".csv")
    done = subprocess.run(
        [sys.executable, "-m", "lidar_core", "fuse", str(path), "-o", "out"],
        capture_output=True,
        text=True,
        timeout=20,
        check=False,
    )
    assert done.returncode == 2
    told = f"expected a regular file, got a {kind}; save its data to a file first"
    assert done.stderr == f"error: {path}: {told}\n"


def test_the_commands_that_open_files_are_all_here():
    """A command with a path that is not walked over above must write only."""
    from typer.main import get_command

    walked = {text.split()[0] for text in COMMANDS.values()}
    assert set(vars(get_command(app))["commands"]) - walked == {"demo", "doctor", "reproduce"}


def test_a_file_is_read_up_to_its_limit(tmp_path):
    path = Path(tmp_path / "a")
    path.write_bytes(b"12345")
    assert read_whole(path, limit=5) == b"12345"
    with pytest.raises(LidarCoreError, match="more than 4 bytes"):
        read_whole(path, limit=4)
