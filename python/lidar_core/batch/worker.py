"""Process that does one task after another and continues after an error of a task."""

import os
import signal
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from multiprocessing import get_context, parent_process
from multiprocessing.connection import Connection, wait
from threading import Thread
from typing import Any, TypeAlias

Outcome: TypeAlias = tuple[bool, Any]
"""Whether there is a result, and the result or the exception."""
PATIENCE = 5.0
"""Time that an idle process has to end by itself before it is killed [s]."""


class Worker:
    """Worker process of this machine that does one task at a time.

    It is spawned, not forked: objects of the core refuse to work in a forked process. It ignores
    Ctrl-C, which the process that started it handles.
    """

    def __init__(self) -> None:
        context = get_context("spawn")
        self._ours, theirs = context.Pipe()
        self._process = context.Process(target=_serve, args=(theirs,))
        self._process.start()
        theirs.close()
        self.is_alive = True

    @property
    def connection(self) -> "Connection[Any, Any]":
        """Connection that becomes readable when the task has ended."""
        return self._ours

    def begin(self, function: Callable[..., Any], arguments: Mapping[str, Any]) -> None:
        """Start a task; if the process has died, `outcome` reports it."""
        with suppress(BrokenPipeError):
            self._ours.send((function, dict(arguments)))

    def outcome(self) -> Outcome:
        """Wait for the end of the task."""
        try:
            outcome: Outcome = self._ours.recv()
        except (EOFError, ConnectionResetError):
            self._process.join()
            self.stop(now=True)
            return False, ended(f"its process ended with status {self._process.exitcode}")
        except Exception as error:  # a class that cannot be made again from what was sent
            return False, ended(f"its outcome cannot be read: {type(error).__name__}: {error}")
        return outcome

    def stop(self, *, now: bool) -> None:
        """End the process; with `now` also during a task."""
        self.is_alive = False
        self._ours.close()
        if not now:
            self._process.join(PATIENCE)
        if self._process.is_alive():
            self._process.terminate()
        self._process.join()


def first_done(workers: Iterable[Worker]) -> list[Worker]:
    """Wait until a task of these workers has ended; return the workers whose task has ended."""
    by_connection = {worker.connection: worker for worker in workers}
    return [by_connection[ready] for ready in wait(list(by_connection)) if ready in by_connection]


def called(function: Callable[..., Any], arguments: Mapping[str, Any]) -> Outcome:
    """Call the function; return its outcome, which may be an exception."""
    try:
        return True, function(**arguments)
    except Exception as error:  # whatever it is, it must not end the other tasks
        return False, error


def ended(reason: str) -> Exception:
    """Return the error of a task whose process died."""
    return ChildProcessError(f"no result: {reason}")


def _end_with_parent() -> None:
    """End this process when the one that started it has ended: nobody waits for results."""
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _serve(connection: "Connection[Any, Any]") -> None:
    """Do tasks until the other side closes."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    Thread(target=_end_with_parent, daemon=True).start()
    with suppress(EOFError, BrokenPipeError):
        while True:
            function, arguments = connection.recv()
            outcome = called(function, arguments)
            try:
                connection.send(outcome)
            except (TypeError, ValueError, AttributeError) as error:
                told = outcome[1] if not outcome[0] else error
                connection.send((False, ended(f"{type(told).__name__}: {told}")))
