"""Statistics of a sample, in one form for every error and every time."""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from lidar_core.arrays import as_real
from lidar_core.errors import InputError


@dataclass(frozen=True, slots=True)
class Spread:
    """Statistics of a sample, in its unit.

    Attributes
    ----------
    count : int
        Size of the sample, >= 1.
    mean, std, rmse : float
        Mean; standard deviation about it (divided by the count); root of the mean square.
    p50, p90, p95, p99 : float
        Percentiles, linear between neighbours.
    smallest, largest : float
        Ends of the sample.
    """

    count: int
    mean: float
    std: float
    rmse: float
    p50: float
    p90: float
    p95: float
    p99: float
    smallest: float
    largest: float

    @classmethod
    def of(cls, values: ArrayLike) -> Self | None:
        """Compute statistics of `values` of any shape; None without values.

        Raises
        ------
        InputError
            A value is not finite.

        Examples
        --------
        >>> Spread.of([3.0, 4.0]).mean
        3.5
        """
        sample = as_real(values, name="values").astype(np.float64).reshape(-1)
        if not np.isfinite(sample).all():
            raise InputError("values: expected finite numbers")
        if not sample.size:
            return None
        p50, p90, p95, p99 = np.percentile(sample, [50, 90, 95, 99]).tolist()
        return cls(
            count=sample.size,
            mean=float(sample.mean()),
            std=float(sample.std()),
            rmse=float(np.sqrt(np.mean(sample**2))),
            p50=p50,
            p90=p90,
            p95=p95,
            p99=p99,
            smallest=float(sample.min()),
            largest=float(sample.max()),
        )
