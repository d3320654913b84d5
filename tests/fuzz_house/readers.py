"""Readers in Python, guided by the lines that they reach (`sys.settrace`), in a limited child."""

import contextlib
import hashlib
import os
import resource
import signal
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

import numpy as np

from hostile.__main__ import warm_up
from hostile.child import run_limited
from hostile.seeds import Seed, data_folder, seeds_of

MOST_BYTES = 96 * 1024
"""Longest seed [bytes]: what a reader does with more of it is no different, and slower."""
MEMORY = 2 * 2**30
PATIENCE = 10
"""Processor time for one input [s]."""
INTERESTING = np.array([0, 1, 0x7F, 0x80, 0xFF], np.uint8)
Edge = tuple[CodeType | None, int, int]


class _TooLongError(BaseException):
    """One input takes longer than `PATIENCE`."""


class Coverage:
    """Edges between lines of the package."""

    def __init__(self, package: str) -> None:
        self.seen: set[Edge] = set()
        self.fresh = 0
        self._package = package

    def _of_frame(self, frame: FrameType, event: str, argument: Any) -> Any:
        if not frame.f_code.co_filename.startswith(self._package):
            return None
        code, last = frame.f_code, 0

        def line(frame: FrameType, event: str, argument: Any) -> Any:
            nonlocal last
            edge = (code, last, frame.f_lineno)
            last = frame.f_lineno
            if edge not in self.seen:
                self.seen.add(edge)
                self.fresh += 1
            return line

        return line

    @contextlib.contextmanager
    def watching(self) -> Iterator[None]:
        """Count what is new inside."""
        self.fresh = 0
        sys.settrace(self._of_frame)
        try:
            yield
        finally:
            sys.settrace(None)


def seeds(folder: Path) -> dict[str, list[Seed]]:
    """Good files that are small enough, by their ending."""
    found = seeds_of(folder, data_folder())
    small = {
        name: [one for one in some if len(one.data) <= MOST_BYTES] for name, some in found.items()
    }
    return {name: some for name, some in small.items() if some}


def mutated(data: bytes, others: list[bytes], rng: np.random.Generator) -> bytes:
    """Some bytes changed, moved, removed, or taken from another input."""
    made = bytearray(data)
    for _ in range(1 << int(rng.integers(5))):
        size = len(made)
        if not size:
            return bytes(rng.bytes(8))
        at = int(rng.integers(size))
        length = int(rng.integers(1, 1 + min(32, size)))
        match int(rng.integers(9)):
            case 0:
                made[at] ^= 1 << int(rng.integers(8))
            case 1:
                made[at] = int(rng.choice(INTERESTING))
            case 2:
                made[at : at + 4] = int(rng.integers(2**32)).to_bytes(4, "little")
            case 3:
                made[at : at + 8] = int(rng.choice([0, 2**31, 2**63 - 1, 2**32])).to_bytes(
                    8, "little"
                )
            case 4:
                del made[at : at + length]
            case 5:
                made[at:at] = made[at : at + length]
            case 6:
                del made[at:]
            case 7:
                digits = [
                    place for place in range(at, min(size, at + 200)) if 48 <= made[place] < 58
                ]
                if digits:
                    made[digits[0] : digits[0] + 1] = str(
                        rng.choice([-1, 0, 7, 10**19, "nan"])
                    ).encode()
            case _:
                other = others[rng.integers(len(others))]
                start = int(rng.integers(max(1, len(other))))
                made[at : at + length] = other[start : start + length]
    return bytes(made[: 2 * MOST_BYTES])


def run(name: str, chosen: list[Seed], seconds: float, kept: Path, seed: int) -> dict[str, Any]:
    """Fuzz the readers of one ending in a child, for `seconds`; findings are written to `kept`."""
    kept.mkdir(parents=True, exist_ok=True)
    told, until, executions, edges = set(kept.iterdir()), time.monotonic() + seconds, 0, 0
    ended = 0
    while (left := until - time.monotonic()) > 0.5 and ended < 3:
        ours, theirs = os.pipe()
        sys.stdout.flush()
        child = os.fork()
        if child == 0:
            os.close(ours)
            try:
                _child(chosen, left, kept, seed + ended, theirs)
            finally:
                os._exit(1)
        os.close(theirs)
        with os.fdopen(ours) as said:
            numbers = [line.split() for line in said.read().splitlines() if line]
        _, status = os.waitpid(child, 0)
        executions += int(numbers[-1][0]) if numbers else 0
        edges = max(edges, int(numbers[-1][1]) if numbers else 0)
        if os.waitstatus_to_exitcode(status):
            # A library ended the process. That is no finding, if its own child protects the caller.
            ended += 1
            last = kept / "last"
            if last.exists():
                last.rename(kept / f"ended-{hashlib.sha256(last.read_bytes()).hexdigest()[:12]}")
    (kept / "last").unlink(missing_ok=True)
    confirmed = []
    for path in sorted(set(kept.iterdir()) - told):
        bad = _bad(path, chosen)
        if bad:
            confirmed.append(f"{name} {path.name}: {bad}")
        else:
            path.unlink()
    return {"executions": executions, "edges": edges, "findings": confirmed}


def _bad(path: Path, chosen: list[Seed]) -> str:
    """How users, whose reader is in a child of its own, see the finding; empty if well."""
    for seed in chosen:
        for entry in seed.entries:
            with tempfile.TemporaryDirectory() as folder:
                place = _laid_out(Path(folder), seed, path.read_bytes())
                outcome = run_limited(partial(entry, place))
            if not outcome.is_good:
                return f"{entry.__name__}: {outcome.kind}: {outcome.text.strip()[-600:]}"
    return ""


def _laid_out(folder: Path, seed: Seed, data: bytes) -> Path:
    for name, content in seed.beside.items():
        (folder / name).write_bytes(content)
    (folder / seed.name).write_bytes(data)
    return folder / seed.name


def _child(chosen: list[Seed], seconds: float, kept: Path, seed: int, pipe: int) -> None:
    import lidar_core
    from lidar_core.io import trusted_files

    silent = os.open(os.devnull, os.O_WRONLY)
    os.dup2(silent, 1)
    os.dup2(silent, 2)
    memory = MEMORY + resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    resource.setrlimit(resource.RLIMIT_AS, (memory, memory))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    signal.signal(signal.SIGVTALRM, _late)
    coverage = Coverage(str(Path(lidar_core.__file__).parent))
    rng, until, executions = np.random.default_rng(seed), time.monotonic() + seconds, 0
    pool = [(one, one.data) for one in chosen]
    data_of = [data for _, data in pool]
    with tempfile.TemporaryDirectory() as folder, trusted_files():
        fresh = list(pool)
        while time.monotonic() < until:
            origin, data = fresh.pop() if fresh else pool[rng.integers(len(pool))]
            if executions >= len(chosen):
                data = mutated(data, data_of, rng)
            entry = origin.entries[rng.integers(len(origin.entries))]
            (kept / "last").write_bytes(data)
            with coverage.watching():
                bad = _call(partial(entry, _laid_out(Path(folder), origin, data)))
            executions += 1
            if bad:
                (kept / hashlib.sha256(bad.encode()).hexdigest()[:12]).write_bytes(data)
            elif coverage.fresh:
                pool.append((origin, data))
                data_of.append(data)
            if executions % 50 == 0:
                os.write(pipe, f"{executions} {len(coverage.seen)}\n".encode())
    os.write(pipe, f"{executions} {len(coverage.seen)}\n".encode())
    os._exit(0)


def _call(work: Callable[[], object]) -> str:
    """Where an exception that no caller expects comes from; empty if there is none."""
    from lidar_core.errors import LidarCoreError

    signal.setitimer(signal.ITIMER_VIRTUAL, PATIENCE)
    try:
        work()
    except (LidarCoreError, OSError, MemoryError):
        return ""
    except BaseException as error:
        places, trace = [], error.__traceback__
        while trace is not None:
            places.append(f"{trace.tb_frame.f_code.co_name}:{trace.tb_lineno}")
            trace = trace.tb_next
        return f"{type(error).__name__} {' '.join(places[-3:])}"
    finally:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0)
    return ""


def _late(number: int, frame: FrameType | None) -> None:
    raise _TooLongError


__all__ = ["Coverage", "mutated", "run", "seeds", "warm_up"]
