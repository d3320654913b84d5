"""NEES and NIS: agreement of errors with the covariances of a filter."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lidar_core.arrays import as_real
from lidar_core.config import as_config
from lidar_core.errors import InputError, NumericalError
from lidar_core.estimation import chi2_quantile
from lidar_core.evaluation.config import EvaluationConfig

ASYMMETRY = 1e-6
"""Largest asymmetry of a covariance, relative to its largest entry: allows rounding to float32."""


LEAST_RATIO, MOST_RATIO = 0.5, 2.0
"""Ratios of the mean NEES to its degrees of freedom outside of which a warning is given.

Errors are then 0.7 or 1.4 times as large as the covariances state.
"""
FEWEST = 50
"""Smallest number of values for a warning about their mean."""


@dataclass(frozen=True, slots=True)
class Consistency:
    """Normalised squared errors against their chi-square distribution.

    Attributes
    ----------
    degrees : int
        Degrees of freedom: the mean that a consistent filter has.
    count : int
        Values.
    mean : float
        Mean of all values: above `degrees` the covariance is too small, below it too large.
    share_inside : float
        Share of single values inside `band`; a consistent filter has the band's probability.
    band : tuple of float
        Quantiles of one value that leave equal shares below and above.
    n_runs : int
        Independent runs.
    share_of_steps_inside : float
        Share of steps whose mean over the runs is inside the band of that mean. With one run it
        is `share_inside`.
    step_band : tuple of float
        Band of the mean over all runs.
    """

    degrees: int
    count: int
    mean: float
    share_inside: float
    band: tuple[float, float]
    n_runs: int
    share_of_steps_inside: float
    step_band: tuple[float, float]

    @property
    def warning(self) -> str | None:
        """Return a warning about covariances that are too small or too large; None if they fit.

        A mean between half and twice the expected value is acceptable.
        """
        ratio = self.mean / self.degrees
        if self.count < FEWEST or LEAST_RATIO <= ratio <= MOST_RATIO:
            return None
        size, times = "small" if ratio > 1 else "large", ratio**0.5
        told = f"{times:.0f}" if times >= 10 else f"{times:.2g}"
        return (
            f"NEES {self.mean:.2f} where {self.degrees} is right: errors are {told} times"
            f" as large as the covariances say, which are too {size}"
        )


def nees(error: ArrayLike, covariance: ArrayLike) -> NDArray[np.float64]:
    """Squared errors normalised by their covariance: e' P^-1 e.

    With an innovation and its covariance the result is the NIS.

    Parameters
    ----------
    error : array_like, shape (..., D), float64
        Estimate minus truth, or innovations.
    covariance : array_like, shape (..., D, D), float64
        Covariances of the errors, in the squared unit.

    Returns
    -------
    values : ndarray, shape (...), float64
        NEES (no unit); NaN where the error is NaN.

    Raises
    ------
    InputError
        Shapes that do not belong together, or a covariance that is not finite and symmetric.
    NumericalError
        A covariance is not positive definite.

    Notes
    -----
    Source: Bar-Shalom, Li & Kirubarajan, "Estimation with Applications to Tracking and
    Navigation", 2001, eqs. 5.4.2-3 and 5.4.2-6.

    Examples
    --------
    >>> nees([3.0, 0.0], [[9.0, 0.0], [0.0, 4.0]])
    array(1.)
    """
    away = as_real(error, name="error").astype(np.float64)
    spread = as_real(covariance, name="covariance").astype(np.float64)
    if away.ndim < 1 or spread.shape != (*away.shape, away.shape[-1]) or not away.shape[-1]:
        raise InputError(
            f"covariance: expected shape {(*away.shape, *away.shape[-1:])}, got {spread.shape}"
        )
    known = np.isfinite(away).all(axis=-1)
    values, chosen = np.full(away.shape[:-1], np.nan), spread[known]
    if not np.isfinite(chosen).all() or not _are_symmetric(chosen):
        raise InputError("covariance: expected finite symmetric matrices")
    try:
        root = np.linalg.cholesky(chosen)
    except np.linalg.LinAlgError as fault:
        raise NumericalError("covariance: expected positive definite matrices") from fault
    if known.any():
        scaled = np.linalg.solve(root, away[known][..., None])[..., 0]
        values[known] = np.sum(scaled**2, axis=-1)
    return values


def _are_symmetric(matrices: NDArray[np.float64]) -> bool:
    largest = np.abs(matrices).max(axis=(1, 2), initial=0.0)
    skew = np.abs(matrices - matrices.transpose(0, 2, 1)).max(axis=(1, 2), initial=0.0)
    return bool((skew <= ASYMMETRY * largest).all())


def consistency(
    values: ArrayLike, *, degrees: int, config: EvaluationConfig | None = None
) -> Consistency | None:
    """Compare NEES or NIS values with the chi-square distribution.

    Parameters
    ----------
    values : array_like, shape (S,) or (R, S), float64
        One run, or R independent runs, over S steps; NaN where a run has no value.
    degrees : int
        Degrees of freedom: the dimension of the error, >= 1.
    config : EvaluationConfig, optional
        `band`.

    Returns
    -------
    Consistency or None
        None without any value.

    Raises
    ------
    InputError
        Neither one nor two dimensions, or an infinite or negative value.
    ConfigError
        `degrees` out of range.

    Notes
    -----
    Source: Bar-Shalom et al., 2001, sec. 5.4.2: R times the mean over R runs is a chi-square
    variable of R * degrees degrees of freedom.

    Examples
    --------
    >>> consistency([0.1, 3.0, 9.9], degrees=3).share_inside
    0.3333333333333333
    """
    config = as_config(config, EvaluationConfig)
    table = np.atleast_2d(as_real(values, name="values").astype(np.float64))
    if table.ndim != 2:
        raise InputError(f"values: expected shape (S,) or (R, S), got {table.shape}")
    if np.isinf(table).any() or (table < 0).any():
        raise InputError("values: expected finite numbers >= 0, or NaN")
    known = ~np.isnan(table)
    if not known.any():
        return None
    sample, band = table[known], _band(config.band, degrees, 1)
    runs = known.sum(axis=0)
    bands = {int(n): _band(config.band, degrees, int(n)) for n in np.unique(runs[runs > 0])}
    means = np.where(known, table, 0.0).sum(axis=0)[runs > 0] / runs[runs > 0]
    limits = np.array([bands[n] for n in runs[runs > 0].tolist()])
    return Consistency(
        degrees=degrees,
        count=len(sample),
        mean=float(sample.mean()),
        share_inside=float(np.mean((sample >= band[0]) & (sample <= band[1]))),
        band=band,
        n_runs=len(table),
        share_of_steps_inside=float(np.mean((means >= limits[:, 0]) & (means <= limits[:, 1]))),
        step_band=_band(config.band, degrees, len(table)),
    )


def _band(probability: float, degrees: int, runs: int) -> tuple[float, float]:
    """Band that contains the mean of `runs` chi-square values with this probability."""
    tail = (1 - probability) / 2
    low, high = (chi2_quantile(at, degrees=degrees * runs) / runs for at in (tail, 1 - tail))
    return low, high
