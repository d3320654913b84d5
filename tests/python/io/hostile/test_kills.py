"""What `make kills` looks for it finds; the kills themselves are in the nightly run."""

import subprocess
import sys
import time
from collections import Counter

import numpy as np
import pytest
from repository import ROOT

from hostile.commands import run
from hostile.kills import Tally, Work, contents, fault, left_over, torn, works
from lidar_core.flying.voxel_map import VoxelMap
from lidar_core.io import write_recording
from lidar_core.messages import Scan
from lidar_core.run_folder import RunFolder
from lidar_core.viz.figure import figure_with_style

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="SIGKILL")


@pytest.fixture
def output(tmp_path):
    """Files as commands leave them."""
    place = tmp_path / "run"
    place.mkdir()
    write_recording(place / "scans.npz", [Scan(0, np.ones((50, 3), np.float32))])
    VoxelMap().save(place / "map.lcvm")
    (place / "summary.json").write_text('{"scans": 3}')
    (place / "run.toml").write_text("a = 1\n")
    return place


@pytest.mark.parametrize("name", ["scans.npz", "map.lcvm", "summary.json", "run.toml"])
def test_a_file_that_was_cut_is_torn(output, name):
    assert torn(output) == []
    path = output / name
    path.write_bytes(path.read_bytes()[:-3])
    (told,) = torn(output)
    assert told.startswith(f"{name}: ")


def test_temporary_files_are_left_over_and_no_results(output):
    before = contents(output)
    assert set(before) == {"run/scans.npz", "run/map.lcvm"}
    (output / ".map.lcvm.123.tmp").write_bytes(b"cut")
    assert left_over(output) == [".map.lcvm.123.tmp"]
    assert torn(output) == []
    assert contents(output) == before
    (output / "map.lcvm").write_bytes(b"other")
    assert contents(output) != before


def table(path):
    folder = RunFolder(path.parent, overwrite=False)
    folder.write_table(path.stem, {"x": np.arange(50)})


def picture(path):
    with figure_with_style(size=(1, 1), dpi=30) as figure:
        figure.savefig(path, format="png")


RICH = {
    "a.mcap": lambda path: write_recording(path, [Scan(0, np.ones((50, 3), np.float32))]),
    "a.parquet": table,
    "a.png": picture,
    "a.html": lambda path: path.write_text(f"<!doctype html><html>{100 * 'a'}</html>"),
}
"""What writes files that need an extra, or are for people."""


@pytest.mark.parametrize("name", RICH)
def test_pages_pictures_and_tables_that_were_cut_are_torn(tmp_path, name):
    for package in ("matplotlib", "pyarrow", "foxglove", "mcap"):
        pytest.importorskip(package)
    place = tmp_path / "run"
    place.mkdir()
    RICH[name](place / name)
    assert torn(place) == []
    whole = (place / name).read_bytes()
    for length in (0, len(whole) // 2, len(whole) - 4):
        (place / name).write_bytes(whole[:length])
        assert [one.split(":")[0] for one in torn(place)] == [name], length


def test_kills_without_a_checkpoint_prove_nothing():
    def tally(checkpoints, **ended):
        return Tally(Counter(ended), checkpoints, is_resumed=True)

    plain = Tally(Counter(killed=3))
    assert fault({"a": plain, "b": tally(1, killed=2)}, 5) is None
    assert fault({"a": plain, "b": tally(0, killed=2)}, 5) == "no kill fell on a checkpoint"
    assert fault({"a": plain}, 3) is None  # of commands without checkpoints
    assert (
        fault({"a": plain, "b": tally(1, killed=2)}, 6) == "fewer than 6 commands could be killed"
    )
    assert fault({"a": plain, "b": tally(1, killed=2, torn=1)}, 5) == "1 ended badly"
    assert "on a checkpoint 1" in str(tally(1, killed=2))
    ended = {"killed": 2, "was faster": 5, "torn": 1}
    assert tally(1, **ended).outcomes == {"ok": 2, "torn": 1}  # for the page of evidence


def writing(folder, arguments):
    (folder / "met").write_text("a")
    time.sleep(60)


def doing_nothing(folder, arguments):
    pass


def test_a_kill_waits_for_a_file(tmp_path):
    """What makes kills fall on checkpoints."""
    assert run(tmp_path, (), wait=0.0, after=tmp_path / "met", work=writing) == -9
    assert (tmp_path / "met").exists()
    assert run(tmp_path, (), wait=5.0, after=tmp_path / "never", work=doing_nothing) == 0
    assert Work((), "a", ("--resume",)).is_resumed
    assert not Work((), "a").is_resumed


def test_processes_of_commands_say_how_they_ended(tmp_path):
    assert run(tmp_path, ("info", "missing.npz")) == 2
    assert "missing.npz" in (tmp_path / "stderr").read_text()
    assert run(tmp_path, ("config", "show", "--model", "read")) == 0
    assert (tmp_path / "stderr").read_text() == ""


@pytest.mark.nightly
def test_killed_commands_leave_nothing_torn():
    done = subprocess.run(
        [sys.executable, "-m", "hostile.kills", "--count", str(2 * len(works(1)))],
        env={"PATH": "", "PYTHONPATH": f"{ROOT / 'tests'}:{ROOT / 'tests/python/helpers'}"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
