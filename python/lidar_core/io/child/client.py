"""Caller's side of child readers: the process that forks them, and the link to a reader."""

import os
import signal
import socket
import subprocess
import sys
import threading
import warnings
import weakref
from pathlib import Path
from typing import Any, Self

from lidar_core import errors
from lidar_core.errors import FormatError, LidarCoreError, LimitError
from lidar_core.io.child import limits, wire
from lidar_core.io.child.server import ANSWER, END, LIBRARIES, OPEN, ORDER, WAIT

_PROGRAM = "import sys; from lidar_core.io.child.server import main; main(int(sys.argv[1]))"
_LIBRARIES = {
    **dict.fromkeys((".bag", ".db3"), LIBRARIES.index("rosbags.highlevel")),
    **dict.fromkeys((".las", ".laz"), LIBRARIES.index("laspy")),
    ".mcap": LIBRARIES.index("mcap.reader"),
    ".pcd": LIBRARIES.index("pypcd4"),
    ".ply": LIBRARIES.index("trimesh"),
}
_TRUST = "if you trust it, read it with trusted=True"


class _Forker:
    """Process that forks readers; it starts with the first reader, once per calling process."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._control: socket.socket | None = None
        self._process: subprocess.Popen[bytes] | None = None

    def fork(self, path: Path) -> tuple[int, socket.socket]:
        """Start a reader of a file; return its process number and the link to it."""
        library = _LIBRARIES.get(path.suffix, 0)
        ours, theirs = socket.socketpair()
        with theirs:
            try:
                child = self._ordered(OPEN, library, [theirs.fileno()])
            except (OSError, EOFError):  # somebody ended the process: another takes its place
                self._forget()
                child = self._ordered(OPEN, library, [theirs.fileno()])
        ours.settimeout(limits.CLOCK)
        return child, ours

    def ended(self, child: int, *, is_gone: bool) -> int | None:
        """Return the exit status of a reader, None if unknown; unless `is_gone`, end it first."""
        try:
            return self._ordered(WAIT if is_gone else END, child, [])
        except (OSError, EOFError):
            return None

    def _ordered(self, kind: bytes, number: int, links: list[int]) -> int:
        with self._lock:
            if self._control is None:
                if kind != OPEN:
                    raise EOFError
                self._control = self._started()
            socket.send_fds(self._control, [ORDER.pack(kind, number)], links)
            data = self._control.recv(ANSWER.size, socket.MSG_WAITALL)
        if len(data) < ANSWER.size:
            raise EOFError
        return int(ANSWER.unpack(data)[0])

    def _started(self) -> socket.socket:
        ours, theirs = socket.socketpair()
        environment = dict(os.environ)
        environment["PYTHONPATH"] = os.pathsep.join(path or os.getcwd() for path in sys.path)
        with theirs:
            self._process = subprocess.Popen(
                [sys.executable, "-c", _PROGRAM, str(theirs.fileno())],
                pass_fds=[theirs.fileno()],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                env=environment,
                process_group=0,  # Ctrl-C is for the caller, who ends his readers
            )
        return ours

    def _forget(self) -> None:
        with self._lock:
            if self._control is not None:
                self._control.close()
            if self._process is not None:
                self._process.kill()
                self._process.wait()
            self._control = self._process = None

    def after_fork(self) -> None:
        """After a fork the child has no readers: they belong to its parent."""
        self._lock = threading.Lock()
        if self._control is not None:
            self._control.close()
        if self._process is not None:
            self._process.returncode = 0  # not a child of the fork, so nothing to wait for
        self._control = self._process = None


_FORKER = _Forker()
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_FORKER.after_fork)


class ReaderLink:
    """Link to a reader in a child process that sends requests to it.

    Parameters
    ----------
    path : Path
        Path of the recording; error messages name it.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        try:
            self._child, self._link = _FORKER.fork(path)
        except (OSError, EOFError) as error:
            raise FormatError(
                f"{path}: its reader process cannot be started ({sys.executable}: {error});"
                f" {_TRUST}"
            ) from error
        self._end = weakref.finalize(self, self._link.close)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def is_open(self) -> bool:
        """True if the reader still runs, as far as is known."""
        return self._end.alive

    def close(self) -> None:
        """End the reader."""
        if self._end.alive:
            self._end()
            _FORKER.ended(self._child, is_gone=False)

    def send(self, kind: str, **values: Any) -> None:
        """Send a request."""
        try:
            wire.send(self._link, {"do": kind, **values})
        except OSError as error:
            raise self._fate() from error

    def receive(self) -> dict[str, Any]:
        """Receive the next answer.

        Raises
        ------
        LimitError
            The reader took more memory, processor time or wall-clock time than it may.
        FormatError
            The file broke the reader.
        """
        try:
            answer = wire.receive(self._link)
            if isinstance(answer, dict):
                return answer
            raise FormatError(f"{self._path}: its reader sent no answer")
        except TimeoutError as error:
            self.close()
            raise LimitError(
                f"{self._path}: no answer for {limits.CLOCK} s from its reader; {_TRUST}"
            ) from error
        except (EOFError, OSError) as error:
            raise self._fate() from error

    def _fate(self) -> LidarCoreError:
        """Return the error that tells why the reader has ended."""
        if not self._end.alive:
            return FormatError(f"{self._path}: the recording is closed")
        self._end()
        status = _FORKER.ended(self._child, is_gone=True)
        place = str(self._path)
        if status is None or not os.WIFSIGNALED(status):
            return FormatError(f"{place}: its reader ended without an answer; {_TRUST}")
        number = os.WTERMSIG(status)
        if number == signal.SIGXCPU:
            return LimitError(
                f"{place}: its reader took more than {limits.cpu_for(self._path)} s of processor"
                f" time between two messages; {_TRUST}"
            )
        if number == signal.SIGKILL:
            return LimitError(f"{place}: its reader was killed because memory ran out; {_TRUST}")
        return FormatError(
            f"{place}: cannot be read: its reader crashed ({signal.Signals(number).name})"
        )


def valued(answer: dict[str, Any]) -> Any:
    """Return the value of an answer; its warnings and its error are repeated here."""
    for name, text in answer.get("warned", ()):
        kind = getattr(errors, str(name), UserWarning)
        is_warning = isinstance(kind, type) and issubclass(kind, Warning)
        warnings.warn(str(text), kind if is_warning else UserWarning, stacklevel=3)
    if "error" in answer:
        raise wire.error_of(answer["error"])
    return answer.get("value")


def call(name: str, path: Path, **arguments: Any) -> Any:
    """Call a function of `lidar_core.io`, named MODULE:FUNCTION, in a child process."""
    with ReaderLink(path) as link:
        link.send("call", name=name, path=str(path), folder=os.getcwd(), arguments=arguments)
        return valued(link.receive())
