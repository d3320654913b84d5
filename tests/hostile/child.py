"""A reader in a child process with limits; how it ended is one of a few words."""

import os
import resource
import signal
import sys
import time
import traceback
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

MEMORY = 2 * 2**30
"""Address space, libraries included [bytes]."""
CPU = 20
"""Processor time [s]; by the clock the child gets three times as much, and 20 s, not counted while
it waits for a processor."""
GOOD = ("ok", "typed")


@dataclass(frozen=True)
class Outcome:
    """How a child ended.

    kind is ok, typed (an error of the package, or an OSError of the system), untyped, abort (a
    signal), hang (CPU or clock), or memory.
    """

    kind: str
    text: str
    seconds: float
    peak: int

    @property
    def is_good(self) -> bool:
        return self.kind in GOOD


def run_limited(work: Callable[[], object], *, memory: int = MEMORY, cpu: int = CPU) -> Outcome:
    """Call `work` in a child that has `memory` bytes of address space and `cpu` seconds."""
    ours, theirs = os.pipe()
    sys.stdout.flush()
    start = time.monotonic()
    child = os.fork()
    if child == 0:
        os.close(ours)
        _in_child(work, theirs, memory, cpu)
    os.close(theirs)
    text, status, usage = _awaited(child, ours, 3 * cpu + 20)
    seconds = usage.ru_utime + usage.ru_stime
    peak = usage.ru_maxrss * 1024
    clock = time.monotonic() - start
    kind, _, rest = text.partition(" ")
    if os.WIFSIGNALED(status):
        number = os.WTERMSIG(status)
        is_late = number in (signal.SIGXCPU, signal.SIGKILL)
        kind = "hang" if is_late else "abort"
        rest = f"{signal.Signals(number).name} after {seconds:.1f} s of CPU, {clock:.1f} s"
    elif kind not in (*GOOD, "untyped", "memory"):
        kind, rest = "abort", f"exit status {os.waitstatus_to_exitcode(status)} without a word"
    elif peak > memory:
        kind, rest = "memory", f"{peak / 2**20:.0f} MiB resident"
    return Outcome(kind, rest, seconds, peak)


def starved(process: int) -> float:
    """Time for which a process, or one that it started, could run and had no processor [s].

    The largest of them: those that wait at the same time do not add up.
    """
    place = Path(f"/proc/{process}")
    try:
        waited = int((place / "schedstat").read_text().split()[1]) * 1e-9
    except (OSError, IndexError):
        return 0.0  # it has ended, or this system does not tell
    try:
        started = (place / "task" / str(process) / "children").read_text().split()
    except OSError:
        return waited
    return max([waited, *(starved(int(one)) for one in started)])


def _awaited(child: int, pipe: int, clock: float) -> tuple[str, int, resource.struct_rusage]:
    """What the child said, its status, and what it used; it is killed after `clock` seconds.

    Those in which other programs kept it from a processor do not count.
    """
    import select

    said, start = b"", time.monotonic()
    while (left := start + clock + starved(child) - time.monotonic()) > 0:
        if select.select([pipe], [], [], left)[0]:
            part = os.read(pipe, 65536)
            if not part:
                break
            said += part
    else:
        os.kill(child, signal.SIGKILL)
    os.close(pipe)
    _, status, usage = os.wait4(child, 0)
    return said.decode("utf-8", "replace"), status, usage


def _in_child(work: Callable[[], object], pipe: int, memory: int, cpu: int) -> None:
    try:
        resource.setrlimit(resource.RLIMIT_AS, (memory, memory))
        resource.setrlimit(resource.RLIMIT_CPU, (cpu, cpu + 2))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        warnings.simplefilter("ignore")
        silent = os.open(os.devnull, os.O_WRONLY)
        os.dup2(silent, 1)
        os.dup2(silent, 2)
        text = _said(work)
        os.write(pipe, text.encode("utf-8", "backslashreplace")[:60_000])
    finally:
        os._exit(0)


def _said(work: Callable[[], object]) -> str:
    from lidar_core.errors import LidarCoreError

    try:
        work()
    except LidarCoreError as error:
        return f"typed {type(error).__name__}: {error}"
    except OSError as error:
        if type(error) is OSError and error.errno is None:
            return "untyped " + traceback.format_exc()
        return f"typed {type(error).__name__}: {error}"
    except MemoryError:
        return "untyped " + traceback.format_exc()
    except BaseException:
        return "untyped " + traceback.format_exc()
    return "ok "
