"""Metrics over the time of each target: delay, gaps, losses, changes of identity."""

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from lidar_core.evaluation.matching.pairing import Pairing
from lidar_core.evaluation.types import Truth


@dataclass(frozen=True, slots=True)
class Continuity:
    """Continuity of finding the targets; the fields are those of `DetectionScores`."""

    first_delay: dict[int, float | None] = field(default_factory=dict)
    longest_gap: dict[int, float] = field(default_factory=dict)
    n_fragmentations: int = 0


def continuity(truth: Truth, pairing: Pairing) -> Continuity:
    """Compute delays, gaps and losses of the targets that were required at least once."""
    delays: dict[int, float | None] = {}
    gaps: dict[int, float] = {}
    losses = 0
    for number, rows in histories(truth):
        stamps, counts = truth.stamp_ns[rows], truth.is_eligible[rows]
        is_found = pairing.estimate_of[rows] >= 0
        if not counts.any():
            continue
        first = int(counts.argmax())
        later = np.flatnonzero(is_found[first:])
        delays[number] = (
            float(stamps[first + later[0]] - stamps[first]) * 1e-9 if len(later) else None
        )
        gaps[number] = _longest_gap(stamps, counts, is_found)
        when_wanted = is_found[counts]
        starts = when_wanted[1:] & ~when_wanted[:-1]
        losses += int(starts[when_wanted.argmax() :].sum()) if when_wanted.any() else 0
    return Continuity(delays, gaps, losses)


def switches(truth: Truth, pairing: Pairing, track_id: NDArray[np.int64]) -> int:
    """Count the pairs of a target with another track than its previous one."""
    total = 0
    for _, rows in histories(truth):
        partners = pairing.estimate_of[rows]
        total += int(np.count_nonzero(np.diff(track_id[partners[partners >= 0]])))
    return total


def histories(truth: Truth) -> Iterator[tuple[int, NDArray[np.int64]]]:
    """Yield the ID of every target, ascending, and its rows in order of time."""
    for number in np.unique(truth.id).tolist():
        rows = np.flatnonzero(truth.id == number)
        yield number, rows[np.argsort(truth.stamp_ns[rows], kind="stable")]


def _longest_gap(
    stamps: NDArray[np.int64], counts: NDArray[np.bool_], is_found: NDArray[np.bool_]
) -> float:
    """Longest time [s] from the first scan of a gap to its last scan, or to the next estimate."""
    longest, since = 0, None
    for stamp, wanted, found in zip(
        stamps.tolist(), counts.tolist(), is_found.tolist(), strict=True
    ):
        if wanted and not found and since is None:
            since = stamp
        if since is not None and (wanted or found):
            longest = max(longest, stamp - since)
        if found or not wanted:
            since = None
    return longest * 1e-9
