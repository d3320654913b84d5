"""Ctrl-C in long calls: they stop soon, and what they work on stays as it was."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.skipif(os.name != "posix", reason="signals to this process")

PROGRAM = Path(__file__).parents[1] / "helpers" / "stopped_calls.py"
CALLS = ("process", "integrate", "cluster", "classify", "circles", "fusion", "assign")
MOST_CPU_S = 0.2
"""From the signal to the return. Source: goal "SIGINT to return" of the reliability notes."""


def stopped_calls(points):
    done = subprocess.run(
        [sys.executable, str(PROGRAM), str(points)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.fixture(scope="module")
def calls():
    """Calls of a quarter of a million points."""
    return stopped_calls(250_000)


def check(rows):
    assert all(row["cpu"] <= MOST_CPU_S for row in rows), rows
    assert any(row["stopped"] for row in rows), rows


@pytest.mark.parametrize("name", CALLS)
def test_a_call_ends_soon_after_the_signal(calls, name):
    check(calls[name]["rows"])


@pytest.mark.parametrize("name", ["process", "integrate"])
def test_a_call_that_stopped_left_everything_as_it_was(calls, name):
    rows = calls[name]["rows"]
    assert [row for row in rows if row["state"] == "before"], rows
    # A signal after the first write comes when the call has ended; nothing lies in between.
    assert all(row["state"] in ("before", "after") for row in rows), rows


def test_a_handler_that_does_not_raise_changes_nothing(calls):
    """The opposite: the call goes on, and its results are those of one without a signal."""
    handled = calls["handled"]
    assert handled["n_calls"] == 1
    assert handled["same"]
    assert handled["wait"] < MOST_CPU_S


@pytest.mark.nightly
@pytest.mark.parametrize("name", CALLS)
def test_so_do_calls_of_two_million_points(name):
    check(stopped_calls(2_000_000)[name]["rows"])
