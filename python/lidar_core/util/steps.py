"""Interpolation between the rows of a table over time."""

import numpy as np
from numpy.typing import NDArray

LONGEST_STEP_NS = 2_000_000_000
"""Longest time between two true positions over which the truth is interpolated [ns].

Source: a boat that turns with 1 m/s^2 is then up to 0.5 m off the straight line between them.
"""


def between(
    stamps: NDArray[np.int64],
    values: NDArray[np.float64],
    at: NDArray[np.int64],
    *,
    longest_ns: int,
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Interpolate linearly between rows that are near enough in time; never beyond the ends.

    Parameters
    ----------
    stamps : ndarray, shape (R,), int64
        Times of the rows [ns], increasing, R >= 1.
    values : ndarray, shape (R, D), float64
        Values of the rows.
    at : ndarray, shape (K,), int64
        Requested times [ns].
    longest_ns : int
        Longest time between two rows to interpolate over [ns].

    Returns
    -------
    found : ndarray, shape (K, D), float64
        Values at these times; meaningless where `is_known` is false.
    is_known : ndarray, shape (K,), bool
        True at the time of a row, and between two rows that are near enough.
    """
    after = np.searchsorted(stamps, at)
    row = np.minimum(after, len(stamps) - 1)
    step = stamps[row] - stamps[np.maximum(row - 1, 0)]
    is_row = stamps[row] == at
    is_known = is_row | ((after > 0) & (after < len(stamps)) & (step <= longest_ns))
    # Times of the clock do not fit into float64; times since the first row do.
    since, asked = stamps - stamps[0], at - stamps[0]
    found = np.stack([np.interp(asked, since, column) for column in values.T], axis=1)
    return found, is_known


def nearest_row(stamps: NDArray[np.int64], at: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the row (K,) whose time is nearest to each of the times `at`; of two, the earlier.

    `stamps` has shape (R,), increases, and has at least one row.
    """
    after = np.minimum(np.searchsorted(stamps, at), len(stamps) - 1)
    before = np.maximum(after - 1, 0)
    is_after = np.abs(stamps[after] - at) < np.abs(stamps[before] - at)
    return np.where(is_after, after, before).astype(np.int64)
