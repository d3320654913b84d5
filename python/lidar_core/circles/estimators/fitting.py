"""Circles fitted to groups of rays."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from lidar_core import _core
from lidar_core.circles.estimators.fit_config import FitConfig, FitMethod
from lidar_core.circles.preprocess import as_scan
from lidar_core.circles.scanner import Scanner
from lidar_core.circles.segmentation import Segments, arrays_of
from lidar_core.config import as_config
from lidar_core.messages import ShortRepr


@dataclass(frozen=True, slots=True, repr=False)
class Circles(ShortRepr):
    """Circles seen in one frame, eq. 11; `np.asarray` gives their parameters.

    Attributes
    ----------
    parameters : ndarray, shape (C, 3), float64
        Centre x, centre y and radius [m].
    covariance : ndarray, shape (C, 3, 3), float64
        Covariance of the parameters [m^2].
    n_hits : ndarray, shape (C,), int64
        Rays that ended on the circle.
    is_fallback : ndarray, shape (C,), bool
        True if no circle within the bounds of the radius explains the rays. The circle is then the
        algebraic fit, with a rough covariance. All false if not given.
    """

    parameters: NDArray[np.float64]
    covariance: NDArray[np.float64]
    n_hits: NDArray[np.int64]
    is_fallback: NDArray[np.bool_] = field(default_factory=lambda: np.empty(0, np.bool_))

    def __post_init__(self) -> None:
        if not len(self.is_fallback):
            object.__setattr__(self, "is_fallback", np.zeros(len(self.parameters), np.bool_))

    def __len__(self) -> int:
        return len(self.parameters)

    def __array__(self, dtype: DTypeLike | None = None, copy: bool | None = None) -> NDArray[Any]:
        if copy:
            return np.array(self.parameters, dtype=dtype)
        return np.asarray(self.parameters, dtype=dtype)


def fit_circles(
    ranges: ArrayLike,
    bearings: ArrayLike,
    segments: Segments,
    *,
    method: FitMethod | None = None,
    range_std: float | None = None,
    config: FitConfig | None = None,
    scanner: Scanner | None = None,
) -> Circles:
    """Fit one circle to each segment of a scan.

    Parameters
    ----------
    ranges : array_like, shape (B,), float
        Range of every ray [m]; +inf is a miss, NaN no information.
    bearings : array_like, shape (B,), float
        Directions of the rays [rad] in the order of the sweep; need not be equally spaced.
    segments : Segments
        Result of `segment` for the same scan.
    method : str, optional
        "ml", "mode", "taubin", "pratt" or "kasa"; none: that of `config`.
    range_std : float, optional
        Standard deviation of a range [m]; none: that of `config`.
    config : FitConfig, optional
        None for the defaults.
    scanner : Scanner, optional
        Scanner whose range limits apply; None for the defaults.

    Returns
    -------
    Circles
        One per segment, in their order.

    Raises
    ------
    InputError
        Wrong shape, dtype or value; a segment with a ray that did not end on anything.
    ConfigError
        `method` or `range_std` is outside its range.

    Notes
    -----
    Source: Sanchez-Lopez et al., eq. 11; Chernov, "Circular and linear regression", 2010, for the
    algebraic fits. Deterministic; releases the GIL.

    Examples
    --------
    >>> from lidar_core.circles import segment
    >>> bearings = np.radians(np.arange(-10, 10.25, 0.25))
    >>> miss = np.sin(bearings) * 4.0  # a circle of 0.3 m at (4, 0)
    >>> root = np.sqrt(np.maximum(0.3**2 - miss**2, 0))
    >>> ranges = np.where(abs(miss) < 0.3, np.cos(bearings) * 4.0 - root, np.inf)
    >>> circles = fit_circles(ranges, bearings, segment(ranges, bearings), method="taubin")
    >>> np.asarray(circles).round(2) + 0.0
    array([[4. , 0. , 0.3]])
    """
    chosen = {"method": method, "range_std": range_std}
    known = {name: value for name, value in chosen.items() if value is not None}
    fit = FitConfig.load(as_config(config, FitConfig).model_dump() | known)
    given = (*as_scan(ranges, bearings), arrays_of(segments))
    return Circles(*_core.fit_circles(*given, config=fit, scanner=as_config(scanner, Scanner)))
