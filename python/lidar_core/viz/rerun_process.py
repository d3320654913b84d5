"""Rerun's program as a child process, quiet: on 127.0.0.1 alone, without usage data."""

import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress

from lidar_core.extras import require
from lidar_core.viz.origin_check import LOCAL

PURPOSE = "the rerun viewer"
NOWHERE = f"http://{LOCAL}:9"
"""Proxy without a listener for requests to other machines, such as for the newest release."""
NO_PROXY = f"{LOCAL},localhost"
PROXIES = ("HTTP_PROXY", "HTTPS_PROXY", "ALL_PROXY")
PATIENCE_S = 5.0
"""Time that the program has to end by itself before it is killed [s]."""


def free_port() -> int:
    """Return a free port of 127.0.0.1 that cannot be predicted."""
    with socket.socket() as place:
        place.bind((LOCAL, 0))
        return int(place.getsockname()[1])


@contextmanager
def rerun_process(
    arguments: Sequence[str], *, quiet: bool = False
) -> "Iterator[subprocess.Popen[bytes]]":
    """Run Rerun's program until the `with` block ends.

    It listens on 127.0.0.1 alone. The process itself collects no usage data: it gets the settings
    of an empty folder in which collection is switched off, not the user's. Its requests to other
    machines go to a proxy that does not exist. Pages that it serves itself do not have these
    settings; `rerun_page` serves one that needs none. A quiet process prints nothing.
    """
    require("rerun", extra="rerun", purpose=PURPOSE)
    viewer = [sys.executable, "-m", "rerun"]
    with tempfile.TemporaryDirectory(prefix="lidar-core-rerun-") as settings:
        surroundings = {**os.environ, "XDG_CONFIG_HOME": settings, "XDG_DATA_HOME": settings}
        for name in PROXIES:
            surroundings |= {name: NOWHERE, name.lower(): NOWHERE}
        surroundings |= {"NO_PROXY": NO_PROXY, "no_proxy": NO_PROXY}
        subprocess.run(
            [*viewer, "analytics", "disable"], env=surroundings, check=True, capture_output=True
        )
        told = subprocess.DEVNULL if quiet else None
        process = subprocess.Popen(
            [*viewer, "--bind", LOCAL, *arguments],
            env=surroundings,
            stdout=told,
            stderr=told,
            start_new_session=True,
        )
        try:
            yield process
        finally:
            if process.poll() is None:
                _end(process)


def has_display() -> bool:
    """Return whether a window can be opened: not on Linux without X11 and Wayland."""
    shown = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    return bool(shown) or not sys.platform.startswith("linux")


def _end(process: "subprocess.Popen[bytes]") -> None:
    """End the viewer, which is a child of the process that rerun's package starts.

    Both have `PATIENCE_S` to end. Then they are killed.
    """
    if os.name != "posix":
        process.terminate()
        process.wait()
        return
    with suppress(ProcessLookupError, PermissionError):  # both have ended
        os.killpg(process.pid, signal.SIGTERM)
        until = time.monotonic() + PATIENCE_S
        while time.monotonic() < until:
            process.poll()  # a process that has ended stays in the group until it is asked
            os.killpg(process.pid, 0)
            time.sleep(0.02)
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()
