"""Check of the scans for evidence that a sensor moves although its poses do not change.

Upright structure, such as walls and trunks, keeps its place in the frame of a sensor at rest,
whatever moves beside it. If the sensor moves, one planar motion explains the displacement of all
of this structure. The ground gives no evidence: it looks the same to a sensor that moves along it.
"""

import numpy as np
from numpy.typing import NDArray

EVERY = 2
"""One of so many scans is looked at: more would cost time and say the same."""
NEAREST, FARTHEST, POINTS = 2.5, 40.0, 20_000
"""Points of a scan that are used: their range [m], and their number at most."""
COLUMN, HEIGHT, THIN = 1.0, 0.5, 0.1
COLUMNS = round(2 * FARTHEST / COLUMN) ** 2
"""Edge of a column, least height of what is upright in it, edge of the cells of its points [m],
and the number of columns."""
REFERENCE, COMPARED, LEAST = 2000, 400, 60
"""Points of the scan that others are compared with, points of these, and the fewest of both."""
MET = 0.15
"""Distance within which points are those of the same structure [m]."""
STEPS, FIRST_REACH, LAST_REACH, SHRINKS = 15, 1.0, 0.3, 0.8
"""Steps of the alignment; reach of its pairs [m], which shrinks by a factor in every step."""
HALF, REACH = round((FARTHEST + 5) / THIN), round(FIRST_REACH / THIN)
"""Half the edge of the field of these cells, and how far from a place they know it [cells]."""
MOTION, TURN_REACH, PATIENCE = 0.5, 10.0, 10
"""A verdict is given after this motion, turns counted at this distance [m], or so many scans."""
GAIN, FIT, VERDICTS = 0.2, 0.6, 3
"""A verdict is that the sensor moved if the share of points that meet grows by so much, to so much;
so many verdicts in a row are the evidence.

Measured: a gain of -0.02 to 0.02 with sensors at rest, one of which sways, and of 0.45 to 0.65
with one that drives at 0.5 m/s and turns.
"""


class StandingCheck:
    """Check whether a sensor moves whose poses do not change, scan by scan."""

    def __init__(self) -> None:
        self._seen = self._age = self._verdicts = 0
        self._reference: _Reference | None = None
        self._motion = np.zeros(3)
        self._pose: NDArray[np.float64] | None = None

    @property
    def has_moved(self) -> bool:
        """True once the scans have shown that the sensor moves."""
        return self._verdicts >= VERDICTS

    def state(self) -> list[NDArray[np.float64]]:
        """Return the whole state, for a checkpoint."""
        counts = np.array([self._seen, self._age, self._verdicts], np.float64)
        return [counts, self._motion, *([self._reference.places] if self._reference else [])]

    def restore(self, state: list[NDArray[np.float64]]) -> None:
        """Take over the state of a run that was killed."""
        counts, self._motion, *places = state
        self._seen, self._age, self._verdicts = (int(one) for one in counts)
        self._reference = _Reference(places[0]) if places else None

    def add(self, points: NDArray[np.float32], poses: NDArray[np.float64]) -> None:
        """Add the points (N, 3) of the next scan, in the frame of the sensor, and its poses.

        A sensor whose poses (K, 4, 4) change is not checked.
        """
        self._seen += 1
        self._pose = poses[0] if self._pose is None else self._pose
        if self.has_moved or self._seen % EVERY or (poses != self._pose).any():
            return
        found = _upright(points)
        if len(found) < LEAST:
            return
        if self._reference is None:
            self._start(found)
            return
        compared = found[:COMPARED]
        self._motion = _aligned(self._reference, compared, self._motion)
        self._age += 1
        size = float(np.linalg.norm(self._motion[:2]) + TURN_REACH * abs(self._motion[2]))
        if size < MOTION and self._age < PATIENCE:
            return
        rests = _met(self._reference, compared)
        moves = _met(self._reference, _moved(compared, self._motion))
        is_motion = size >= MOTION and moves >= FIT and moves - rests >= GAIN
        self._verdicts = self._verdicts + 1 if is_motion else 0
        self._start(found)

    def _start(self, found: NDArray[np.float64]) -> None:
        self._reference, self._age = _Reference(found[:REFERENCE]), 0
        self._motion = np.zeros(3)


def _upright(points: NDArray[np.float32]) -> NDArray[np.float64]:
    """Places (N, 2) of upright structure, thinned and in a shuffled order [m]."""
    rows = points.reshape(-1, 3)
    if len(rows) > POINTS:  # drawn, not every so many-th: those would leave out whole rings
        rows = rows[np.random.default_rng(0).integers(0, len(rows), POINTS)]
    rows = np.asarray(rows, np.float64)
    squared = (rows**2).sum(axis=1)  # not a number where there is no return, so not in range
    rows = rows[(squared > NEAREST**2) & (squared < FARTHEST**2)]
    lowest, highest = (np.full(COLUMNS, sign * np.inf) for sign in (1, -1))
    column = _cell(rows, COLUMN)
    np.minimum.at(lowest, column, rows[:, 2])
    np.maximum.at(highest, column, rows[:, 2])
    places = rows[highest[column] - lowest[column] > HEIGHT, :2]
    places = np.random.default_rng(0).permutation(places)
    _, kept = np.unique(_cell(places, THIN), return_index=True)
    return np.asarray(places[np.sort(kept)])


def _cell(rows: NDArray[np.float64], edge: float) -> NDArray[np.int64]:
    """Number of the square of side `edge` [m] that contains each row."""
    x, y = (np.floor(rows[:, axis] / edge).astype(np.int64) for axis in (0, 1))
    half = round(FARTHEST / edge)
    return (x + half) * 2 * half + y + half


def _aligned(
    reference: "_Reference", places: NDArray[np.float64], motion: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Find the motion x, y [m], yaw [rad] that aligns the places with the reference.

    `motion`: initial estimate.

    Source: Besl & McKay, "A Method for Registration of 3-D Shapes", 1992, in the plane.
    """
    for step in range(STEPS):
        near, distance = reference.near(_moved(places, motion))
        used = distance < max(LAST_REACH, FIRST_REACH * SHRINKS**step)
        if used.sum() < LEAST // 2:
            return np.zeros(3)
        ours, theirs = places[used], reference.places[near[used]]
        middle, other = ours.mean(axis=0), theirs.mean(axis=0)
        spread = (ours - middle).T @ (theirs - other)
        yaw = np.arctan2(spread[0, 1] - spread[1, 0], spread[0, 0] + spread[1, 1])
        shift = other - _moved(middle, np.array([0, 0, yaw]))
        before, motion = motion, np.array([*shift, yaw])
        if np.abs(motion - before).max() < 1e-4:
            break
    return motion


def _moved(places: NDArray[np.float64], motion: NDArray[np.float64]) -> NDArray[np.float64]:
    x, y, yaw = motion
    turn = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
    return np.asarray(places @ turn.T + (x, y))


class _Reference:
    """Reference places [m], and a grid with the place that is nearest to each cell.

    A look-up in the grid is much faster than all distances. It gives the nearest place up to an
    error of the size of a cell.
    """

    def __init__(self, places: NDArray[np.float64]) -> None:
        self.places = places
        self._nearest = np.full((2 * HALF, 2 * HALF), -1, np.int32)
        reach = np.arange(-REACH, REACH + 1)
        offsets = np.stack(np.meshgrid(reach, reach), axis=-1).reshape(-1, 2)
        away = (offsets**2).sum(axis=1)
        cells, rows = self._cells(places), np.arange(len(places), dtype=np.int32)
        # The nearest offsets come last: what they write stays.
        for step in offsets[np.argsort(-away, kind="stable")]:
            self._nearest[tuple(np.clip(cells + step, 0, 2 * HALF - 1).T)] = rows

    def near(self, places: NDArray[np.float64]) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
        """Row of the reference place near each place, and its distance [m]; inf if none is near."""
        rows = self._nearest[tuple(np.clip(self._cells(places), 0, 2 * HALF - 1).T)]
        distance = np.linalg.norm(self.places[rows] - places, axis=1)
        return rows, np.where(rows < 0, np.inf, distance)

    @staticmethod
    def _cells(places: NDArray[np.float64]) -> NDArray[np.int64]:
        return np.floor(places / THIN).astype(np.int64) + HALF


def _met(reference: _Reference, places: NDArray[np.float64]) -> float:
    """Share of the places at which the reference has a point."""
    return float((reference.near(places)[1] < MET).mean())
