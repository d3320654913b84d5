"""Places to write to: folders without permission, folders that another run is writing to."""

import json
import os
import subprocess
import sys

import pytest
from typer.testing import CliRunner

from lidar_core import ConfigError
from lidar_core.batch import BatchConfig
from lidar_core.cli import app
from lidar_core.io.files.atomic import check_place
from lidar_core.run_folder import RunFolder, lock, unlock

HOLDS = """
import sys
from pathlib import Path
from lidar_core.run_folder import RunFolder
RunFolder(Path(sys.argv[1]), overwrite=True).begin()
print("held", flush=True)
sys.stdin.read()
"""


@pytest.fixture(scope="module")
def drone(tmp_path_factory):
    path = tmp_path_factory.mktemp("drone") / "drone.csv"
    done = CliRunner().invoke(app, ["simulate", "overflight", "-o", str(path), "--scans", "20"])
    assert done.exit_code == 0, done.output
    return path


def fuse(drone, folder, *more):
    arguments = ["fuse", drone, "-o", folder, "--no-picture", "--no-mcap", *more]
    return CliRunner().invoke(app, [str(one) for one in arguments])


@pytest.fixture
def closed(tmp_path, monkeypatch):
    """A folder without permission, for root as for others."""
    folder = tmp_path / "closed"
    folder.mkdir()
    access = os.access
    monkeypatch.setattr(
        os, "access", lambda path, mode: str(path) != str(folder) and access(path, mode)
    )
    return folder


@pytest.mark.parametrize(
    "arguments",
    [
        ["simulate", "circles", "--scans", "2", "-o", "{}/a.npz"],
        ["simulate", "circles", "--scans", "2", "-o", "{}/a.mcap"],
        ["simulate", "circles", "--scans", "2", "-o", "{}/a.bag"],
        ["simulate", "circles", "--scans", "2", "-o", "{}/a"],
        ["fuse", "{drone}", "-o", "{other}/run", "--json", "{}/a.json"],
    ],
)
def test_a_folder_without_permission_is_named(arguments, closed, drone, tmp_path):
    text = [one.format(closed, drone=drone, other=tmp_path) for one in arguments]
    done = CliRunner().invoke(app, text)
    assert isinstance(done.exception, PermissionError)
    assert str(done.exception).startswith(f"{closed}: no permission to write a")
    assert not (tmp_path / "run").exists()
    assert not list(closed.iterdir())


def test_the_folder_of_a_json_file_is_made(drone, tmp_path):
    file = tmp_path / "new" / "told.json"
    assert fuse(drone, tmp_path / "run", "--json", file).exit_code == 0
    assert json.loads(file.read_text())["command"] == "fuse"
    (tmp_path / "folder").mkdir()
    refused = fuse(drone, tmp_path / "run2", "--json", tmp_path / "folder")
    assert isinstance(refused.exception, IsADirectoryError)
    assert not (tmp_path / "run2").exists()


@pytest.mark.skipif(os.name != "posix", reason="locks of folders are POSIX")
def test_two_runs_do_not_write_to_one_folder(drone, tmp_path):
    folder = tmp_path / "run"
    assert fuse(drone, folder).exit_code == 0
    before = {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}
    program = [sys.executable, "-c", HOLDS]
    with subprocess.Popen(
        [*program, str(tmp_path / "other")], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as other:
        assert other.stdout.readline() == b"held\n"
        assert fuse(drone, folder, "--overwrite").exit_code == 0  # another folder is free
        refused = fuse(drone, tmp_path / "other")
        assert isinstance(refused.exception, FileExistsError)
        assert str(refused.exception) == (
            f"{tmp_path / 'other'}: another run is being written there"
        )
        other.stdin.close()
    cut = fuse(drone, tmp_path / "other")  # the other one ended without finishing its run
    assert str(cut.exception).endswith("did not come to its end; --overwrite replaces it")
    assert fuse(drone, tmp_path / "other", "--overwrite").exit_code == 0
    assert {path.name for path in folder.iterdir() if path.is_file()} == set(before)


@pytest.mark.skipif(os.name != "posix", reason="locks of folders are POSIX")
def test_two_batches_do_not_write_to_one_folder(tmp_path):
    jobs = tmp_path / "jobs.toml"
    jobs.write_text(
        '[[jobs]]\nname = "a"\ncommands = ["simulate circles -o {output}/a.npz --scans 2"]\n'
    )
    arguments = ["batch", str(jobs), "-o", str(tmp_path / "b"), "--workers", "1"]
    with subprocess.Popen(
        [sys.executable, "-c", HOLDS, str(tmp_path / "b")],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    ) as other:
        assert other.stdout.readline() == b"held\n"
        refused = CliRunner().invoke(app, arguments)
        assert isinstance(refused.exception, FileExistsError)
        other.stdin.close()
    done = CliRunner().invoke(app, arguments)
    assert done.exit_code == 0, done.output
    assert (tmp_path / "b" / "results.parquet").exists()


def test_one_process_may_begin_a_folder_again(tmp_path):
    first = RunFolder(tmp_path / "run", overwrite=True)
    first.begin()
    first.begin()
    unlock(tmp_path / "run")
    unlock(tmp_path / "run")


@pytest.mark.skipif(os.name != "posix", reason="locks of folders are POSIX")
def test_a_file_system_without_locks_goes_without(tmp_path, monkeypatch):
    def refuse(held, how):
        raise OSError("no locks")

    monkeypatch.setattr("fcntl.flock", refuse)
    lock(tmp_path)


def test_a_place_is_checked(tmp_path):
    check_place(tmp_path / "a")
    with pytest.raises(IsADirectoryError):
        check_place(tmp_path)


def test_a_table_where_a_list_is_expected_is_told_how_to_write_it():
    with pytest.raises(ConfigError, match=r"^jobs: expected a list, its tables as \[\[jobs\]\], g"):
        BatchConfig.load({"jobs": {"a": {"commands": ["info x"]}}})
    with pytest.raises(ConfigError, match=r"^jobs\.0\.rows\b.* its tables as \[\[jobs\.rows\]\]"):
        BatchConfig.load({"jobs": [{"name": "a", "commands": ["info x"], "rows": {"a": 1}}]})
    with pytest.raises(ConfigError, match=r"^jobs: expected a list, got 3$"):
        BatchConfig.load({"jobs": 3})
    with pytest.raises(ConfigError, match=r"^jobs\.0\.name: has to be given$"):
        BatchConfig.load({"jobs": [{"commands": ["info x"]}]})
