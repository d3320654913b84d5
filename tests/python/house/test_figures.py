"""Tables of speed and memory in README and guide are those that `make figures` writes."""

import json
import re
import subprocess
import sys

import pytest
from repository import ROOT

SCRIPT = ROOT / "benches/figures.py"
sys.path.insert(0, str(SCRIPT.parent))
import figures  # noqa: E402 - beside the benches, not a package
from figure_tables import cells, results  # noqa: E402


@pytest.mark.parametrize("page", figures.PAGES, ids=lambda page: page.name)
def test_tables_are_as_the_results_have_them(page):
    text = page.read_text(encoding="utf-8")
    assert figures.BLOCK.search(text)
    assert figures.page_with_tables(text, results.read_machines()) == text


def test_a_table_that_was_edited_by_hand_is_found():
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    block = figures.BLOCK.search(text)
    start, end = block.span()
    edited = text[:start] + re.sub(r"\b\d\.\d+\b", "0.01", text[start:end], count=1) + text[end:]
    assert edited != text
    assert figures.page_with_tables(edited, results.read_machines()) == text


def test_every_table_stands_on_some_page():
    pages = "".join(page.read_text(encoding="utf-8") for page in figures.PAGES)
    assert {name for _, name, _ in figures.BLOCK.findall(pages)} == set(figures.TABLES)


def test_results_of_benches_are_collected(tmp_path, monkeypatch):
    bench = tmp_path / "criterion/raycast_scene_1/ray_scalar/new"
    bench.mkdir(parents=True)
    (bench / "benchmark.json").write_text(json.dumps({"full_id": "raycast/scene_1/ray_scalar"}))
    interval = {"lower_bound": 2.9e7, "upper_bound": 3.1e7}
    median = {"point_estimate": 3e7, "confidence_interval": interval}
    (bench / "estimates.json").write_text(json.dumps({"median": median}))
    left = tmp_path / "figures"
    left.mkdir()
    for scene in ("scene_1", "scene_2"):
        (left / f"memory_{scene[-1]}.json").write_text(json.dumps({scene: {"map_mb": 5.0}}))
    (left / "scaling.json").write_text(json.dumps({"rays": {"power": 0.8}}))
    monkeypatch.setattr(results, "RESULTS", tmp_path / "results")

    machine = json.loads(results.collect(tmp_path / "criterion", left).read_text())

    assert machine["figures"] == {
        "criterion": {"raycast/scene_1/ray_scalar": {"ms": 30.0, "low_ms": 29.0, "high_ms": 31.0}},
        "memory": {"scene_1": {"map_mb": 5.0}, "scene_2": {"map_mb": 5.0}},
        "scaling": {"rays": {"power": 0.8}},
    }
    assert {"cpu", "cores", "date", "commit", "rust"} < set(machine)


def test_ratios_are_those_of_one_run():
    bench = {"ms": 6.0, "low_ms": 5.0, "high_ms": 7.0}
    found = {"a/ray_scalar": bench | {"ms": 30.0}, "a/integrate": bench}
    machine = {"cpu": "C", "cores": 2, "date": "2026-01-01", "figures": {"criterion": found}}
    assert cells.ratio_text(machine, "a/integrate", "a/ray_scalar") == "0.20"
    assert cells.ratio_text(machine, "a/integrate", "a/missing") == "-"


def test_the_command_finds_no_difference():
    command = [sys.executable, SCRIPT, "check"]
    done = subprocess.run(command, check=False, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_ratios_of_a_comparison_that_is_not_fair_are_not_shown():
    slow = {"place": 0, "of_ours": 20.0, "of_yardstick": 14.7, "gate": 16}
    other = {"place": 1, "of_ours": 10.0, "of_yardstick": 8.0}
    machine = {"figures": {"peers": {"scans into the map": {"tree": slow, "lazy": other}}}}

    def shown(name):
        return cells.peer_range(machine, name, "into the map")

    assert (shown("tree"), shown("lazy"), shown("none")) == ("- (1)", "- (1)", "-")
    slow["gate"] = 14
    assert (shown("tree"), shown("lazy")) == ("20 to 20", "10 to 10")
