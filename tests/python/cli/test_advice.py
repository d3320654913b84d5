"""Every command that is told for a real recording works on it.

The recordings are those that lie in the folder of real ones, whichever these are.
"""

import bz2
import re
import shlex
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from repository import RECORDINGS
from typer.testing import CliRunner

from lidar_core.cli import app
from lidar_core.errors import LidarCoreError, MissingExtraError
from lidar_core.io import write_recording
from lidar_core.io.poses.pose_files import read_poses
from lidar_core.messages import LaserScan, Scan

PLACES = sorted(
    path.relative_to(RECORDINGS)
    for path in [*RECORDINGS.rglob("*"), RECORDINGS]
    if path.suffix not in (".png", ".md")
)
SHORT = {"detect": "0.3", "circles": "5"}
"""How much of a recording the commands read [s]: poses of some begin a second late."""
LINES = 3000
"""Of a text log, which has no index: every command would read megabytes to its end."""
LARGEST = 8_000_000
"""Bytes of an archive that is unpacked here: larger ones take too long for every change."""
DONE = set()


def answer(place):
    """What `info` says of a place, and the error it ends with."""
    done = CliRunner().invoke(app, ["info", str(place)])
    assert isinstance(done.exception, LidarCoreError | OSError | None), (place, done.exception)
    return done.stdout, done.exception


def works(command, folder):
    """Do a command as it was told, its output in `folder`, and no more of it than needed."""
    if command in DONE:  # a folder of one file is that file
        return
    DONE.add(command)
    words = shlex.split(command)
    assert words[0] == "lidar-core"
    words[words.index("run/")] = str(folder / f"run-{len(list(folder.iterdir()))}")
    more = ["--end", SHORT[words[1]]] if words[1] in SHORT else []
    done = CliRunner().invoke(app, [*words[1:], *more, "--no-picture", "--no-mcap"])
    assert done.exit_code == 0, f"{command}\n{done.exception}"


def head_of(place, folder):
    """The first lines of a text log; every other place itself."""
    if not place.name.endswith(".clf.bz2"):
        return place
    head = folder / place.stem
    with bz2.open(place) as log, head.open("wb") as file:
        file.writelines(line for line, _ in zip(log, range(LINES), strict=False))
    return head


def follow(place, folder):
    """Do what is told about a place."""
    said, error = answer(head_of(place, folder))
    for line in said.splitlines():
        if line.startswith("next: "):
            works(line.removeprefix("next: ").partition("  (")[0], folder)
    text = str(error or "")
    for command in re.findall(r"lidar-core \w+ .* -o run/", text):
        works(command, folder)
    if "name one of" in text:
        names = text.rpartition("name one of ")[2].removeprefix("the folders in it: ").split(", ")
        assert [name for name in names if not (place / name).exists()] == []
    if found := re.search(r"unpack it first: (.*) FILE$", text):
        unpack(found[1], place, folder)
    if "--map`" in text:
        with_map(place, folder)
    if found := re.search(r"belong to: --pose (.*)$", text):
        assert len(read_poses(Path(*shlex.split(found[1])))[1]) > 0


def unpack(command, place, folder):
    if place.stat().st_size > LARGEST or shutil.which(command.split()[0]) is None:
        return
    inner = folder / "unpacked"
    inner.mkdir()
    shutil.copyfile(place, inner / place.name)
    subprocess.run([*command.split(), place.name], cwd=inner, check=True, timeout=60)
    new = [path for path in inner.iterdir() if path.name != place.name]
    assert new, f"{command} gave nothing for {place}"
    for path in [inner, *new]:
        follow(path, folder)


def with_map(place, folder):
    recording = folder / "cloud.npz"
    write_recording(recording, [Scan(1, np.ones((4, 3), np.float32))])
    works(
        shlex.join(
            [
                "lidar-core",
                "detect",
                str(recording),
                "--map",
                str(place),
                "--pose",
                "static",
                "-o",
                "run/",
            ]
        ),
        folder,
    )


@pytest.mark.ci_cases(
    "*LICENSE",
    "2d/radish*",
    "3d/nebula/*",
    "3d/sequences*",
    "people/corridor/example1*",
    "formats/ouster_broken*",
)
@pytest.mark.parametrize(
    "place",
    [
        pytest.param(place, marks=pytest.mark.nightly) if number % 3 else place
        for number, place in enumerate(PLACES)
    ],
    ids=str,
)
def test_what_is_told_about_a_real_place_works(place, tmp_path):
    follow(RECORDINGS / place, tmp_path)


def test_there_are_real_places(recordings):
    assert recordings.samefile(RECORDINGS)
    assert len(PLACES) > 50


SWEEPS = [LaserScan(n * 10**8, np.ones(9, np.float32), 0.0, 0.1, 0.1, 9.0) for n in range(3)]


@pytest.mark.parametrize(
    ("command", "ending"), [("gzip", ".gz"), ("bzip2", ".bz2"), ("xz", ".xz"), ("zstd", ".zst")]
)
def test_what_is_told_about_a_packed_file_works(tmp_path, command, ending):
    if shutil.which(command) is None:
        pytest.skip(f"needs {command}")
    write_recording(tmp_path / "a.npz", SWEEPS)
    subprocess.run([command, "a.npz"], cwd=tmp_path, check=True, timeout=60)
    (tmp_path / "a.npz").unlink(missing_ok=True)
    packed = tmp_path / f"a.npz{ending}"
    _, error = answer(packed)
    assert "unpack it first" in str(error)
    follow(packed, tmp_path)
    assert (tmp_path / "unpacked" / "a.npz").exists()


@pytest.mark.parametrize("ending", [".tar", ".tar.gz", ".tgz", ".tar.xz", ".tar.bz2"])
def test_what_is_told_about_an_archive_works(tmp_path, ending):
    write_recording(tmp_path / "a.npz", SWEEPS)
    packed = tmp_path / f"a{ending}"
    subprocess.run(["tar", "caf", packed, "a.npz"], cwd=tmp_path, check=True, timeout=60)
    _, error = answer(packed)
    assert "unpack it first: tar xf FILE" in str(error)
    follow(packed, tmp_path)
    assert (tmp_path / "unpacked" / "a.npz").exists()


def test_a_missing_package_is_told_with_the_command_that_brings_it(tmp_path):
    """What an extra that is not here needs is said; it cannot be done here."""
    path = tmp_path / "a.bag"
    path.write_bytes(b"bag")
    _, error = answer(path)
    if isinstance(error, MissingExtraError):
        assert "[io]" in str(error)
