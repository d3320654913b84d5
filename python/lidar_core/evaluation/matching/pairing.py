"""Assignment of estimates to targets over all scans, and selection of the rows that count."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from lidar_core.arrays import as_finite_rows, as_mask, as_rows
from lidar_core.config import as_config
from lidar_core.errors import InputError
from lidar_core.evaluation.config import EvaluationConfig
from lidar_core.evaluation.matching.assignment import matches_of
from lidar_core.evaluation.types import Estimates, Truth

Rows = NDArray[np.int64]
TableT = TypeVar("TableT", Truth, Estimates)


@dataclass(frozen=True, slots=True)
class Pairing:
    """Pairs of all scans, as row indices of the two tables.

    Attributes
    ----------
    target_of : ndarray, shape (E,), int64
        Row of the truth that every estimate was paired with; -1 for none.
    estimate_of : ndarray, shape (R,), int64
        Row of the estimate of each target; -1 without one.
    nearest : ndarray, shape (E,), float64
        Distance of every estimate to the nearest target of its scan [m]; infinite without targets.
    nearest_target : ndarray, shape (E,), int64
        Row of that target; -1 without targets.
    found : ndarray, shape (K,), int64
        Rows of the targets that were required and found, by time.
    """

    target_of: Rows
    estimate_of: Rows
    nearest: NDArray[np.float64]
    nearest_target: Rows
    found: Rows


def pair(estimates: Estimates, truth: Truth, *, config: EvaluationConfig | None = None) -> Pairing:
    """Pair estimates and targets scan by scan; the assignment is optimal within the gate.

    All targets are paired, including those that need not be found. If `time_ns` and velocities are
    known, each target is where it was at the time of measurement. Use the rows to group errors by
    any value that the tables or the caller have: speed, acceleration, distance (`binned`).

    Raises
    ------
    InputError
        Tables whose columns differ in length, with an object twice at one time, or with a number
        that is not finite.

    Examples
    --------
    >>> stamps = np.zeros(1, np.int64)
    >>> truth = Truth(stamps, np.array([7]), np.zeros((1, 3)), np.ones(1, bool))
    >>> pair(Estimates(stamps, np.array([[0.1, 0, 0]])), truth).target_of
    array([0])
    """
    gate = as_config(config, EvaluationConfig).gate
    estimates, truth = checked_estimates(estimates), checked_truth(truth)
    size, known = len(estimates.stamp_ns), len(truth.stamp_ns)
    target_of, estimate_of = np.full(size, -1), np.full(known, -1)
    nearest, nearest_target = np.full(size, np.inf), np.full(size, -1)
    for here, there in scans(estimates, truth):
        matches = matches_of(distances_at(estimates, here, truth, there), gate=gate)
        target_of[here[matches.estimate]] = there[matches.target]
        estimate_of[there[matches.target]] = here[matches.estimate]
        nearest[here] = matches.nearest
        if len(there):
            nearest_target[here] = there[matches.nearest_target]
    found = np.flatnonzero(truth.is_eligible & (estimate_of >= 0))
    order = np.argsort(truth.stamp_ns[found], kind="stable")
    return Pairing(target_of, estimate_of, nearest, nearest_target, found[order])


def counted(
    estimates: Estimates, truth: Truth, *, config: EvaluationConfig | None = None
) -> tuple[Estimates, Truth]:
    """Return the rows that count: required targets, and estimates of no other target.

    An estimate is left out if it is paired with a target that is not required. It is also left out
    if it has no partner and the nearest target within the gate is not required.
    """
    config = as_config(config, EvaluationConfig)
    pairing = pair(estimates, truth, config=config)
    is_eligible = checked_truth(truth).is_eligible
    counts = counting(pairing, is_eligible, config.gate)
    return rows_of(estimates, counts), rows_of(truth, is_eligible)


def counting(pairing: Pairing, is_eligible: NDArray[np.bool_], gate: float) -> NDArray[np.bool_]:
    """Return which estimates `counted` keeps, shape (E,)."""
    is_near = (pairing.target_of < 0) & (pairing.nearest <= gate)
    partner = np.where(is_near, pairing.nearest_target, pairing.target_of)
    counts: NDArray[np.bool_] = partner < 0
    counts[~counts] = is_eligible[partner[~counts]]
    return counts


def scans(estimates: Estimates, truth: Truth) -> Iterator[tuple[Rows, Rows]]:
    """Yield the rows of the estimates and of the truth of every scan, by time."""
    stamps = np.union1d(estimates.stamp_ns, truth.stamp_ns)
    yield from zip(
        _rows_at(estimates.stamp_ns, stamps), _rows_at(truth.stamp_ns, stamps), strict=True
    )


def distances_at(
    estimates: Estimates, here: Rows, truth: Truth, there: Rows
) -> NDArray[np.float64]:
    """Return the distance of every estimate to every target of one scan [m], shape (E, T)."""
    places = _places(truth, there[None], _delays(estimates)[here][:, None])
    away = estimates.position[here][:, None] - places
    table: NDArray[np.float64] = np.linalg.norm(away, axis=-1)
    return table


def errors_of(estimates: Estimates, truth: Truth, pairing: Pairing) -> NDArray[np.float64]:
    """Return estimates minus the required targets that were found [m], shape (K, 3)."""
    partners = pairing.estimate_of[pairing.found]
    places = _places(truth, pairing.found, _delays(estimates)[partners])
    away: NDArray[np.float64] = estimates.position[partners] - places
    return away


def _delays(estimates: Estimates) -> NDArray[np.float64]:
    """Times from the start of the scan to the measurement [s], shape (E,)."""
    if estimates.time_ns is None:
        return np.zeros(len(estimates.stamp_ns))
    delays: NDArray[np.float64] = (estimates.time_ns - estimates.stamp_ns).astype(np.float64)
    return delays * 1e-9


def _places(truth: Truth, rows: Rows, delays: NDArray[np.float64]) -> NDArray[np.float64]:
    """Positions of the targets [m] at times `delays` [s] after the start of the scan."""
    if truth.velocity is None:
        return truth.position[rows]
    return truth.position[rows] + delays[..., None] * truth.velocity[rows]


def rows_of(table: TableT, which: NDArray[np.bool_] | Rows) -> TableT:
    """Return the table with these rows only."""
    values = {name: getattr(table, name) for name in table.__slots__}
    columns: dict[str, Any] = {
        name: one[which] for name, one in values.items() if isinstance(one, np.ndarray)
    }
    return replace(table, **columns)


def numbers_of(tracks: Estimates) -> Rows:
    """Return the track IDs of all rows; raises InputError if the table has none."""
    if tracks.id is None:
        raise InputError("tracks.id: expected the ID of every track, got None")
    return tracks.id


def checked_truth(truth: Truth) -> Truth:
    """The table with columns of the right type; anything else is an InputError."""
    stamps = as_rows(truth.stamp_ns, name="truth.stamp_ns", rows=None, shape=(), dtype=np.int64)
    rows = len(stamps)
    names = as_rows(truth.id, name="truth.id", rows=rows, shape=(), dtype=np.int64)
    _refuse_twice(stamps, names, name="truth.id")
    return Truth(
        stamp_ns=stamps,
        id=names,
        position=as_finite_rows(truth.position, name="truth.position", rows=rows, shape=(3,)),
        is_eligible=as_mask(truth.is_eligible, name="truth.is_eligible", rows=rows),
        velocity=_values(truth.velocity, "truth.velocity", rows, shape=(3,)),
        sensor=None
        if truth.sensor is None
        else as_rows(truth.sensor, name="truth.sensor", rows=rows, shape=(3,), dtype=np.float64),
        radius=_radius(truth.radius, rows),
        is_interpolated=None
        if truth.is_interpolated is None
        else as_mask(truth.is_interpolated, name="truth.is_interpolated", rows=rows),
        n_before=truth.n_before,
        n_after=truth.n_after,
    )


def checked_estimates(estimates: Estimates) -> Estimates:
    """The table with columns of the right type; anything else is an InputError."""
    stamps = as_rows(estimates.stamp_ns, name="stamp_ns", rows=None, shape=(), dtype=np.int64)
    rows, numbers, covariance = len(stamps), estimates.id, estimates.covariance
    times = estimates.time_ns
    if times is not None:
        times = as_rows(times, name="time_ns", rows=rows, shape=(), dtype=np.int64)
    if numbers is not None:
        numbers = as_rows(numbers, name="id", rows=rows, shape=(), dtype=np.int64)
        _refuse_twice(stamps, numbers, name="id")
    if covariance is not None:
        size = next((n for n in (6, 4, 2) if np.shape(covariance)[1:] == (n, n)), 3)
        covariance = as_finite_rows(covariance, name="covariance", rows=rows, shape=(size, size))
    return Estimates(
        stamp_ns=stamps,
        position=as_finite_rows(estimates.position, name="position", rows=rows, shape=(3,)),
        id=numbers,
        velocity=_values(estimates.velocity, "velocity", rows, shape=(3,)),
        covariance=covariance,
        time_ns=times,
        radius=_values(estimates.radius, "radius", rows, shape=()),
    )


def _values(
    values: NDArray[np.float64] | None, name: str, rows: int, *, shape: tuple[int, ...]
) -> NDArray[np.float64] | None:
    if values is None:
        return None
    return as_finite_rows(values, name=name, rows=rows, shape=shape)


def _radius(values: NDArray[np.float64] | None, rows: int) -> NDArray[np.float64] | None:
    """Return checked radii of targets; NaN for targets that are not round, None without radii."""
    if values is None:
        return None
    radius = as_rows(values, name="truth.radius", rows=rows, shape=(), dtype=np.float64)
    as_finite_rows(
        np.nan_to_num(radius, posinf=np.inf, neginf=-np.inf),
        name="truth.radius",
        rows=rows,
        shape=(),
    )
    return radius


def _refuse_twice(stamps: Rows, names: Rows, *, name: str) -> None:
    order = np.lexsort((names, stamps))
    again = np.flatnonzero((np.diff(stamps[order]) == 0) & (np.diff(names[order]) == 0))
    if len(again):
        row = order[again[0]]
        raise InputError(
            f"{name}: expected one row per object and time, got {names[row]} twice"
            f" at {stamps[row]} ns"
        )


def _rows_at(when: Rows, stamps: Rows) -> list[Rows]:
    """Rows of `when` at each of the ascending times `stamps`, in the order of the table."""
    order = np.argsort(when, kind="stable").astype(np.int64)
    cuts = np.searchsorted(when[order], stamps[1:]) if len(stamps) else np.empty(0, np.int64)
    return np.split(order, cuts) if len(stamps) else []
