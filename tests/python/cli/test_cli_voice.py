"""How commands speak: JSON lines, quiet, verbose; options from the environment."""

import io
import json
import subprocess
from datetime import datetime

import numpy as np
import pytest
from commands import command_line
from rich.console import Console
from typer.testing import CliRunner

import lidar_core as lc
from lidar_core.cli import app
from lidar_core.cli.shared import voice
from lidar_core.cli.shared.common import shown_progress
from lidar_core.messages import Scan


@pytest.fixture
def recording(tmp_path):
    points = np.random.default_rng(0).normal(size=(500, 3)).astype(np.float32) * 5
    scans = [Scan(stamp_ns=i * 10**8, points=points, frame_id="lidar") for i in range(3)]
    lc.io.write_recording(tmp_path / "a.npz", scans)
    return tmp_path / "a.npz"


def run(*arguments, env=None):
    return subprocess.run(
        command_line(*arguments),
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
        env=env,
    )


def detect(recording, *more):
    return ["detect", recording, "-o", recording.parent / "run", "--pose", "static", *more]


def test_json_lines_are_objects_and_the_table_stays_on_standard_output(recording):
    done = run(*detect(recording, "--log", "json", "-v"))
    assert done.returncode == 0, done.stderr
    lines = [json.loads(line) for line in done.stderr.splitlines()]
    assert lines[0]["text"].startswith(f"lidar-core {lc.__version__}, Python ")
    for line in lines:
        assert line["level"] in ("info", "warning")
        assert datetime.fromisoformat(line["time"]).utcoffset().total_seconds() == 0
    assert "time per scan" in done.stdout


def test_an_error_is_one_object(recording, monkeypatch):
    monkeypatch.setenv("LIDAR_CORE_LOG", "json")
    done = run("info", recording.parent / "none.npz")
    assert done.returncode == 2
    (line,) = done.stderr.splitlines()
    error = json.loads(line)
    assert error["level"] == "error"
    assert "no such file" in error["text"]


def test_verbose_errors_say_where_they_arose(recording):
    plain = run("info", recording.parent / "none.npz")
    assert plain.stderr.count("\n") == 1
    told = run("info", recording.parent / "none.npz", "-v")
    assert told.returncode == 2
    assert "Traceback" in told.stderr
    assert plain.stderr in told.stderr


def test_quiet_writes_files_and_says_nothing(recording):
    done = CliRunner().invoke(app, list(map(str, detect(recording, "-q"))))
    assert done.exit_code == 0
    assert done.output == ""
    assert (recording.parent / "run" / "run.toml").exists()
    printed = CliRunner().invoke(
        app, list(map(str, detect(recording, "-q", "--json", "-", "--overwrite")))
    )
    assert json.loads(printed.stdout)["scans"]["processed"] == 3


def test_quiet_still_tells_errors(recording):
    done = run("info", recording.parent / "none.npz", "-q")
    assert done.stderr.startswith("error: ")


def test_options_come_from_the_environment(recording, monkeypatch):
    """The command line has precedence."""
    arguments = ["detect", str(recording), "-o", str(recording.parent / "run"), "--json", "-"]
    monkeypatch.setenv("LIDAR_CORE_DETECT_POSE", "static")
    monkeypatch.setenv("LIDAR_CORE_DETECT_SET", "voxel_map.voxel_size=0.4 report_tracks=false")
    monkeypatch.setenv("LIDAR_CORE_THREADS", "0")
    monkeypatch.setenv("LIDAR_CORE_VERSION", "not a switch")
    refused = CliRunner().invoke(app, arguments)
    assert refused.exit_code == 2
    assert "LIDAR_CORE_THREADS" in refused.output
    monkeypatch.delenv("LIDAR_CORE_DETECT_SET")
    done = CliRunner().invoke(app, [*arguments, "--threads", "1"])
    assert done.exit_code == 0, done.output
    assert json.loads(done.stdout)["scans"]["processed"] == 3


def test_help_names_only_the_variables_of_all_commands():
    text = CliRunner().invoke(app, ["detect", "--help"]).output
    assert "LIDAR_CORE_LOG" in text
    assert "LIDAR_CORE_DETECT" not in text


@pytest.mark.parametrize(("verbose", "lines"), [(False, 2), (True, 29)])
def test_without_a_terminal_there_is_a_line_a_minute(monkeypatch, verbose, lines):
    """Of 150 s: two with a line a minute, one every 5 s if verbose; none before its time."""
    clock = iter(np.arange(0.0, 1000.0, 0.25))
    monkeypatch.setattr("lidar_core.cli.shared.voice.time.monotonic", lambda: next(clock))
    monkeypatch.setattr(voice, "_chosen", voice.Voice(is_verbose=verbose))
    written = io.StringIO()
    with shown_progress(Console(file=written), counts="scans") as on_progress:
        for done in range(1, 600):
            on_progress("detect", done, 1200)
    told = written.getvalue().splitlines()
    assert len(told) == lines
    assert told[-1].startswith("detect: ")
    assert " of 1200 scans, 4.0 per second, " in told[-1]


def test_more_than_was_asked_for_has_no_time_left(monkeypatch):
    """Of an item that does every part once, however few scans are told."""
    clock = iter(np.arange(0.0, 1000.0, 50.0))
    monkeypatch.setattr("lidar_core.cli.shared.voice.time.monotonic", lambda: next(clock))
    written = io.StringIO()
    with shown_progress(Console(file=written), counts="scans") as on_progress:
        for done in (1, 50, 100):
            on_progress("item", done, 10)
    (told,) = written.getvalue().splitlines()
    assert told == "item: 100 scans, 1.0 per second"


def test_lines_that_were_begun_are_completed():
    written = io.StringIO()
    with voice.JsonLines(written) as lines:
        lines.write("warning: a\n\nb")
        lines.write("c\nnote: d")
    texts = [json.loads(line) for line in written.getvalue().splitlines()]
    assert [one["text"] for one in texts] == ["warning: a", "bc", "note: d"]
    assert [one["level"] for one in texts] == ["warning", "info", "info"]


def test_reasons_that_differ_in_stamps_alone_are_told_once():
    from lidar_core.cli.shared.common import told_reasons

    late = {f"stamp_ns: expected a stamp after {n}, got {n - 5}": 1 for n in range(100, 160)}
    told = told_reasons({**late, "points: expected shape (N, 3)": 2})
    assert told == (
        "60 x stamp_ns: expected a stamp after 100, got 95; 2 x points: expected shape (N, 3)"
    )
