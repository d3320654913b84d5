"""Statistics over groups: error over distance, recall over speed, and the like."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lidar_core.arrays import as_real, as_rows
from lidar_core.errors import InputError


@dataclass(frozen=True, slots=True)
class Bins:
    """Statistics of a sample in B groups; NaN in groups without values.

    Attributes
    ----------
    edges : ndarray, shape (B + 1,), float64
        Group k contains edges[k] < key <= edges[k + 1]; the first group also its lower edge.
    count : ndarray, shape (B,), int64
        Values in the group.
    mean, std, rmse : ndarray, shape (B,), float64
        Statistics, as in `Spread`.
    """

    edges: NDArray[np.float64]
    count: NDArray[np.int64]
    mean: NDArray[np.float64]
    std: NDArray[np.float64]
    rmse: NDArray[np.float64]


def binned(keys: ArrayLike, values: ArrayLike, *, edges: ArrayLike) -> Bins:
    """Group `values` by `keys` and describe every group.

    Parameters
    ----------
    keys : array_like, shape (N,), float64
        Value to group by, such as distance [m], speed [m/s] or acceleration [m/s^2]; keys that are
        NaN or outside the edges belong to no group.
    values : array_like, shape (N,), float64
        Values to describe, such as an error [m], or 0 and 1 for missed and found: their mean is the
        recall.
    edges : array_like, shape (B + 1,), float64
        Ascending.

    Returns
    -------
    Bins

    Raises
    ------
    InputError
        Shapes that differ, or edges that do not ascend.

    Examples
    --------
    >>> binned([1, 4, 5, 7], [0.1, 0.2, 0.4, 0.9], edges=[0, 5, 10]).mean.round(3)
    array([0.233, 0.9  ])
    """
    limits = as_rows(edges, name="edges", rows=None, shape=(), dtype=np.float64)
    if len(limits) < 2 or not (np.diff(limits) > 0).all():
        raise InputError("edges: expected at least two numbers, ascending")
    sample = as_rows(values, name="values", rows=None, shape=(), dtype=np.float64)
    group = bin_of(as_rows(keys, name="keys", rows=len(sample), shape=(), dtype=float), limits)
    inside, size = group >= 0, len(limits) - 1
    group, sample = group[inside], sample[inside]
    count = np.bincount(group, minlength=size)
    with np.errstate(invalid="ignore"):
        mean = np.bincount(group, sample, size) / count
        square = np.bincount(group, sample**2, size) / count
        variance = np.bincount(group, (sample - mean[group]) ** 2, size) / count
    return Bins(limits, count.astype(np.int64), mean, np.sqrt(variance), np.sqrt(square))


def bin_of(keys: NDArray[np.float64], edges: NDArray[np.float64]) -> NDArray[np.int64]:
    """Group of every key, -1 for none."""
    group = np.searchsorted(edges, keys, side="left") - 1
    group[keys == edges[0]] = 0
    group[~(keys >= edges[0]) | (keys > edges[-1])] = -1
    return group.astype(np.int64)


def norms(vectors: ArrayLike) -> NDArray[np.float64]:
    """Length of every row: speeds of velocities, distances of differences."""
    length: NDArray[np.float64] = np.linalg.norm(as_real(vectors, name="vectors"), axis=-1)
    return length
