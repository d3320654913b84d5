"""Mathematics that filters and their evaluation share."""

from lidar_core import _core

__all__ = ["chi2_quantile"]


def chi2_quantile(probability: float, *, degrees: int) -> float:
    """Quantile of the chi-square distribution for a given probability.

    Parameters
    ----------
    probability : float
        More than 0, less than 1.
    degrees : int
        Degrees of freedom, >= 1.

    Returns
    -------
    value : float

    Raises
    ------
    ConfigError
        `probability` or `degrees` out of range.

    Notes
    -----
    Source: Abramowitz & Stegun, "Handbook of Mathematical Functions", 1964, sec. 6.5 and 26.4.

    Examples
    --------
    >>> round(chi2_quantile(0.95, degrees=3), 3)
    7.815
    """
    return _core.chi2_quantile(probability, degrees=degrees)


def __dir__() -> list[str]:
    return __all__
