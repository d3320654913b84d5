"""Times of measurements that cannot be meant: for notes of a run."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

LEAST_STEP_NS = 1000
"""Median time between measurements of one sensor below which the unit of times is doubted [ns]: no
sensor measures a target a million times a second."""
_COLUMN = 'name the column of times with columns={"t_ns": "NAME"}'
_UNIT = 'state its unit with time_unit="s", ms or us'


def doubtful_times(stamps: Mapping[str, NDArray[np.int64]], *, of_many: bool = False) -> str | None:
    """Say what is wrong with the times of a table; None if they advance.

    Parameters
    ----------
    stamps : mapping of str to ndarray, shape (K,), int64
        Sorted times of the measurements of every sensor [ns].
    of_many : bool
        Whether several measurements of a sensor at one time belong to different targets.
    """
    sensors = [sensor for sensor, own in stamps.items() if len(own) > 1]
    if not sensors:
        return None
    times = np.concatenate(list(stamps.values()))
    if times.min() == times.max():
        return f"all {len(times)} measurements have the same time; {_COLUMN}, or {_UNIT}"
    for sensor in sensors:
        distinct = np.unique(stamps[sensor])
        step = float(np.median(np.diff(distinct))) if len(distinct) > 1 else np.inf
        if step < LEAST_STEP_NS:
            return (
                f"the times of the {sensor} advance by {step:g} ns: the column of times is not in"
                f" nanoseconds; {_UNIT}"
            )
        if not of_many and np.median(np.diff(stamps[sensor])) == 0:
            return (
                f"more than half of the measurements of the {sensor} have the time of the one"
                f" before: the column of times is too coarse ({_COLUMN}), or there are several"
                ' targets (association="integrated")'
            )
    return None
