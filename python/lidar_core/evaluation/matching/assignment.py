"""Optimal assignment of estimates to targets, within a gate."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lidar_core import _core
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
        Distance between the two [m].
    nearest : ndarray, shape (E,), float64
        Distance of every estimate to the nearest target [m]; infinite without targets.
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
        The most pairs that are possible; among such matchings the one with the least sum of
        distances.

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
    """Return the distance of every estimate to every target [m], shape (E, T)."""
    found = as_finite_rows(estimates, name="estimates", rows=None, shape=(3,))
    true = as_finite_rows(targets, name="targets", rows=None, shape=(3,))
    table: NDArray[np.float64] = np.linalg.norm(found[:, None] - true[None], axis=-1)
    return table


def matches_of(distance: NDArray[np.float64], *, gate: float) -> Matches:
    """Pair targets and estimates by a table of distances, shape (E, T), like `match`."""
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
        The most pairs that are possible; among such matchings the one with the least sum of costs;
        by ascending row.

    Raises
    ------
    InputError
        `cost` is no table or has a negative cost, or the gate is out of range.

    Notes
    -----
    A table of 1000 x 1000 costs, all within the gate, takes seconds; the time grows with the cube
    of the size.

    Source: shortest augmenting paths, Jonker & Volgenant, "A Shortest Augmenting Path Algorithm
    for Dense and Sparse Linear Assignment Problems", Computing 38, 1987.
    """
    table = as_real(cost, name="cost").astype(np.float64)
    if table.ndim != 2 or (table < 0).any():
        raise InputError(
            f"cost: expected a 2D array of costs >= 0, got shape {table.shape} or a negative cost"
        )
    if not 0 < gate < np.inf:
        raise InputError(f"gate: expected a finite number > 0, got {gate}")
    # Dearer than any change among allowed pairs: as many of them as possible are taken.
    alone = (gate + 1.0) * (min(table.shape) + 1)
    return cheapest(table, gate=gate, alone=alone)


def cheapest(
    cost: NDArray[np.float64], *, gate: float, alone: float
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Find pairs of at most `gate` with the least sum of costs; a row without pair costs `alone`.

    Returns rows and columns of the pairs, by ascending row.
    """
    columns = _core.assign_columns(np.ascontiguousarray(cost), gate=gate, unassigned=alone)
    rows = np.flatnonzero(columns >= 0)
    return rows, columns[rows]
