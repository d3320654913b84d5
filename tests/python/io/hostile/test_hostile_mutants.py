"""The hostile suite: what it must find, it finds; a slice of it finds nothing."""

import sys

import pytest
from hostile_runs import hostile

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="limits and fork as on Linux")

PLANTED = {
    "ok": "pass",
    "typed": "raise lidar_core.errors.FormatError('no')",
    "untyped": "raise KeyError('no')",
    "abort": "os.abort()",
    "hang": "while True: pass",
    "memory": "bytearray(2**27)",
}


@pytest.mark.parametrize("kind", PLANTED)
def test_every_way_to_end_badly_is_found(kind):
    # Of memory the peak counts: a library that takes it and gives it back has taken it.
    limits = "memory=2**26" if kind == "memory" else "memory=2**32, cpu=1"
    program = (
        "import os, lidar_core.errors\n"
        "import hostile.child as child\n"
        "if KIND == 'memory': child.resource.setrlimit = lambda *_: None\n"
        "def work():\n    WORK\n"
        f"print(child.run_limited(work, {limits}).kind)\n"
    )
    program = program.replace("KIND", repr(kind)).replace("WORK", PLANTED[kind])
    assert hostile("-c", program) == (0, f"{kind}\n")


def test_a_child_that_gets_no_processor_does_not_hang():
    """Beside another on one processor it waits half of the time; one that sleeps does not."""
    program = (
        "import os, time\n"
        "from hostile.child import starved\n"
        "os.sched_setaffinity(0, [min(os.sched_getaffinity(0))])\n"
        "def child(busy):\n"
        "    one, end = os.fork(), time.monotonic() + 2\n"
        "    while one == 0:\n"
        "        time.sleep(0 if busy else 2)\n"
        "        sum(range(20_000)) if busy else None\n"
        "        time.monotonic() < end or os._exit(0)\n"
        "    return one\n"
        "busy, _, asleep = child(True), child(True), child(False)\n"
        "time.sleep(1.5)\n"
        "print(starved(busy) > 0.2, starved(asleep) < 0.5 * starved(busy), starved(2**22 + 9))\n"
        "for _ in range(3): os.wait()\n"
    )
    assert hostile("-c", program) == (0, "True True 0.0\n")


def test_large_files_are_drawn_less_often_than_small_ones():
    program = (
        "import numpy as np\n"
        "from hostile.__main__ import _drawn\n"
        "rng, sizes = np.random.default_rng(0), [10, 60_000, 8 * 2**20]\n"
        "print(*np.bincount([_drawn(sizes, rng) for _ in range(20_000)]), _drawn([0], rng))\n"
    )
    status, told = hostile("-c", program)
    small, as_small, large, only = map(int, told.split())
    assert (status, only) == (0, 0)
    assert abs(small - as_small) < 700
    assert 20 < large < 200  # they come, too


COMMON = (".bag", ".las", ".lcvm", ".mcap", ".npz", ".pcd", ".ply")
"""Formats that CI reads; all of them are nightly."""


def test_broken_files_of_common_formats_end_in_typed_errors():
    chosen = [word for name in COMMON for word in ("--format", name)]
    status, told = hostile(
        "-m", "hostile", "--count", str(len(COMMON)), "--seed", "7", "--generated-only", *chosen
    )
    assert status == 0, told
    assert "0 untyped, 0 abort, 0 hang, 0 memory" in told


@pytest.mark.nightly
def test_thousands_of_broken_files_end_in_typed_errors(recordings):
    status, told = hostile("-m", "hostile", "--count", "20000", "--seed", "1", limit=14_400)
    assert status == 0, told
