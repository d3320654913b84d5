"""Packages whose modules are imported at first use."""

import re
import subprocess
import sys

import pytest

import lidar_core

THREADS = """
import sys, threading, time
import lidar_core.runs, lidar_core.viz

names = [(lidar_core.runs, name) for name in ("detect", "circles", "fuse", "batch")]
names += [(lidar_core.viz, name) for name in ("draw_film", "Playback", "draw_flying", "Moment")]
sys.setswitchinterval(1e-4)
failed = []


def use(number):
    time.sleep(0.01 * number)
    try:
        assert callable(getattr(*names[(number + START) % len(names)]))
    except BaseException as error:
        failed.append(repr(error))


threads = [threading.Thread(target=use, args=(number,)) for number in range(len(names))]
[one.start() for one in threads]
[one.join() for one in threads]
print(failed)
"""


def test_several_threads_may_use_names_first():
    """Two threads that import modules which import each other would wait for each other."""
    for start in range(3):
        text = THREADS.replace("START", str(start))
        done = subprocess.run(
            [sys.executable, "-c", text], capture_output=True, text=True, check=True
        )
        assert done.stdout == "[]\n", done.stdout


def test_an_unknown_name_is_an_error_of_the_package():
    for package in (lidar_core, lidar_core.runs, lidar_core.viz):
        text = f"module '{package.__name__}' has no attribute 'nothing'"
        with pytest.raises(AttributeError, match=f"^{re.escape(text)}$"):
            package.nothing  # noqa: B018
