"""OSPA and GOSPA: distances between two sets of positions, including the number of objects."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lidar_core.errors import ConfigError
from lidar_core.evaluation.matching.assignment import cheapest, distances


@dataclass(frozen=True, slots=True)
class Gospa:
    """GOSPA with alpha = 2, and its parts: distance = (localisation + missed + false)^(1/p).

    Attributes
    ----------
    distance : float
        Distance of the two sets [m].
    localisation, missed, false : float
        Parts of the distance [m^p]: of pairs; c^p/2 per target without estimate; c^p/2 per estimate
        without target.
    """

    distance: float
    localisation: float
    missed: float
    false: float


def ospa(estimates: ArrayLike, targets: ArrayLike, *, cutoff: float, order: float) -> float:
    """Optimal sub-pattern assignment distance of two sets.

    Parameters
    ----------
    estimates : array_like, shape (E, 3), float64
        Reported positions [m].
    targets : array_like, shape (T, 3), float64
        True positions [m], same frame.
    cutoff : float
        c: cost of a missed or false object, and largest cost of a pair [m], > 0.
    order : float
        p >= 1 (no unit).

    Returns
    -------
    distance : float
        Distance of the two sets [m], at most `cutoff`; 0 for two empty sets.

    Raises
    ------
    InputError
        Wrong shape or dtype, or a number that is not finite.
    ConfigError
        `cutoff` or `order` out of range.

    Notes
    -----
    Source: Schuhmacher, Vo & Vo, "A Consistent Metric for Performance Evaluation of Multi-Object
    Filters", IEEE Trans. Signal Processing 56, 2008, eq. 3.

    Examples
    --------
    >>> ospa([[0, 0, 0]], [[0, 0, 0], [9, 0, 0]], cutoff=1.0, order=1.0)
    0.5
    """
    return set_distances(distances(estimates, targets), cutoff=cutoff, order=order)[0]


def gospa(estimates: ArrayLike, targets: ArrayLike, *, cutoff: float, order: float) -> Gospa:
    """Generalised OSPA with alpha = 2: not divided by the size of the sets, so parts add up.

    Parameters and errors are those of `ospa`.

    Notes
    -----
    Source: Rahmathullah, Garcia-Fernandez & Svensson, "Generalized optimal sub-pattern assignment
    metric", FUSION 2017, proposition 1. A pair at the cutoff or beyond is one missed target and
    one false estimate.

    Examples
    --------
    >>> gospa([[0, 0, 0], [5, 0, 0]], [[0.5, 0, 0]], cutoff=1.0, order=2.0).false
    0.5
    """
    return set_distances(distances(estimates, targets), cutoff=cutoff, order=order)[1]


def set_distances(
    distance_of: NDArray[np.float64], *, cutoff: float, order: float
) -> tuple[float, Gospa]:
    """OSPA [m] and GOSPA of a table of distances [m]: both have the same best assignment."""
    cost, size = _costs(distance_of, cutoff, order), max(distance_of.shape)
    near = np.where(distance_of < cutoff, cost, np.inf)  # others cost what no pair costs
    pairs = cheapest(near, gate=cutoff**order, alone=cutoff**order)
    inside = cost[pairs]
    single, localisation = cutoff**order / 2, float(inside.sum())
    together = localisation + (size - len(inside)) * cutoff**order
    missed, false = (single * (count - len(inside)) for count in reversed(cost.shape))
    distance = float((localisation + missed + false) ** (1 / order))
    ospa_distance = float((together / max(size, 1)) ** (1 / order))
    return ospa_distance, Gospa(distance, localisation, missed, false)


def _costs(distance: NDArray[np.float64], cutoff: float, order: float) -> NDArray[np.float64]:
    """min(distance, cutoff)^order of every pair, shape (E, T)."""
    if not 0 < cutoff < np.inf:
        raise ConfigError(f"cutoff: expected a finite number > 0, got {cutoff}")
    if not 1 <= order < np.inf:
        raise ConfigError(f"order: expected a finite number >= 1, got {order}")
    costs: NDArray[np.float64] = np.minimum(distance, cutoff) ** order
    return costs
