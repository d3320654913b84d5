"""`lidar_core.runs`: what the commands do, as functions, leaves the same folders."""

import json
import tomllib

import numpy as np
import pytest
from flying_scenes import drone, yard
from typer.testing import CliRunner

import lidar_core as lc
from lidar_core import ConfigError, FormatError, runs
from lidar_core.circles import CirclesConfig
from lidar_core.cli import app
from lidar_core.flying import FlyingConfig
from lidar_core.fusion import FusionConfig
from lidar_core.io import PoseOptions, Span, read_columns
from lidar_core.sim import Overflight, circle_scenes, overfly

SCANS = 14
TIMES = ("ms_per_scan", "us_per_measurement", "us_per_scan", "seconds", "latency_ms")
"""Entries of a summary that depend on the clock."""


@pytest.fixture(scope="module")
def recordings(tmp_path_factory):
    """One recording per capability, by the name of its command."""
    folder = tmp_path_factory.mktemp("recordings")
    yard_with_drone = yard(drone((6.0, 4.0, 3.5), (5.0, 6.0, 4.0)), scans=SCANS)
    lc.sim.record(yard_with_drone, folder / "yard.npz", seed=0)
    lc.sim.record(circle_scenes.several(0), folder / "poles.npz", seed=0, scans=8)
    lc.fusion.write_overflight(folder / "flight.csv", overfly(Overflight(seconds=4), seed=0))
    return {
        "detect": folder / "yard.npz",
        "circles": folder / "poles.npz",
        "fuse": folder / "flight.csv",
    }


def by_command(name, *arguments):
    out = CliRunner().invoke(app, [name, *map(str, arguments)])
    assert out.exit_code == 0, out.output


def summary_of(folder):
    summary = json.loads((folder / "summary.json").read_text())
    return {name: value for name, value in summary.items() if name not in TIMES}


def note_of(folder):
    note = tomllib.loads((folder / "run.toml").read_text())
    del note["command"]
    return note


def assert_same_folder(first, second):
    names = [sorted(path.name for path in folder.iterdir()) for folder in (first, second)]
    assert names[0] == names[1]
    assert summary_of(first) == summary_of(second)
    assert note_of(first) == note_of(second)
    tables = [name for name in names[0] if name.endswith((".parquet", ".csv"))]
    assert "detections.parquet" in tables or "states.parquet" in tables
    for name in tables:
        one, other = read_columns(first / name), read_columns(second / name)
        assert list(one) == list(other)
        for column in one:
            if not column.endswith("_ms"):
                np.testing.assert_array_equal(one[column], other[column], err_msg=column)
    for path in (first / "tracks_tum").iterdir():
        assert path.read_text() == (second / "tracks_tum" / path.name).read_text()


@pytest.mark.parametrize("name", ["detect", "circles", "fuse"])
def test_a_function_leaves_the_folder_of_its_command(recordings, tmp_path, name):
    by_command(name, recordings[name], "-o", tmp_path / "command", "--no-picture", "--mcap")
    folder = tmp_path / "function"
    run = getattr(runs, name)
    result = run(recordings[name], None, folder, picture=False, mcap=True)
    assert_same_folder(tmp_path / "command", folder)
    assert result.folder == folder
    assert set(result.files) == {path.name for path in folder.iterdir()}
    assert result.summary == json.loads((folder / "summary.json").read_text())
    assert result.ended_by is None
    result.raise_if_failed()


@pytest.mark.parametrize(
    ("name", "config", "values"),
    [
        ("detect", FlyingConfig(voxel_map={"voxel_size": 0.5}), "voxel_map.voxel_size=0.5"),
        ("circles", CirclesConfig(detector="taubin"), "detector=taubin"),
        ("fuse", FusionConfig(model="cv"), "model=cv"),
    ],
)
def test_a_configuration_does_what_its_assignment_does(recordings, tmp_path, name, config, values):
    run = getattr(runs, name)
    run(recordings[name], config, tmp_path / "config", picture=False, mcap=False)
    choice = runs.ConfigChoice(values=(values,))
    run(recordings[name], choice, tmp_path / "choice", picture=False, mcap=False)
    assert_same_folder(tmp_path / "config", tmp_path / "choice")


def test_bad_scans_are_counted_unless_the_configuration_says_otherwise(recordings, tmp_path):
    copy = tmp_path / "yard.npz"
    with lc.io.open_recording(recordings["detect"]) as opened:
        messages = list(opened)
    scans = [item for item in messages if isinstance(item, lc.messages.Scan)]
    lc.io.write_npz(copy, [*messages, scans[-1]])  # the last stamp twice
    options = {"picture": False, "mcap": False}
    counted = runs.detect(copy, FlyingConfig(), tmp_path / "counted", **options)
    assert sum(counted.summary["scans"]["rejected"].values()) == 1
    config = FlyingConfig(on_bad_scan="raise")
    ended = runs.detect(copy, config, tmp_path / "raised", **options)
    assert ended.summary["scans"]["processed"] == SCANS
    with pytest.raises(lc.InputError, match="stamp_ns"):
        ended.raise_if_failed()


def test_a_run_of_rejected_scans_fails_with_the_reason(tmp_path):
    summary = {"scans": {"received": 3, "rejected": {"late": 1}}}
    runs.RunResult(tmp_path, summary, ()).raise_if_failed()
    summary["scans"]["rejected"]["late"] = 2
    with pytest.raises(FormatError, match="2 of 3 scans were rejected, most of them: late"):
        runs.RunResult(tmp_path, summary, ()).raise_if_failed()
    summary |= {"without_pose": {"early": 7}}
    summary["scans"]["received"] += 7  # no pose: nothing to reject
    with pytest.raises(FormatError, match="2 of 3 scans were rejected, most of them: late"):
        runs.RunResult(tmp_path, summary, ()).raise_if_failed()


def test_what_cannot_be_used_is_refused_before_a_folder_is_made(recordings, tmp_path):
    folder = tmp_path / "run"
    with pytest.raises(ConfigError, match=r"expected FlyingConfig .*, got CirclesConfig"):
        runs.detect(recordings["detect"], CirclesConfig(), folder)
    with pytest.raises(lc.InputError, match="no measurements"):
        runs.fuse(recordings["fuse"], None, folder, span=Span(start=100.0))
    with pytest.raises(ConfigError, match="no topic"):
        runs.detect(recordings["detect"], None, folder, clouds=["/no"])
    assert not folder.exists()


def test_progress_counts_the_scans(recordings, tmp_path):
    told = []
    runs.detect(
        recordings["detect"],
        None,
        tmp_path / "run",
        pose=PoseOptions(end=0.35),
        picture=False,
        on_progress=lambda what, done, total: told.append((what, done, total)),
    )
    assert [done for what, done, _ in told if what == "detect"] == [1, 2, 3]
    assert {total for what, _, total in told if what == "detect"} == {SCANS}


@pytest.mark.parametrize("name", ["detect", "circles"])
def test_a_live_run_of_a_recording_leaves_tables(recordings, tmp_path, name):
    told = []
    result = runs.live(
        None,
        None,
        tmp_path / "run",
        replay=recordings[name],
        rate=4.0,
        pose=PoseOptions(pose="static"),
        on_message=told.append,
    )
    assert result.summary["processed"] + sum(result.summary["dropped"].values()) > 0
    assert not result.heard_nothing
    assert {"run.toml", "summary.json", "timing.parquet"} < set(result.files)
    assert told[0].startswith("from ")


def test_a_batch_runs_its_jobs_and_keeps_them(tmp_path):
    file = tmp_path / "jobs.toml"
    file.write_text(
        '[[jobs]]\nname = "flight"\ncommands = ["simulate overflight -o {output}/f.csv'
        ' --scans {rows}"]\ngrid = { rows = [20, 30] }\n'
    )
    told = []
    first = runs.batch(file, tmp_path / "out", workers=1, on_job=told.append)
    assert (first.summary["done"], first.summary["kept"], first.summary["failed"]) == (2, 0, {})
    assert [record.status for record in told] == ["done", "done"]
    assert [record.numbers["simulate.rows"] for record in first.records] == [20, 30]
    again = runs.batch(file, tmp_path / "out", workers=1)
    assert again.summary["kept"] == 2


def test_a_batch_does_not_replace_the_tables_of_another_batch_file(tmp_path, monkeypatch):
    text = (
        '[[jobs]]\nname = "NAME"\ncommands = ["simulate overflight -o {output}/f.csv'
        ' --scans {rows}"]\ngrid = { rows = [ROWS] }\n'
    )
    one, other, out = tmp_path / "one.toml", tmp_path / "other.toml", tmp_path / "out"
    one.write_text(text.replace("NAME", "one").replace("ROWS", "20"))
    other.write_text(text.replace("NAME", "other").replace("ROWS", "20"))
    runs.batch(one, out, workers=1)
    before = {path: path.read_bytes() for path in out.rglob("*.*") if path.is_file()}
    told = rf"^{out}: holds finished jobs of another batch file, {one}, .*; choose another folder"
    for _ in range(2):  # the refused batch leaves no lock
        with pytest.raises(FileExistsError, match=told):
            runs.batch(other, out, workers=1)
    assert {path: path.read_bytes() for path in out.rglob("*.*") if path.is_file()} == before
    # The same file goes on in its folder, however its path is written and whatever it holds now.
    one.write_text(text.replace("NAME", "one").replace("ROWS", "20, 30"))
    monkeypatch.chdir(tmp_path)
    edited = runs.batch("one.toml", "out", workers=1)
    assert (edited.summary["jobs"], edited.summary["kept"]) == (2, 1)
    # A file that has the jobs of the folder, too, replaces nothing that it does not write again.
    copy = tmp_path / "copy.toml"
    copy.write_text(text.replace("NAME", "one").replace("ROWS", "20, 30, 40"))
    more = runs.batch(copy, out, workers=1)
    assert (more.summary["jobs"], more.summary["kept"]) == (3, 2)
    # The cure for a file with a new name, of which some jobs are no longer wanted.
    with pytest.raises(FileExistsError, match=rf"{copy}, .* remove {out / 'batch.toml'}$"):
        runs.batch(one, out, workers=1)
    (out / "batch.toml").unlink()
    assert runs.batch(one, out, workers=1).summary["kept"] == 2


def test_a_batch_that_was_interrupted_is_not_replaced_either(tmp_path):
    files = [tmp_path / "one.toml", tmp_path / "other.toml"]
    for file in files:
        command = f"simulate overflight -o {{output}}/{file.stem}.csv --scans {{rows}}"
        file.write_text(
            f'[[jobs]]\nname = "a"\ncommands = ["{command}"]\ngrid = {{ rows = [20, 30] }}\n'
        )

    def stop(record):
        raise ZeroDivisionError  # as a kill, which leaves no time to write tables

    with pytest.raises(ZeroDivisionError):
        runs.batch(files[0], tmp_path / "out", workers=1, on_job=stop)
    with pytest.raises(FileExistsError, match=rf"holds finished jobs of .*, {files[0]}, "):
        runs.batch(files[1], tmp_path / "out", workers=1)
    assert runs.batch(files[0], tmp_path / "out", workers=1).summary["done"] == 2
