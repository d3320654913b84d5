"""A filter over a whole recording."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lidar_core import _core
from lidar_core.config import as_config
from lidar_core.errors import InputError
from lidar_core.fusion.config import FusionConfig
from lidar_core.fusion.measurement import Measurement

_OUTCOMES = np.array(_core.fusion_outcomes())


@dataclass(frozen=True, slots=True)
class Run:
    """What a filter said, one row per measurement in the order of their stamps.

    Attributes
    ----------
    stamps_ns : ndarray, shape (K,), int64
        Times of the states [ns].
    states : ndarray, shape (K, n)
        Means after the measurement; NaN before the target has been seen.
    covariances : ndarray, shape (K, n, n)
        Their covariances.
    innovations : ndarray, shape (K, 3)
        Measured minus expected; NaN beyond the values that were compared.
    nis : ndarray, shape (K,)
        Normalised innovation squared; NaN where nothing was compared.
    outcomes : ndarray, shape (K,), str
        As `FusionStep.outcome`.
    """

    stamps_ns: NDArray[np.int64]
    states: NDArray[np.float64]
    covariances: NDArray[np.float64]
    innovations: NDArray[np.float64]
    nis: NDArray[np.float64]
    outcomes: NDArray[np.str_]

    @property
    def accepted(self) -> NDArray[np.bool_]:
        """Whether each measurement was used, (K,)."""
        return np.isin(self.outcomes, ["updated", "started", "restarted", "told"])


def run(measurements: Iterable[Measurement], config: FusionConfig | None = None) -> Run:
    """Filter measurements in the order of their stamps; those of one stamp keep their order.

    Parameters
    ----------
    measurements : iterable of Measurement
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

    Examples
    --------
    >>> seen = [Measurement(k * 50_000_000, "lidar", [0.1 * k, 2.0]) for k in range(20)]
    >>> result = run(seen, FusionConfig(model="cv"))
    >>> result.states.shape, bool(result.accepted.all())
    ((20, 4), True)
    """
    listed = list(measurements)
    for number, measurement in enumerate(listed):
        if not isinstance(measurement, Measurement):
            raise InputError(
                f"measurements[{number}]: expected a Measurement, got {type(measurement).__name__}"
            )
    settings = as_config(config, FusionConfig)
    arrays = _core.fusion_run(settings, [m._core for m in listed])
    stamps, outcomes, states, covariances, innovations, nis = arrays
    return Run(stamps, states, covariances, innovations, nis, _OUTCOMES[outcomes])
