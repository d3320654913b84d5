"""Units of range rates: the rates are compared with how fast the ranges change."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidar_core.fusion.measurement import Measurement
from lidar_core.fusion.places import LEAST
from lidar_core.fusion.recordings.table import TableOptions
from lidar_core.fusion.repairs import Change, factor_option, of_value

SPEEDS = {"m/s": 1.0, "km/h": 0.2778, "knots": 0.5144, "mph": 0.447, "ft/s": 0.3048}
"""Units that a column of range rates may have, in m/s."""
WINDOWS, LEAST_ROWS = 12, 6
"""Parts of a recording that are compared on their own, at most, and the rows of one, at least."""
LEAST_WINDOWS = 4
MEDIAN = 5
"""Values of which the middle one is used: single false ones do not count."""
CERTAIN, LIKELY = 5.0, 3.0
"""Standard deviations beyond which a told factor is contradicted, and within which another fits."""
ROUGH = 0.02
"""Relative error of the integral of the rates that their scatter does not show."""
DIFFERENT = 1.3
"""A told unit is contradicted from this factor on: the closest units differ from m/s by 1.9."""


class _Factors(NamedTuple):
    """Factors with which the range rates may be the changes of the ranges.

    Two slopes (2,), between which the factor is, and their standard deviations (2,).
    """

    slopes: NDArray[np.float64]
    stds: NDArray[np.float64]

    def bounds(self, deviations: float) -> tuple[float, float]:
        """Least and largest possible factor."""
        reach = deviations * self.stds
        return float(np.min(self.slopes - reach)), float(np.max(self.slopes + reach))

    def hold(self, factor: float) -> bool:
        """Return whether a factor lies within the bounds."""
        least, largest = self.bounds(LIKELY)
        margin = ROUGH * abs(factor)
        return least - margin <= factor <= largest + margin

    @property
    def contradict_told(self) -> bool:
        """Return whether the range rates in the stated unit contradict the changes of the ranges.

        False if the sign of the factor is uncertain, as for a target at rest.
        """
        least, largest = self.bounds(CERTAIN)
        if not (np.isfinite([least, largest]).all() and least * largest > 0):
            return False
        return largest < 1 / DIFFERENT or least > DIFFERENT


def rate_repairs(
    measurements: Sequence[Measurement], told: TableOptions
) -> list[tuple[str, Change]]:
    """Return units of range rates that the data shows in place of the told one; often none.

    Does not depend on the noise of a configuration: ranges and range rates are compared alone.

    Parameters
    ----------
    measurements : sequence of Measurement
        In the order of their times.
    told : TableOptions
        Options with which they were read.
    """
    found = _factors(measurements)
    if found is None or not found.contradict_told:
        return []
    before = told.scale.get("range_rate", 1.0)
    repairs = []
    for unit, size in SPEEDS.items():
        for sign, way in ((1.0, ""), (-1.0, ", positive when the range shrinks")):
            factor = sign * size / before
            # The sign alone is a mistake of its own, which other checks name.
            if factor != -1 and found.hold(factor):
                option = factor_option(told, factor, "range_rate")
                if sign * size == 1:
                    option = f'leave out scale={{"range_rate": {before:g}}}'
                text = f"range rates are {unit}{way}: they fit times {factor:.4g} ({option})"
                repairs.append((text, of_value("range_rate", factor.__mul__)))
    return repairs


def _factors(measurements: Sequence[Measurement]) -> _Factors | None:
    """Compare the ranges with the integral of the range rates; None if that tells nothing.

    Both are replaced by parabolas in parts of the recording, which removes most of their noise.
    The slope of a line through their coefficients is the factor. Noise of the integral makes the
    slope of the ranges over the integral too small, and noise of the ranges makes the inverse slope
    too small, so the factor is between both.
    """
    when, rates = _series(measurements, "range_rate")
    times, ranges = _series(measurements, "range")
    if len(ranges) < LEAST:
        times, ranges = _distances(measurements)
    if len(rates) < LEAST:
        return None
    inside = (times >= when[0]) & (times <= when[-1])
    times, ranges = times[inside], _middle(ranges[inside])
    count = min(WINDOWS, len(times) // LEAST_ROWS)
    if count < LEAST_WINDOWS:
        return None
    with np.errstate(all="ignore"):
        rates = _middle(rates)
        steps = np.diff(when) * (rates[1:] + rates[:-1]) / 2
        driven = np.interp(times, when, np.concatenate([[0.0], np.cumsum(steps)]))
        sums = np.array(
            [
                _products(times[rows], ranges[rows], driven[rows])
                for rows in np.array_split(np.arange(len(times)), count)
            ]
        )
        return _between(sums)


def _between(sums: NDArray[np.float64]) -> _Factors:
    """Factors from the products (W, 3) of W parts; jackknife standard deviations."""
    whole = sums.sum(axis=0)
    without = whole - sums
    slopes, scatter = whole[1:] / whole[:-1], without[:, 1:] / without[:, :-1]
    variance = (len(sums) - 1) * np.mean((scatter - slopes) ** 2, axis=0)
    return _Factors(slopes, np.sqrt(variance))


def _products(
    times: NDArray[np.float64], ranges: NDArray[np.float64], driven: NDArray[np.float64]
) -> list[float]:
    """Sums of driven^2, driven * range and range^2 over the coefficients of both parabolas."""
    span = float(np.ptp(times)) or 1.0
    basis = np.linalg.qr(np.vander((times - times[0]) / span, 3, increasing=True))[0][:, 1:]
    far, moved = basis.T @ (ranges - ranges[0]), basis.T @ (driven - driven[0])
    return [float(moved @ moved), float(moved @ far), float(far @ far)]


def _series(
    measurements: Sequence[Measurement], name: str
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Times [s] and values of one quantity (`name`) that the radar measured."""
    rows = [m for m in measurements if m.measures is not None and name in m.measures]
    return _finite(rows, [m.values[(m.measures or ()).index(name)] for m in rows])


def _distances(
    measurements: Sequence[Measurement],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Times [s] of LiDAR positions, and their distances from the sensor [m]."""
    rows = [m for m in measurements if m.sensor == "lidar"]
    with np.errstate(over="ignore"):
        return _finite(rows, [float(np.linalg.norm(m.values)) for m in rows])


def _finite(
    rows: Sequence[Measurement], values: Sequence[float]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    array = np.array(values, np.float64)
    times = np.array([1e-9 * m.stamp_ns for m in rows], np.float64)
    return times[np.isfinite(array)], array[np.isfinite(array)]


def _middle(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Running median: the median of the values around each value."""
    if len(values) < MEDIAN:
        return values
    padded = np.pad(values, MEDIAN // 2, mode="edge")
    around = np.lib.stride_tricks.sliding_window_view(padded, MEDIAN)
    return np.asarray(np.median(around, axis=1), np.float64)
