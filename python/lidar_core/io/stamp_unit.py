"""Check for stamps of scans that are not nanoseconds, by the time between the scans."""

import statistics
from collections.abc import Sequence
from itertools import pairwise

SHORTEST_NS, LONGEST_NS = 10**6, 60 * 10**9
"""Median times from scan to scan that no LiDAR falls below or exceeds [ns]."""
USUAL_NS = (5 * 10**6, 2 * 10**9)
"""Usual times from scan to scan [ns]: a unit that leads there explains the stamps."""
FEWEST_STEPS = 4
UNITS = {"microseconds": 10**3, "milliseconds": 10**6, "seconds": 10**9}
EPOCH_NS = (631_152_000 * 10**9, 4_102_444_800 * 10**9)
"""The years 1990 to 2100 [ns]. Stamps that are too large lie beyond: here, long steps are meant."""
_SHOWN = ((10**9, "s"), (10**6, "ms"), (10**3, "us"), (1, "ns"))


def stamp_unit_note(stamps_ns: Sequence[int]) -> str | None:
    """Return what is wrong with the unit of the stamps of one LiDAR, and what helps.

    None if nothing is, or if too few scans tell: most stamps that repeat or go backwards have
    notes of their own.
    """
    steps = [b - a for a, b in pairwise(stamps_ns)]
    forward = [step for step in steps if step > 0]
    if len(forward) < FEWEST_STEPS or 2 * len(forward) <= len(steps):
        return None
    step = statistics.median(forward)
    is_short = step < SHORTEST_NS
    is_dated = EPOCH_NS[0] <= stamps_ns[0] <= EPOCH_NS[1]
    if not is_short and (step <= LONGEST_NS or is_dated):
        return None
    usual_ns, cause = _explained(step, is_short)
    rate = "HZ" if usual_ns is None else f"{1e9 / usual_ns:.3g}"
    closer = "closer together" if is_short else "farther apart"
    return (
        f"scans are {_shown(step)} apart, {closer} than those of any LiDAR: stamps have to be"
        f" nanoseconds, {cause}; write the recording with nanoseconds, or count the scans:"
        f' stamps="counted" and scan_rate={rate}'
    )


def _explained(step_ns: float, is_short: bool) -> tuple[float | None, str]:
    """Return the time between scans [ns] if a step is in another unit, and a text on the unit."""
    for name, size in UNITS.items():
        usual_ns = step_ns * size if is_short else step_ns / size
        if USUAL_NS[0] <= usual_ns <= USUAL_NS[1]:
            too_large = f"these seem to be {size:,} times as many"
            return usual_ns, f"these seem to be {name}" if is_short else too_large
    return None, "these are not"


def _shown(step_ns: float) -> str:
    size, unit = next((one for one in _SHOWN if step_ns >= one[0]), _SHOWN[-1])
    return f"{step_ns / size:,.4g} {unit}"
