"""Interpolation of a truth with other times to the times of the scans."""

import numpy as np
from numpy.typing import NDArray

from lidar_core.io.tables.columns import Columns
from lidar_core.util.steps import LONGEST_STEP_NS, between, nearest_row

OF_SCANS = 0.75
"""Smallest share of the truth's times that are times of scans, for a truth at the scans.

A truth at the scans is not interpolated. A truth with twice as many times has a share of 0.5; a run
that lost single scans has nearly 1. A truth with this share of the times of the tracks that is not
denser than the scans also counts as a truth at the scans: scans that were lost or had no track stay
misses.
"""
SPARSER = 1.5
"""A truth is sparser if its intervals are longer than this number of intervals of the scans."""
STEPS, SHORT_STEP_NS = 2.5, 100_000_000
"""Longest gap to interpolate over: this number of intervals of the target, at least 0.1 s [ns].

One missing row is no gap. In 0.1 s, a target that turns with 10 m/s^2 leaves the straight line by
0.013 m (a t^2 / 8).
"""
USUAL = 0.25
"""Quantile of the intervals of tracks that is the scan interval: some scans have no tracks."""

TIME = "t_ns"


def columns_at_scans(
    columns: Columns,
    id_name: str,
    scan_ns: NDArray[np.int64],
    *,
    track_ns: NDArray[np.int64],
    tolerance: float,
) -> tuple[Columns, NDArray[np.bool_]] | None:
    """Return the targets at the times of the scans, where the truth has other times.

    Parameters
    ----------
    columns : dict of ndarray
        Table of the truth: t_ns, IDs of targets, and values.
    id_name : str
        Name of the column of the IDs.
    scan_ns : ndarray, shape (S,), int64
        Times of the scans [ns], increasing.
    track_ns : ndarray, shape (N,), int64
        Times of the tracks [ns].
    tolerance : float
        A row at most this far from a scan is a row of this scan [s].

    Returns
    -------
    columns, is_interpolated : dict of ndarray and ndarray, shape (K,), bool, or None
        Numeric columns at the times of the scans, and the rows that were interpolated. None if the
        truth is used as it is: its times are those of the scans, or it is sparser.
    """
    stamps, numbers = columns[TIME], columns[id_name]
    order = np.lexsort((stamps, numbers))
    starts = np.flatnonzero(np.diff(numbers[order], prepend=numbers[order][:1] - 1))
    tracks = np.split(order, starts[1:])
    steps = np.concatenate([np.diff(stamps[rows]) for rows in tracks])
    # Hits are counted in one scan, so such a truth is one of scans.
    if "hits" in columns or not len(steps) or (steps == 0).any() or len(scan_ns) < 2:
        return None
    scan_step, times = np.median(np.diff(scan_ns)), np.unique(stamps)
    is_sparser = np.median(steps) > SPARSER * scan_step
    is_denser = SPARSER * np.median(steps) < scan_step
    has_tracks = not is_denser and _is_of_scans(np.unique(track_ns), times, tolerance)
    if is_sparser or has_tracks or _is_of_scans(times, scan_ns, tolerance):
        return None
    names = [n for n, column in columns.items() if n not in {TIME, id_name} and _is_number(column)]
    values = np.stack([columns[name].astype(np.float64) for name in names], axis=1)
    parts = [_target_at(stamps[rows], values[rows], scan_ns, 1e9 * tolerance) for rows in tracks]
    found = np.concatenate([part[0] for part in parts])
    told = {
        TIME: np.concatenate([part[1] for part in parts]),
        id_name: np.repeat(numbers[order][starts], [len(part[1]) for part in parts]),
    }
    told |= {name: found[:, place] for place, name in enumerate(names)}
    return told, np.concatenate([part[2] for part in parts])


def supposed_scans(track_ns: NDArray[np.int64], truth_ns: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return times of scans [ns] from tracks alone: at their usual interval over the whole truth.

    Scans in which nothing was tracked are in no table of tracks. Without them a target that was
    not found would not count as missed. Empty if two times of tracks are not known.
    """
    if not len(truth_ns):
        return np.empty(0, np.int64)
    first, last = int(truth_ns.min()), int(truth_ns.max())
    stamps = np.unique(track_ns)
    stamps = stamps[(stamps >= first) & (stamps <= last)]
    if len(stamps) < 2:
        return np.empty(0, np.int64)
    usual = int(np.quantile(np.diff(stamps), USUAL, method="lower"))
    if (last - first) // usual > SPARSER * len(truth_ns):
        return stamps  # a sparser truth: it is used as it is
    parts = [np.arange(stamps[0] - usual, first - 1, -usual)[::-1]]
    for begin, end in zip(stamps[:-1].tolist(), stamps[1:].tolist(), strict=True):
        count = max(round((end - begin) / usual), 1)
        # Whole numbers would overflow: nanoseconds of a day times their count.
        steps = np.arange(count) * ((end - begin) / count)
        parts.append(begin + np.rint(steps).astype(np.int64))
    parts.append(np.arange(stamps[-1], last + 1, usual))
    return np.concatenate(parts).astype(np.int64)


def _is_of_scans(times: NDArray[np.int64], scan_ns: NDArray[np.int64], tolerance: float) -> bool:
    """Return whether most `times` within the period of the scans are times of scans."""
    reach = 1e9 * tolerance
    seen = times[(times >= scan_ns[0] - reach) & (times <= scan_ns[-1] + reach)]
    if not len(seen):
        return True  # no time in common: nothing to interpolate
    away = np.abs(seen - scan_ns[nearest_row(scan_ns, seen)])
    return bool((away <= reach).mean() > OF_SCANS)


def _is_number(column: NDArray[np.generic]) -> bool:
    return column.dtype.kind in "fiu"


def _target_at(
    stamps: NDArray[np.int64],
    values: NDArray[np.float64],
    scan_ns: NDArray[np.int64],
    reach: float,
) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.bool_]]:
    """Return values of one target, their scan times, and which values are interpolated."""
    usual = np.median(np.diff(stamps)) if len(stamps) > 1 else 0
    longest = int(np.clip(STEPS * usual, SHORT_STEP_NS, LONGEST_STEP_NS))
    found, is_known = between(stamps, values, scan_ns, longest_ns=longest)
    row = nearest_row(stamps, scan_ns)
    is_row = np.abs(stamps[row] - scan_ns) <= reach
    found[is_row] = values[row[is_row]]
    kept = is_known | is_row
    return found[kept], scan_ns[kept], ~is_row[kept]
