"""Run of a filter or smoother over a whole recording."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_core import _core
from lidar_core.config import as_config
from lidar_core.errors import InputError
from lidar_core.fusion.config import FusionConfig
from lidar_core.fusion.measurement import Measurement, Measurements, as_measurements

_OUTCOMES = np.array(_core.fusion_outcomes())
NO_TIME = np.iinfo(np.int64).min
"""Time of a filter that has not started [ns]."""
MAX_LAG = 1e6
"""Longest lag of a smoother [s]."""


@dataclass(frozen=True, slots=True)
class Run:
    """Output of a filter, one row per measurement in the order of the stamps.

    Attributes
    ----------
    stamps_ns : ndarray, shape (K,), int64
        Times of the states [ns]; of the measurement before the first state.
    states : ndarray, shape (K, n)
        Means after the measurement; NaN before the target has been seen.
    covariances : ndarray, shape (K, n, n)
        Covariances of the states.
    innovations : ndarray, shape (K, 3), or (K, 4) in space
        Measured minus expected; NaN beyond the values that were compared.
    nis : ndarray, shape (K,)
        Normalised innovation squared; NaN where nothing was compared.
    outcomes : ndarray, shape (K,), str
        Outcomes, as in `FusionStep.outcome`.
    lidar_std_estimated : ndarray, shape (2,), or (3,) in space
        Standard deviations of x, y (and z) of the LiDAR [m] as the measurements show them at the
        end; those of the configuration where they are not estimated.
    radar_std_estimated : ndarray, shape (3,), or (4,) in space
        Estimated standard deviations of the radar's range [m], bearing (and elevation) [rad] and
        range rate [m/s].
    """

    stamps_ns: NDArray[np.int64]
    states: NDArray[np.float64]
    covariances: NDArray[np.float64]
    innovations: NDArray[np.float64]
    nis: NDArray[np.float64]
    outcomes: NDArray[np.str_]
    lidar_std_estimated: NDArray[np.float64]
    radar_std_estimated: NDArray[np.float64]

    @property
    def accepted(self) -> NDArray[np.bool_]:
        """True for each measurement that was used, (K,)."""
        return np.isin(self.outcomes, ["updated", "started", "restarted", "told"])


def run(
    measurements: Iterable[Measurement] | Measurements, config: FusionConfig | None = None
) -> Run:
    """Filter measurements in the order of their stamps; those of one stamp keep their order.

    Parameters
    ----------
    measurements : iterable of Measurement, or Measurements
    config : FusionConfig, optional

    Returns
    -------
    Run

    Raises
    ------
    ConfigError
        A parameter is outside its range.
    InputError
        Something else than a `Measurement`.

    See Also
    --------
    implausible : whether the measurements are in the expected units and of one target.

    Examples
    --------
    >>> seen = [Measurement(k * 50_000_000, "lidar", [0.1 * k, 2.0]) for k in range(20)]
    >>> result = run(seen, FusionConfig(model="cv"))
    >>> result.states.shape, bool(result.accepted.all())
    ((20, 4), True)
    """
    settings, known = as_config(config, FusionConfig), as_measurements(measurements)
    return _run_of(_core.fusion_run(settings, known._core), known)


def run_batch(
    targets: Iterable[Iterable[Measurement] | Measurements],
    config: FusionConfig | None = None,
    *,
    threads: int = 1,
) -> list[Run]:
    """Run a filter for thousands of targets, or with several noise values, in one call.

    Parameters
    ----------
    targets : iterable of what `run` takes
        `Measurements` are read in place.
    config : FusionConfig, optional
    threads : int
        Threads used, >= 1; results do not depend on it.

    Returns
    -------
    runs : list of Run
        In the order of `targets`.

    Raises
    ------
    ConfigError
        A parameter is outside its range.
    InputError
        Something else than a `Measurement`.
    """
    settings = as_config(config, FusionConfig)
    known = [as_measurements(target) for target in targets]
    runs = _core.fusion_run_batch(settings, [one._core for one in known], threads=threads)
    return [_run_of(arrays, one) for arrays, one in zip(runs, known, strict=True)]


def smooth(
    measurements: Iterable[Measurement] | Measurements,
    config: FusionConfig | None = None,
    *,
    lag: float | None = None,
) -> Run:
    """Run a filter, and let later measurements also correct every state.

    Parameters
    ----------
    measurements : iterable of Measurement, or Measurements
    config : FusionConfig, optional
        Any but model paper and method imm.
    lag : float, optional
        Measurements up to this much later are used [s], as by a filter that may answer so late.
        Default: all.

    Returns
    -------
    Run
        `states` and `covariances` are smoothed, the rest is the filter's. States of the first
        `start_rows` measurements are the filter's, too.

    Raises
    ------
    ConfigError
        A parameter is outside its range, or cannot be smoothed.
    InputError
        Something else than a `Measurement`, or a lag that is negative or not finite.

    Notes
    -----
    Source: Rauch, Tung & Striebel, "Maximum likelihood estimates of linear dynamic systems",
    1965.
    """
    if lag is not None and not 0 <= lag <= MAX_LAG:
        raise InputError(f"lag: expected 0 to {MAX_LAG} s, got {lag}")
    settings = as_config(config, FusionConfig)
    lag_ns = None if lag is None else round(lag * 1e9)
    known = as_measurements(measurements)
    return _run_of(_core.fusion_smooth(settings, known._core, lag_ns=lag_ns), known)


def _run_of(arrays: tuple[NDArray[Any], ...], measurements: Measurements) -> Run:
    stamps, outcomes, states, covariances, innovations, nis, lidar_std, radar_std = arrays
    # A filter has no time before its first state: the core gives the smallest integer, which
    # would be shown as a date or make the run centuries long.
    stamps = np.where(stamps == NO_TIME, np.sort(measurements._stamps_ns), stamps)
    return Run(
        stamps,
        states,
        covariances,
        innovations,
        nis,
        _OUTCOMES[outcomes],
        lidar_std,
        radar_std,
    )
