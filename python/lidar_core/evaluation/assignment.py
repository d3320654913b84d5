"""Optimal assignment of estimates to targets, within a gate."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lidar_core.arrays import as_finite_rows, as_real
from lidar_core.errors import InputError


@dataclass(frozen=True, slots=True)
class Matches:
    """Pairs of estimates and targets in one scan.

    Attributes
    ----------
    estimate, target : ndarray, shape (K,), int64
        Rows of the pairs, by ascending estimate.
    distance : ndarray, shape (K,), float64
        Between the two [m].
    nearest : ndarray, shape (E,), float64
        From every estimate to the nearest target [m]; infinite without targets.
    nearest_target : ndarray, shape (E,), int64
        Row of that target; -1 without targets.
    """

    estimate: NDArray[np.int64]
    target: NDArray[np.int64]
    distance: NDArray[np.float64]
    nearest: NDArray[np.float64]
    nearest_target: NDArray[np.int64]


def match(estimates: ArrayLike, targets: ArrayLike, *, gate: float) -> Matches:
    """Pair estimates with targets one to one, by the distance of their centres.

    Parameters
    ----------
    estimates : array_like, shape (E, 3), float64
        Reported positions [m].
    targets : array_like, shape (T, 3), float64
        True positions [m], same frame.
    gate : float
        Largest distance of a pair [m].

    Returns
    -------
    Matches
        As many pairs as possible, and among those the least sum of distances.

    Raises
    ------
    InputError
        Wrong shape or dtype, a number that is not finite, or a gate that is not > 0.

    Examples
    --------
    >>> match([[0, 0, 0], [9, 0, 0]], [[0.2, 0, 0]], gate=1.0).estimate
    array([0])
    """
    return matches_of(distances(estimates, targets), gate=gate)


def distances(estimates: ArrayLike, targets: ArrayLike) -> NDArray[np.float64]:
    """From every estimate to every target [m], shape (E, T)."""
    found = as_finite_rows(estimates, name="estimates", rows=None, shape=(3,))
    true = as_finite_rows(targets, name="targets", rows=None, shape=(3,))
    table: NDArray[np.float64] = np.linalg.norm(found[:, None] - true[None], axis=-1)
    return table


def matches_of(distance: NDArray[np.float64], *, gate: float) -> Matches:
    """Pairs by a table of distances, shape (E, T), as `match` makes them."""
    rows, columns = assign(distance, gate=gate)
    known = distance.shape[1] > 0
    return Matches(
        estimate=rows,
        target=columns,
        distance=distance[rows, columns],
        nearest=distance.min(axis=1, initial=np.inf),
        nearest_target=distance.argmin(axis=1) if known else np.full(len(distance), -1),
    )


def assign(cost: ArrayLike, *, gate: float) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Pair rows and columns of a table of costs, each at most once.

    Parameters
    ----------
    cost : array_like, shape (R, C), float64
        Cost of every pair, >= 0; infinite and NaN never pair.
    gate : float
        Largest cost of a pair, > 0 and finite.

    Returns
    -------
    rows, columns : ndarray, shape (K,), int64
        As many pairs as possible, among those the least sum of costs; by ascending row.

    Raises
    ------
    InputError
        No table, a negative cost, or a gate out of range.

    Notes
    -----
    The time grows with the cube of the size: for the objects of a scan, tens to a few hundred;
    tables of more than 500 rows and columns take seconds.

    Source: shortest augmenting paths, Jonker & Volgenant, "A Shortest Augmenting Path Algorithm
    for Dense and Sparse Linear Assignment Problems", Computing 38, 1987.
    """
    table = as_real(cost, name="cost").astype(np.float64)
    if table.ndim != 2 or (table < 0).any():
        raise InputError(f"cost: expected a table of costs >= 0, got shape {table.shape}")
    if not 0 < gate < np.inf:
        raise InputError(f"gate: expected a finite number > 0, got {gate}")
    allowed = table <= gate
    # Dearer than any change among allowed pairs: as few forbidden ones as possible are taken.
    forbidden = (gate + 1.0) * (min(table.shape) + 1)
    filled = np.where(allowed, table, forbidden)
    columns = _columns(filled) if len(table) <= table.shape[1] else _rows(filled)
    rows = np.flatnonzero(columns >= 0)
    rows = rows[allowed[rows, columns[rows]]]
    return rows.astype(np.int64), columns[rows]


def _rows(cost: NDArray[np.float64]) -> NDArray[np.int64]:
    """Column of every row, or -1, where there are more rows than columns."""
    row_of = _columns(cost.T)
    columns = np.full(len(cost), -1, np.int64)
    columns[row_of] = np.arange(len(row_of))
    return columns


def _columns(cost: NDArray[np.float64]) -> NDArray[np.int64]:
    """Column of every row; every row gets one, so there must be at least as many columns."""
    rows, columns = cost.shape
    row_price, column_price = np.zeros(rows), np.zeros(columns)
    row_of = np.full(columns, -1, np.int64)
    for first in range(rows):
        shortest = np.full(columns, np.inf)
        before = np.full(columns, -1, np.int64)  # column before this one on its path
        is_done = np.zeros(columns, np.bool_)
        row, at, length = first, -1, 0.0
        while row >= 0:
            through = length + cost[row] - row_price[row] - column_price
            is_better = ~is_done & (through < shortest)
            shortest[is_better], before[is_better] = through[is_better], at
            at = int(np.argmin(np.where(is_done, np.inf, shortest)))
            length = float(shortest[at])
            is_done[at] = True
            row = int(row_of[at])
        inner = is_done & (row_of >= 0)
        row_price[first] += length
        row_price[row_of[inner]] += length - shortest[inner]
        column_price[is_done] -= length - shortest[is_done]
        while at >= 0:  # flip the pairs along the path
            previous = int(before[at])
            row_of[at] = first if previous < 0 else row_of[previous]
            at = previous
    found = np.empty(rows, np.int64)
    found[row_of[row_of >= 0]] = np.flatnonzero(row_of >= 0)
    return found
