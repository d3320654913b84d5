"""`lidar-core` in the process of the test, and in one of its own."""

import json
import subprocess
import sys
from contextlib import contextmanager

from typer.testing import CliRunner

from lidar_core.cli import app

PROGRAM = "import sys; sys.argv[0] = 'lidar-core'; from lidar_core.cli import main; main()"


def invoke(*arguments):
    """The outcome of a command."""
    return CliRunner().invoke(app, list(map(str, arguments)))


def json_of(*arguments):
    """What `--json` prints of a command that must succeed."""
    out = invoke(*arguments, "--json", "-")
    assert out.exit_code == 0, out.output or out.exception
    return json.loads(out.stdout)


def command_line(*arguments, python=sys.executable):
    """What starts a command in a process of its own."""
    return [python, "-c", PROGRAM, *map(str, arguments)]


@contextmanager
def running(*arguments, stderr=subprocess.PIPE, env=None):
    """A command in a process of its own, which has ended at the end of the block."""
    process = subprocess.Popen(
        command_line(*arguments),
        stdout=subprocess.PIPE,
        stderr=stderr,
        text=True,
        bufsize=1,
        env=env,
    )
    try:
        yield process
    finally:
        if process.returncode is None:
            process.kill()
            process.communicate()
        for stream in (process.stdout, process.stderr):
            if stream is not None:
                stream.close()
