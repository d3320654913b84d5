"""Checks of the times of measurements for wrong units and disorder, for notes of a run."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from lidar_core.fusion.recordings.table import UNITS_NS

MOST_TOGETHER = 4
"""Sensors of one kind that may measure one target at the same times."""
LEAST_STEP_NS = 1000
"""Usual time between measurements of one sensor below which the unit of times is doubted [ns]: no
sensor measures a target a million times a second."""
_COLUMN = 'name the column of times with columns={"t_ns": "NAME"}'
_UNIT = 'state its unit with time_unit="s", ms or us'
_NAMES = {"ns": "nanoseconds", "us": "microseconds", "ms": "milliseconds", "s": "seconds"}
SHORT_STEP_NS = 200_000
"""Usual time below which the times may count microseconds [ns]: few sensors measure a target 5000
times a second."""
USUAL_STEP_NS = 1e8
"""Usual time between measurements of one sensor [ns]."""


def wrong_unit(stamps: Mapping[str, NDArray[np.int64]], time_unit: str) -> str | None:
    """Say that times of a table cannot be in their unit, and which one fits; None if they can.

    Parameters
    ----------
    stamps : mapping of str to ndarray, shape (K,), int64
        Times of the measurements of every sensor [ns], in any order.
    time_unit : str
        Unit in which they were read: ns, us, ms or s.
    """
    for sensor, own in stamps.items():
        step = _usual_step(own)
        if step < LEAST_STEP_NS:
            # Times that were rounded to nanoseconds still tell how many there are in all.
            mean = (float(own.max()) - float(own.min())) / (len(own) - 1)
            unit = _fitting_unit(mean, time_unit)
            return (
                f"the times of the {sensor} advance by {step:g} ns: the column of times is not in"
                f' {_NAMES[time_unit]}; {_NAMES[unit]} fit (time_unit="{unit}")'
            )
    return None


def doubtful_times(
    stamps: Mapping[str, NDArray[np.int64]], *, of_many: bool = False, time_unit: str = "ns"
) -> str | None:
    """Say what is wrong with the times of a table; None if they advance.

    Parameters
    ----------
    stamps : mapping of str to ndarray, shape (K,), int64
        Sorted times of the measurements of every sensor [ns].
    of_many : bool
        Whether several measurements of a sensor at one time belong to different targets.
    time_unit : str
        Unit in which they were read: ns, us, ms or s.
    """
    several = {sensor: own for sensor, own in stamps.items() if len(own) > 1}
    if not several:
        return None
    times = np.concatenate(list(stamps.values()))
    if times.min() == times.max():
        return f"all {len(times)} measurements have the same time; {_COLUMN}, or {_UNIT}"
    if wrong := wrong_unit(several, time_unit):
        return wrong
    for sensor, own in several.items():
        if not of_many and _are_crowded(own):
            return (
                f"more than half of the measurements of the {sensor} have the time of the one"
                f" before: the column of times is too coarse ({_COLUMN}), or there are several"
                ' targets (association="integrated")'
            )
        step = _usual_step(own)
        if step < SHORT_STEP_NS and time_unit == "ns":
            return (
                f"the times of the {sensor} advance by {step / 1000:g} us; if the column of times"
                ' is in microseconds, state it with time_unit="us"'
            )
    return None


def _usual_step(stamps: NDArray[np.int64]) -> float:
    """0.9 quantile of the steps between distinct times [ns]; infinite without steps."""
    # Most steps: sensors of one kind that measure together are only some microseconds apart.
    distinct = np.unique(stamps)
    return float(np.quantile(np.diff(distinct), 0.9)) if len(distinct) > 1 else np.inf


def _fitting_unit(step: float, told: str) -> str:
    """Return the unit other than `told` in which the step [ns] is most usual for sensors."""
    return min(
        (unit for unit in UNITS_NS if unit != told),
        key=lambda unit: abs(np.log(step * UNITS_NS[unit] / UNITS_NS[told] / USUAL_STEP_NS)),
    )


def _are_crowded(stamps: NDArray[np.int64]) -> bool:
    """Return whether measurements share times in another way than those of synchronous sensors."""
    if np.median(np.diff(stamps)) > 0:
        return False
    sizes = np.unique(stamps, return_counts=True)[1]
    return bool(sizes.max() > MOST_TOGETHER or sizes.max() != sizes.min())
