"""Commands in processes that can be killed.

A process of a command is a fork of one that has loaded what commands load and has done nothing
else. To load it anew would take most of the time of a command that writes little, and a kill
meanwhile shows nothing.
"""

import multiprocessing
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path

LOADED = (
    *("hostile.commands", "lidar_core.cli", "lidar_core.batch", "lidar_core.circles"),
    *("lidar_core.flying", "lidar_core.fusion", "lidar_core.io.readers", "lidar_core.live"),
    *(
        "lidar_core.run_folder",
        "lidar_core.runs.settings",
        "lidar_core.sim",
        "lidar_core.viz.figure",
    ),
    *("lidar_core.viz.report.document", "mcap.reader", "onnxruntime", "pyarrow.parquet"),
)
"""Modules; one that is missing is left out."""
PATIENCE_S = 300
_CONTEXT = multiprocessing.get_context("forkserver")
_CONTEXT.set_forkserver_preload(list(LOADED))


def command(folder: Path, arguments: tuple[str, ...]) -> None:
    """Be the process of `lidar-core` with these arguments; it tells its errors in a file."""
    from lidar_core.cli import main

    os.chdir(folder)
    told = os.open("stderr", os.O_CREAT | os.O_TRUNC | os.O_WRONLY, 0o666)
    silent = os.open(os.devnull, os.O_WRONLY)
    os.dup2(silent, sys.stdout.fileno())
    os.dup2(told, sys.stderr.fileno())
    sys.argv = ["lidar-core", *arguments]
    main()


def run(
    folder: Path,
    arguments: tuple[str, ...],
    *,
    wait: float | None = None,
    after: Path | None = None,
    work: Callable[[Path, tuple[str, ...]], None] = command,
) -> int:
    """Do a command in `folder`; its exit status.

    With `wait` it is killed so many seconds after its start, or after the file `after` appears.
    """
    process = _CONTEXT.Process(target=work, args=(folder, arguments))
    process.start()
    until = time.monotonic() + PATIENCE_S
    while after is not None and not after.exists() and process.is_alive():
        assert time.monotonic() < until, f"{after} never came"
        time.sleep(0.002)
    process.join(PATIENCE_S if wait is None else wait)
    if process.is_alive():
        process.kill()
        process.join()
    status = process.exitcode
    assert status is not None
    process.close()
    return status
