"""Counts of a live run: rates, latencies, and skipped messages with the reason."""

from collections import Counter, deque
from dataclasses import dataclass
from typing import Any

import numpy as np

KEPT = 100_000  # latencies of a long run that count; older ones go
LONGEST_WAY_MS, CLOCK_SLACK_MS = 10_000.0, 10.0


@dataclass(frozen=True, slots=True)
class Delay:
    """Median and 95th percentile of a latency [ms]."""

    median: float
    p95: float


@dataclass(frozen=True, slots=True)
class Report:
    """Content of one line on the console.

    Attributes
    ----------
    elapsed_s, rate_hz : float
        Time since the start [s]; scans per second since the last report.
    from_stamp, from_arrival : Delay or None
        Latencies since the last report.
    counts : dict
        Counts of skipped messages since the start.
    processed : int
        Scans since the start.
    objects : int
        Tracks or elements now.
    trouble : str
        Problem that the source waits for.
    """

    elapsed_s: float
    rate_hz: float
    from_stamp: Delay | None
    from_arrival: Delay | None
    counts: dict[str, int]
    processed: int
    objects: int
    trouble: str


def clock_difference_ms(from_stamp: Delay | None, from_arrival: Delay | None) -> float | None:
    """Return how far this machine's clock is ahead of the clock of the stamps [ms].

    It is negative if this clock is behind. It is None if the transport of the messages can explain
    the difference: the time from a stamp to its arrival is then between zero and `LONGEST_WAY_MS`.
    """
    if from_stamp is None or from_arrival is None:
        return None
    way_ms = from_stamp.median - from_arrival.median
    return None if -CLOCK_SLACK_MS <= way_ms <= LONGEST_WAY_MS else way_ms


def told_difference(difference_ms: float) -> str:
    """Return a difference of clocks as text, in a suitable unit."""
    seconds = abs(difference_ms) * 1e-3
    for unit, size in (("days", 86_400.0), ("h", 3600.0), ("min", 60.0), ("s", 1.0)):
        if seconds >= 2 * size:
            return f"clocks differ by {seconds / size:.1f} {unit}"
    return f"clocks differ by {seconds * 1e3:.0f} ms"


class LatencyLog:
    """Latencies of the newest scans [ms]."""

    def __init__(self) -> None:
        self._all: deque[float] = deque(maxlen=KEPT)
        self._recent: list[float] = []

    def add(self, latency_ns: int) -> None:
        """Append one latency [ns]."""
        self._all.append(latency_ns * 1e-6)
        self._recent.append(latency_ns * 1e-6)

    def recent(self) -> Delay | None:
        """Return the summary of latencies since the last call; None without any."""
        values, self._recent = self._recent, []
        return _delay(values)

    def total(self) -> Delay | None:
        """Return the summary of all stored latencies; None without any."""
        return _delay(list(self._all))


def _delay(values: list[float]) -> Delay | None:
    if not values:
        return None
    median, p95 = np.quantile(values, [0.5, 0.95])
    return Delay(float(median), float(p95))


class LiveStats:
    """Counts of one run.

    Attributes
    ----------
    processed : int
        Scans that went through the pipeline.
    dropped, without_pose, rejected, ignored : Counter
        Counts of scans: replaced by newer ones, by topic; without a pose, by the missing frame;
        rejected by pipeline or output, by reason (the first of those that differ only in numbers);
        of topics that were not requested, by topic.
    from_stamp, from_arrival : LatencyLog
        Latencies to the end of the outputs: from the stamp of the scan, and from its arrival.
    """

    def __init__(self) -> None:
        self.processed = 0
        self.dropped: Counter[str] = Counter()
        self.without_pose: Counter[str] = Counter()
        self.rejected: Counter[str] = Counter()
        self.ignored: Counter[str] = Counter()
        self.from_stamp, self.from_arrival = LatencyLog(), LatencyLog()

    def counts(self) -> dict[str, int]:
        """Return the total counts of scans, for the line of a report."""
        return {
            "dropped": self.dropped.total(),
            "without pose": self.without_pose.total(),
            "rejected": self.rejected.total(),
        }

    def summary(self) -> dict[str, Any]:
        """Return all counts and latencies as a dict of plain values."""
        delays = {"from_stamp": self.from_stamp.total(), "from_arrival": self.from_arrival.total()}
        difference = clock_difference_ms(delays["from_stamp"], delays["from_arrival"])
        if difference is not None:
            delays["from_stamp"] = None
        return {
            "processed": self.processed,
            "dropped": dict(self.dropped),
            "without_pose": dict(self.without_pose),
            "rejected": dict(self.rejected),
            "ignored": dict(self.ignored),
            "latency_ms": {
                name: None if delay is None else {"median": delay.median, "p95": delay.p95}
                for name, delay in delays.items()
            },
            "clocks_differ_ms": difference,
        }


def within_limit(counter: "Counter[str]", reason: str, *, most: int = 100) -> str:
    """Return `reason`, or "other reasons" if it is new and `most` reasons are counted already."""
    return reason if reason in counter or len(counter) < most else "other reasons"
