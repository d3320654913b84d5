"""`lidar-core demo`: table, run folder, JSON, picture."""

import json
import sys
import tomllib
from functools import partial

import numpy as np
import pytest
from commands import invoke
from matplotlib.image import imread

from lidar_core.extras import install_command
from lidar_core.flying import FlyingConfig, FlyingObjectDetector

SCANS = 14
TABLE = ["recall of tracks", "position error", "false tracks", "time per scan", "map memory"]


run_command = partial(invoke, "demo")


@pytest.fixture(scope="module")
def demo(tmp_path_factory):
    """A short demo: its folder, what it printed, its JSON."""
    place = tmp_path_factory.mktemp("demo")
    folder, result = place / "run", place / "result.json"
    out = run_command("-o", folder, "--scans", SCANS, "--json", result)
    assert out.exit_code == 0, out.output
    return folder, out.output, json.loads(result.read_text())


def test_the_table_names_what_was_measured(demo):
    for name in TABLE:
        assert name in demo[1]


def test_the_short_demo_finds_both_drones_and_nothing_else(demo):
    scores = demo[2]["track_scores"]
    assert scores["n_eligible"] == 2 * (SCANS - FlyingConfig().seed.burn_in_scans)
    assert scores["recall"] == 1.0
    assert scores["false_ids"] == []
    assert scores["position_error"]["mean"] < 0.05
    found = demo[2]["detection_scores"]
    assert found["n_false"] == 0
    # Against where the drones were when they were measured; at the start of the scan it is 0.06.
    assert found["position_error"]["mean"] < 0.03
    assert found["position_nees"]["mean"] < 9


def test_the_folder_holds_what_the_guide_says(demo):
    folder, _, result = demo
    names = {path.name for path in folder.iterdir()}
    assert {"map.lcvm", "picture.png", "run.toml", "scene.toml", "summary.json"} < names
    assert {path.partition(".")[0] for path in names} >= {"detections", "tracks", "truth"}
    ways = sorted((folder / "tracks_tum").iterdir())
    assert [way.name for way in ways] == ["track_0.txt", "track_1.txt"]
    assert np.loadtxt(ways[0]).shape == (SCANS - 10, 8)
    detector = FlyingObjectDetector()
    detector.load_map(folder / "map.lcvm")
    assert detector.n_observed == result["map"]["observed_voxels"]
    assert json.loads((folder / "summary.json").read_text()) == result
    assert imread(folder / "picture.png").shape[0] > 500
    assert not [name for name in names if name.startswith(".")]


def test_the_folder_can_be_evaluated_again(demo, tmp_path):
    folder, _, result = demo
    again = tmp_path / "again.json"
    out = invoke("evaluate", folder, folder, "--json", again)
    assert out.exit_code == 0, out.output
    values = json.loads(again.read_text())
    for name in ("track_scores", "detection_scores", "latency_ms"):
        assert values[name] == result[name]
    assert values["identity_scores"]["mota"] == 1.0


def test_the_note_holds_the_whole_configuration(demo):
    note = tomllib.loads((demo[0] / "run.toml").read_text())
    assert FlyingConfig.load(note["config"]["flying"]) == FlyingConfig()
    assert note["input"] == {"scene": "scene.toml", "seed": 0, "scans": SCANS}
    assert set(note["versions"]) == {"lidar_core", "python", "numpy", "platform"}


def test_json_on_standard_output_stands_alone(tmp_path):
    out = run_command("-o", tmp_path / "a", "--scans", 1, "--no-picture", "--json", "-")
    assert out.exit_code == 0
    assert json.loads(out.stdout)["track_scores"]["recall"] is None
    assert "gate" in json.loads(out.stdout)
    assert "recall of tracks" in out.stderr
    assert not (tmp_path / "a" / "picture.png").exists()


def test_a_second_run_replaces_the_first_and_nothing_else(tmp_path):
    folder = tmp_path / "run"
    assert run_command("-o", folder, "--scans", 1, "--no-picture").exit_code == 0
    (folder / "picture.png").write_bytes(b"of an earlier run")
    (folder / "mine.txt").write_text("kept")
    assert run_command("-o", folder, "--scans", 1, "--no-picture").exit_code == 0
    assert not (folder / "picture.png").exists()
    assert (folder / "mine.txt").read_text() == "kept"


def test_a_folder_that_no_run_wrote_is_left_alone(tmp_path):
    (tmp_path / "thesis.tex").write_text("")
    out = run_command("-o", tmp_path, "--scans", 1)
    assert isinstance(out.exception, FileExistsError)
    assert "no run wrote" in str(out.exception)
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]


def test_without_matplotlib_the_extra_is_named_and_the_rest_is_there(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    out = run_command("-o", tmp_path / "a", "--scans", 1)
    assert out.exit_code == 0
    assert "no picture" in out.stderr
    assert install_command("plot") in out.stderr
    assert (tmp_path / "a" / "run.toml").exists()
    assert not (tmp_path / "a" / "picture.png").exists()
