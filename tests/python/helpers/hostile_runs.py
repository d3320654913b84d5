"""Programs that fork and limit themselves, in a process without threads of the tests."""

import os
import subprocess
import sys

from repository import ROOT


def hostile(*arguments, limit=300):
    """Run Python with the suite at hand, without threads of this process; its output."""
    paths = [str(ROOT / "tests"), str(ROOT / "tests/python/helpers"), os.environ.get("PYTHONPATH")]
    env = {**os.environ, "PYTHONPATH": os.pathsep.join(path for path in paths if path)}
    done = subprocess.run(
        [sys.executable, *arguments],
        env=env,
        capture_output=True,
        text=True,
        timeout=limit,
        check=False,
    )
    return done.returncode, done.stdout + done.stderr
