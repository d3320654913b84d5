"""Limits of memory that are too small: typed errors, objects as they were, no abort."""

import os
import sys

import numpy as np
import pytest

from hostile import memory

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="limits as on Linux")
GOOD = {"ok", "typed"}


LARGER = {"open", "track", "infer"}
"""Left out here: they take long, and the nightly run has them."""


@pytest.mark.parametrize("name", [name for name in memory.WORK if name not in LARGER])
def test_little_memory(name):
    ended = {memory.attempt(name, extra, 0.02) for extra in (4, 24)}
    assert ended <= GOOD
    assert memory.attempt(name, 4000, 0.02) == "ok"  # the work itself can be done


@pytest.mark.nightly
@pytest.mark.parametrize("name", memory.WORK)
def test_many_limits(name):
    steps = range(memory.STEP, memory.STEP * (memory.LIMITS + 1), memory.STEP)
    wrong = {extra: how for extra in steps if (how := memory.attempt(name, extra)) not in GOOD}
    assert wrong == {}


def test_an_abort_and_a_changed_object_are_told(monkeypatch):
    """The opposite: the program sees what it looks for."""
    held = [0]

    def changes(folder, size):
        def work():
            held.append(np.ones(2**26))

        def state():
            return bytes(len(held))

        def begun():
            held.append(1)
            return np.ones(2**26)

        return begun if size else work, state

    def aborts(folder, size):
        return os.abort, bytes

    monkeypatch.setitem(memory.WORK, "changes", changes)
    monkeypatch.setitem(memory.WORK, "aborts", aborts)
    assert memory.attempt("changes", 8).startswith("changed by MemoryError")
    assert memory.attempt("changes", 8, size=0) == "typed"
    assert memory.attempt("aborts", 8) == "SIGABRT"
