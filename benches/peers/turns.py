"""Systems that take turns on the same scans, the CPU time of each, and tables of it."""

import platform
import statistics
import subprocess
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

MILLI = 1e3
Part = tuple[str, dict[str, dict[str, Any]]]
"""What a part of the comparison prints, and its figures by title and system."""


class Program:
    """A program that works on a scan when its number is written to it, and answers a count."""

    def __init__(self, *command: str | Path) -> None:
        self._process = subprocess.Popen(
            [str(word) for word in command],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            bufsize=1,
        )
        if self._answer() != "ready":
            raise RuntimeError(f"{command[0]}: does not say that it is ready")

    def __call__(self, scan: int) -> int:
        """Let it work on a scan."""
        self._process.stdin.write(f"{scan}\n")
        return int(self._answer())

    def clock(self) -> float:
        """CPU time it has taken so far [s]; this is how Linux names the clock of a process."""
        return time.clock_gettime(~self._process.pid << 3 | 2)

    def close(self) -> None:
        """End it."""
        self._process.stdin.close()
        self._process.wait()
        self._process.stdout.close()

    def _answer(self) -> str:
        return self._process.stdout.readline().strip()


@dataclass
class System:
    """Something that works on a scan, its number given, and answers a count."""

    name: str
    work: Callable[[int], int]
    clock: Callable[[], float] = time.process_time

    @classmethod
    def program(cls, name: str, *command: str | Path) -> Self:
        """A system in a process of its own."""
        started = Program(*command)
        return cls(name, started, started.clock)


@dataclass(frozen=True)
class Gate:
    """A peer that has to be this many times slower than the yardstick, or the run is unfair."""

    peer: str
    yardstick: str
    factor: float


@dataclass(frozen=True)
class Turns:
    """CPU times [s] of every system, one per round, and the counts that it answered."""

    title: str
    times: dict[str, list[float]]
    counts: dict[str, list[int]]

    def slower(self, name: str, other: str) -> float:
        """How many times as long `name` takes as `other`: the middle of all rounds."""
        rounds = zip(self.times[name], self.times[other], strict=True)
        return statistics.median(a / b for a, b in rounds)

    def table(self, *, yardstick: str, ours: str, gates: Sequence[Gate] = ()) -> str:
        """A table in Markdown."""
        lines = [
            f"| {self.title} | ms, least | ms, middle | of `{yardstick}` | of `{ours}` |",
            "|---|---|---|---|---|",
        ]
        for name, times in self.times.items():
            least, middle = MILLI * min(times), MILLI * statistics.median(times)
            numbers = [least, middle, self.slower(name, yardstick), self.slower(name, ours)]
            cells = [f"{number:#.3g}" if number < 100 else f"{number:.0f}" for number in numbers]
            lines.append("| " + " | ".join([name, *cells]) + " |")
        return "\n".join(lines + [self._verdict(gate) for gate in gates if gate.peer in self.times])

    def part(self, *, yardstick: str, ours: str, gates: Sequence[Gate] = ()) -> Part:
        """The table in Markdown, and its numbers by system."""
        required = {gate.peer: gate.factor for gate in gates}
        figures = {
            name: {
                "place": place,
                "least_ms": MILLI * min(times),
                "median_ms": MILLI * statistics.median(times),
                "of_yardstick": self.slower(name, yardstick),
                "of_ours": self.slower(name, ours),
                **({"gate": required[name]} if name in required else {}),
            }
            for place, (name, times) in enumerate(self.times.items())
        }
        return self.table(yardstick=yardstick, ours=ours, gates=gates), {self.title: figures}

    def _verdict(self, gate: Gate) -> str:
        found = self.slower(gate.peer, gate.yardstick)
        verdict = "fair" if found >= gate.factor else "**not fair, these ratios do not count**"
        return (
            f"\n{gate.peer} takes {found:.3g} times as long as `{gate.yardstick}`,"
            f" at least {gate.factor:g} expected: {verdict}."
        )


def take_turns(title: str, systems: Sequence[System], scans: Sequence[int]) -> Turns:
    """Let all systems work on each scan in turn; the first round warms up and does not count."""
    times: dict[str, list[float]] = {system.name: [] for system in systems}
    counts: dict[str, list[int]] = {system.name: [] for system in systems}
    for scan in scans:
        for system in systems:
            start = system.clock()
            counts[system.name].append(system.work(scan))
            times[system.name].append(system.clock() - start)
    for system in systems:
        if isinstance(system.work, Program):
            system.work.close()
    return Turns(title, {name: all_of[1:] for name, all_of in times.items()}, counts)


def processor() -> str:
    """Name of the CPU."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.is_file() else []
    names = (line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
    return next(names, platform.processor() or platform.machine())
