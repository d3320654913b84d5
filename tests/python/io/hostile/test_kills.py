"""What `make kills` looks for it finds; the kills themselves are in the nightly run."""

import subprocess
import sys

import numpy as np
import pytest
from repository import ROOT

from hostile.kills import contents, left_over, torn, works
from lidar_core.flying.voxel_map import VoxelMap
from lidar_core.io import write_recording
from lidar_core.messages import Scan

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
