"""Commands replace recordings, truth and maps only with --overwrite."""

import numpy as np
import pytest
from commands import invoke

from lidar_core.io import write_cloud, write_recording
from lidar_core.messages import Scan

KEPT = b"of somebody"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A recording, a map and a run."""
    place = tmp_path_factory.mktemp("overwrite")
    scan = Scan(1, np.ones((4, 3), np.float32), "lidar", topic="/points")
    write_recording(place / "cloud.npz", [scan])
    write_cloud(place / "cloud.ply", scan.points)
    rows = "".join(f"{100_000_000 * k},{k},0,0\n" for k in range(20))
    (place / "track.csv").write_text("t_ns,x,y,z\n" + rows)
    done = invoke("fuse", place / "track.csv", "-o", place / "run", "--force", "--no-picture")
    assert done.exit_code == 0, done.output
    return place


@pytest.mark.parametrize(
    ("command", "name"),
    [
        ("simulate circles --scans 1 -o {}", "a.npz"),
        ("simulate overflight --scans 20 -o {}", "a.csv"),
        ("convert cloud.npz {}", "a.mcap"),
        ("convert cloud.ply {}", "a.pcd"),
        ("convert run {}", "a.json"),
    ],
)
def test_a_file_is_replaced_only_on_request(folder, tmp_path, monkeypatch, command, name):
    monkeypatch.chdir(folder)
    path = tmp_path / name
    path.write_bytes(KEPT)
    words = command.format(path).split()
    refused = invoke(*words)
    assert str(refused.exception) == f"{path}: exists; --overwrite replaces it"
    assert path.read_bytes() == KEPT
    assert list(tmp_path.iterdir()) == [path]
    assert invoke(*words, "--overwrite").exit_code == 0
    assert path.read_bytes() != KEPT


def test_pictures_and_reports_are_drawn_again_and_a_report_replaces_nothing_else(folder, tmp_path):
    for _ in range(2):
        assert invoke("report", folder / "run").exit_code == 0
        assert invoke("view", folder / "run", "--png", tmp_path / "a.png").exit_code == 0
    other = tmp_path / "notes.html"
    other.write_bytes(KEPT)
    refused = invoke("report", folder / "run", "-o", other)
    assert str(refused.exception) == f"{other}: exists and is no report; name another file"
    assert other.read_bytes() == KEPT


def test_the_truth_of_a_simulation_stays_that_of_its_recording(tmp_path):
    made = ["simulate", "circles", "--scans", 1, "-o"]
    assert invoke(*made, tmp_path / "a.npz").exit_code == 0
    truth = (tmp_path / "a.truth.csv").read_bytes()
    files = sorted(tmp_path.iterdir())
    refused = invoke(*made, tmp_path / "a.mcap", "--seed", 1)  # its truth has the same name
    assert str(refused.exception) == (
        f"{tmp_path / 'a.truth.csv'}: exists; --overwrite replaces it"
    )
    assert sorted(tmp_path.iterdir()) == files
    assert (tmp_path / "a.truth.csv").read_bytes() == truth
    assert invoke(*made, tmp_path / "b.mcap", "--seed", 1).exit_code == 0
    assert invoke(*made, tmp_path / "a.mcap", "--seed", 1, "--overwrite").exit_code == 0
    assert (tmp_path / "a.truth.csv").read_bytes() != truth


def test_simulate_makes_the_folders_that_are_missing(tmp_path):
    for scene, name in (("circles", "a/b/c.npz"), ("overflight", "d/e.csv")):
        done = invoke("simulate", scene, "--scans", 2, "-o", tmp_path / name)
        assert done.exit_code == 0, done.exception
        assert (tmp_path / name).is_file()
    assert (tmp_path / "a/b/c.truth.csv").is_file()
    unnamed = invoke("simulate", "circles", "-o", ".")
    assert str(unnamed.exception) == ".: expected the name of a recording"
    refused = invoke("simulate", "circles", "-o", tmp_path / "x/a.las")
    assert "unknown suffix '.las'" in str(refused.exception)
    assert not (tmp_path / "x").exists()


def test_the_demo_runs_again_and_a_folder_of_ros_2_is_never_replaced(folder, tmp_path):
    demo = ["demo", "--scans", 2, "--no-picture", "-o", tmp_path / "demo"]
    assert [invoke(*demo).exit_code for _ in range(2)] == [0, 0]
    convert = ["convert", folder / "cloud.npz", tmp_path / "ros"]
    assert invoke(*convert).exit_code == 0
    for options in ((), ("--overwrite",)):
        refused = invoke(*convert, *options)
        assert "exists already; a ROS 2 recording is a new folder" in str(refused.exception)
