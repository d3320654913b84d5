"""Times of measurements that cannot be meant: for notes of a run."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

MOST_TOGETHER = 4
"""Sensors of one kind that may measure one target at the same times."""
LEAST_STEP_NS = 1000
"""Usual time between measurements of one sensor below which the unit of times is doubted [ns]: no
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
        # Most steps: sensors of one kind that measure together are only some microseconds apart.
        step = float(np.quantile(np.diff(distinct), 0.9)) if len(distinct) > 1 else np.inf
        if step < LEAST_STEP_NS:
            return (
                f"the times of the {sensor} advance by {step:g} ns: the column of times is not in"
                f" nanoseconds; {_UNIT}"
            )
        if not of_many and _are_crowded(stamps[sensor]):
            return (
                f"more than half of the measurements of the {sensor} have the time of the one"
                f" before: the column of times is too coarse ({_COLUMN}), or there are several"
                ' targets (association="integrated")'
            )
    return None


def _are_crowded(stamps: NDArray[np.int64]) -> bool:
    """Whether most measurements have the time of another one, and not as synchronous sensors do."""
    if np.median(np.diff(stamps)) > 0:
        return False
    sizes = np.unique(stamps, return_counts=True)[1]
    return bool(sizes.max() > MOST_TOGETHER or sizes.max() != sizes.min())
