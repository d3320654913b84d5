"""What a killed process leaves: a folder that can be used again, and no litter for ever."""

import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from typer.testing import CliRunner

from lidar_core.cli import app
from lidar_core.io import write_recording
from lidar_core.io.files.atomic import remove_stale, temporary_for, written_whole
from lidar_core.messages import LaserScan
from lidar_core.run_folder import UNFINISHED

pytestmark = pytest.mark.skipif(os.name != "posix", reason="SIGKILL, and numbers of processes")

PATIENCE_S = 60.0
QUIET = ("--pose", "static", "--no-picture", "--no-mcap")


@pytest.fixture(scope="module")
def long_recording(tmp_path_factory):
    """Long enough to be killed in the middle."""
    path = tmp_path_factory.mktemp("killed") / "sweeps.npz"
    angles = np.linspace(-np.pi, np.pi, 720)
    ranges = (4.0 + np.sin(7 * angles)).astype(np.float32)
    write_recording(
        path,
        (LaserScan(n * 10**8, ranges, -np.pi, 2 * np.pi / 719, 0.1, 30.0) for n in range(4000)),
    )
    return path


def killed(recording, folder, *options):
    """Start a run in a process of its own, and kill it at its first file; its number."""
    with subprocess.Popen(
        [
            sys.executable,
            "-m",
            "lidar_core",
            "circles",
            str(recording),
            "-o",
            str(folder),
            "--pose",
            "static",
            "--no-picture",
            *options,
        ],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    ) as run:
        end = time.monotonic() + PATIENCE_S
        while not (folder / UNFINISHED).exists() and run.poll() is None and time.monotonic() < end:
            time.sleep(0.002)
        time.sleep(0.3)
        run.send_signal(signal.SIGKILL)
        assert run.wait() == -signal.SIGKILL
    return run.pid


def again(recording, folder, *options):
    return CliRunner().invoke(
        app, ["circles", str(recording), "-o", str(folder), *QUIET, "--end", "0.5", *options]
    )


def hidden(folder):
    return sorted(path.name for path in folder.iterdir() if path.name.startswith("."))


def dead_process():
    """Number of a process that has ended, really."""
    done = subprocess.Popen([sys.executable, "-c", "pass"])
    done.wait()
    return done.pid


def test_a_killed_run_can_be_overwritten(long_recording, tmp_path):
    folder = tmp_path / "run"
    process = killed(long_recording, folder)
    assert not (folder / "run.toml").exists()
    assert (folder / UNFINISHED).read_text().startswith("lidar-core circles ")
    (folder / f".circles.csv.{process}.tmp").write_text("of the killed run")
    (folder / "notes.txt").write_text("mine")

    refused = again(long_recording, folder)
    assert isinstance(refused.exception, FileExistsError)
    assert "did not come to its end; --overwrite replaces it" in str(refused.exception)

    done = again(long_recording, folder, "--overwrite")
    assert done.exit_code == 0, done.exception
    assert (folder / "run.toml").is_file()
    assert not (folder / UNFINISHED).exists()
    assert hidden(folder) == []
    assert (folder / "notes.txt").read_text() == "mine"


@pytest.mark.nightly
def test_the_temporary_mcap_of_a_killed_run_goes(long_recording, tmp_path):
    pytest.importorskip("foxglove")
    folder = tmp_path / "run"
    process = killed(long_recording, folder, "--mcap")
    assert f".run.mcap.{process}.tmp" in hidden(folder)
    assert again(long_recording, folder, "--overwrite").exit_code == 0
    assert hidden(folder) == []


def test_a_folder_with_files_of_others_is_still_refused(long_recording, tmp_path):
    (tmp_path / "thesis.tex").write_text("")
    (tmp_path / f".thesis.tex.{dead_process()}.tmp").write_text("")
    before = sorted(path.name for path in tmp_path.iterdir())
    for options in ((), ("--overwrite",)):
        done = again(long_recording, tmp_path, *options)
        assert isinstance(done.exception, FileExistsError)
        assert "holds files that no run wrote" in str(done.exception)
        assert sorted(path.name for path in tmp_path.iterdir()) == before


def test_a_run_killed_before_its_first_whole_file_left_an_empty_folder(long_recording, tmp_path):
    folder = tmp_path / "run"
    folder.mkdir()
    (folder / f".{UNFINISHED}.{dead_process()}.tmp").write_text("lidar")
    assert again(long_recording, folder).exit_code == 0
    assert hidden(folder) == []


def test_a_run_that_goes_on_is_left_alone(long_recording, tmp_path):
    folder = tmp_path / "run"
    with subprocess.Popen(
        [
            sys.executable,
            "-m",
            "lidar_core",
            "circles",
            str(long_recording),
            "-o",
            str(folder),
            *QUIET,
        ],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    ) as run:
        while not (folder / UNFINISHED).exists() and run.poll() is None:
            time.sleep(0.002)
        refused = again(long_recording, folder, "--overwrite")
        assert run.poll() is None
        run.kill()
    assert "another run is being written there" in str(refused.exception)


def test_temporaries_of_the_dead_go_and_those_of_the_living_stay(tmp_path):
    dead, living = dead_process(), os.getppid()
    place = tmp_path / "a.csv"
    of_dead, of_living = (tmp_path / f".a.csv.{number}.tmp" for number in (dead, living))
    of_other_file = tmp_path / f".b.csv.{dead}.tmp"
    no_temporary = tmp_path / ".a.csv.tmp"
    for path in (of_dead, of_living, of_other_file, no_temporary):
        path.write_text("")
    folder = tmp_path / f".a.csv.{dead_process()}.tmp"
    folder.mkdir()
    (folder / "part").write_text("")
    with written_whole(place) as temporary:
        temporary.write_text("1")
    left = sorted(path.name for path in tmp_path.iterdir())
    assert left == sorted(one.name for one in (of_living, of_other_file, no_temporary, place))
    remove_stale(tmp_path)
    left = sorted(path.name for path in tmp_path.iterdir())
    assert left == sorted(one.name for one in (of_living, no_temporary, place))


def test_a_temporary_of_this_process_stays(tmp_path):
    path = tmp_path / "a.csv"
    mine = temporary_for(path)
    mine.write_text("")
    assert temporary_for(path) == mine
    assert mine.exists()


def test_what_a_link_points_to_stays(tmp_path):
    kept = tmp_path / "kept"
    kept.mkdir()
    (kept / "file").write_text("")
    link = tmp_path / f".a.{dead_process()}.tmp"
    link.symlink_to(kept)
    remove_stale(tmp_path)
    assert not link.is_symlink()
    assert (kept / "file").exists()


@pytest.mark.nightly
def test_the_workers_of_a_killed_batch_end(long_recording, tmp_path):
    jobs = tmp_path / "jobs.toml"
    command = f"circles {long_recording} --pose static --no-mcap -o {{output}}/run"
    jobs.write_text(f'[[jobs]]\nname = "long"\ncommands = ["{command}"]\n')
    results = tmp_path / "results"
    with subprocess.Popen(
        [
            sys.executable,
            "-m",
            "lidar_core",
            "batch",
            str(jobs),
            "-o",
            str(results),
            "--workers",
            "1",
        ],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    ) as batch:
        end = time.monotonic() + PATIENCE_S
        while not list(results.glob(f"long-*/run/{UNFINISHED}")) and time.monotonic() < end:
            time.sleep(0.01)
        children = children_of(batch.pid)
        batch.kill()
    assert children
    end = time.monotonic() + 10
    while any(is_there(one) for one in children) and time.monotonic() < end:
        time.sleep(0.05)
    assert [one for one in children if is_there(one)] == []


def children_of(process):
    listed = subprocess.run(
        ["ps", "-o", "pid=", "--ppid", str(process)], capture_output=True, text=True, check=False
    )
    return [int(word) for word in listed.stdout.split()]


def is_there(process):
    """Whether a process is there, and no more than waiting to be collected."""
    state = subprocess.run(
        ["ps", "-o", "stat=", "-p", str(process)], capture_output=True, text=True, check=False
    ).stdout.strip()
    return bool(state) and not state.startswith("Z")
