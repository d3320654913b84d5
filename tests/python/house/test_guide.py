"""The guide: its Python runs, its tours run from the first command to the last, options exist."""

import re
import shlex
import shutil
import subprocess
import sys
from contextlib import chdir
from pathlib import Path

import numpy as np
import pytest
import typer
from commands import invoke
from repository import ROOT

import lidar_core as lc
from lidar_core.cli import app
from lidar_core.evaluation.metric import METRICS
from lidar_core.io.readers import READERS
from lidar_core.io.writers import WRITERS

PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
BLOCK = re.compile(r"^```(sh|python|toml)\n(.*?)^```", re.DOTALL | re.MULTILINE)
TOURS = {
    "evaluation.md": ["street.npz", "run/tracks.parquet", "scores.json"],
    "tour-circles.md": ["hall.mcap", "hall/circles.parquet", "hall/picture.png", "hall.png"],
    "tour-flying.md": ["street.mcap", "flight/tracks.parquet", "flight/map.lcvm", "last.png"],
    "tour-fusion.md": [
        "drone.csv",
        "walk/states.parquet",
        "walk/picture.png",
        "walk-ukf/tracks_tum",
    ],
}
"""Pages whose commands run, too, and what they leave."""
LONG = {
    "evaluation.md",
    "simulation.md",
    "tour-circles.md",
    "tour-flying.md",
    "tour-fusion.md",
    "training.md",
}
"""Pages that run nightly, for they take a quarter of a minute of a core or more."""
CALLS = {"reproduction.md": 24, "circles.md": 6, "recordings.md": 7}
"""How many commands some pages show, so that none is overlooked."""
HALL = """
scans = 20
lidar = { preset = "utm-30lx", scan_rate = 20, range_max = 10 }
[[targets]]
shape = { kind = "cylinder", radius = 0.3 }
motion = { kind = "hover", position = [4, 0, 1] }
"""


def blocks_of(page, *languages):
    found = BLOCK.findall(page.read_text(encoding="utf-8"))
    return [(language, text) for language, text in found if language in languages]


def commands_in(text):
    """Arguments of every call of `lidar-core` in a block of shell."""
    lines = text.replace("\\\n", " ").splitlines()
    calls = [shlex.split(line, comments=True) for line in lines]
    return [call[1:] for call in calls if call[:1] == ["lidar-core"]]


def run_command(arguments, folder):
    code = "from lidar_core.cli import main; main()"
    done = subprocess.run(
        [sys.executable, "-c", code, *arguments],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
        timeout=600,
    )
    assert done.returncode == 0, f"{arguments}: {done.stderr}"


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Files that pages speak of: recordings of a flight and of a robot, and a run."""
    folder = tmp_path_factory.mktemp("guide")
    (folder / "hall.toml").write_text(HALL)
    few = ["--sensor", "os1-32", "--scans", "12"]
    with chdir(folder):
        for command in (
            ["simulate", "demo", "-o", "flight.mcap", *few],
            ["convert", "flight.mcap", "flight.bag"],
            ["simulate", "hall.toml", "-o", "robot.bag"],
            ["detect", "flight.mcap", "-o", "run/", "--no-picture"],
        ):
            done = invoke(*command)
            assert done.exit_code == 0, f"{command}: {done.output or done.exception}"
    poses = (f"{0.1 * number} {0.3 * number} 0 3 0 0 0 1\n" for number in range(20))
    (folder / "poses.txt").write_text("".join(poses))
    return folder


def names_for(page, folder):
    """What the text of a page says that its reader has."""
    if page.name != "training.md":
        return {}
    models = Path(lc.circles.__file__).parent / "models"
    for ending in ("onnx", "json"):
        shutil.copy(models / f"cnn.{ending}", folder / f"my-network.{ending}")
    scanner = lc.circles.Scanner()
    return {"ranges_batch": np.full((1, scanner.n_beams), np.inf), "bearings": scanner.bearings()}


@pytest.mark.parametrize(
    "page",
    [pytest.param(one, marks=pytest.mark.nightly if one.name in LONG else ()) for one in PAGES],
    ids=lambda page: page.stem,
)
def test_what_a_page_shows_runs(page, files, tmp_path, monkeypatch):
    if page.name not in TOURS:
        shutil.copytree(files, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    for registry in (READERS, WRITERS, METRICS):  # what a page adds is forgotten after it
        registry.parts()  # all own ones are loaded: a copy of some would lose the others
        monkeypatch.setattr(registry, "_parts", dict(registry._parts))
    held = names_for(page, tmp_path)
    for language, text in blocks_of(page, "sh", "toml", "python"):
        if language == "python":
            exec(compile(text, page.name, "exec"), held)
        elif page.name in TOURS and language == "sh":
            for arguments in commands_in(text):
                run_command(arguments, tmp_path)
        elif page.name in TOURS:
            Path("hall.toml").write_text(text)
    for left in TOURS.get(page.name, []):
        assert (tmp_path / left).exists(), left


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_the_commands_of_a_page_have_these_options(page):
    command = typer.main.get_command(app)
    calls = [call for _, text in blocks_of(page, "sh") for call in commands_in(text)]
    for call in calls:
        group, rest, name = command, list(call), ""
        while hasattr(group, "commands"):
            name = rest.pop(0)
            group = group.commands[name]
        group.make_context(name, rest)
    assert len(calls) >= CALLS.get(page.name, 0)
