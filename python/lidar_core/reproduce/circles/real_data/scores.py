"""Scores of a circle map on a recording: static objects, IDs, jumps, a vehicle, people."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from lidar_core.circles import CircleElements
from lidar_core.reproduce.circles.real_data.standing import NEAR, Points

Measure = tuple[str, str, float | None]
"""Name, unit and value."""

FAST = 0.3
"""Standing things that are reported faster are wrong [m/s]."""
STILL = 0.05
"""What is reported slower is reported as standing [m/s]."""
MOSTLY = 0.8
"""Share of the returns of an element that must belong to standing things."""
FEWEST = 3
"""Returns by which an element is judged."""
JUMP, JUMP_SPEED = 1.0, 5.0
"""A number jumps if it moves farther [m], and faster [m/s], between two scans."""
SMALL = 1.0
"""Largest extent of a standing thing that has one number [m]."""
VEHICLE_GATE = 0.5
"""Largest distance of a vehicle's element from its motion-capture origin [m]."""
LOST = 1.0
"""Largest standard deviation of a reported position, in its worst direction [m]."""

PERSON = 0.5
"""Probability above which an element is a person."""
ALIVE = 0.999
"""Time for which a person is reported to count: 1 s, up to the steps of stamps [s]."""


@dataclass(frozen=True, slots=True)
class Seen:
    """A recording, its static objects, and the maps of a pipeline, one per scan.

    Attributes
    ----------
    seconds : ndarray, shape (S,)
        Times of the scans [s].
    points : list of ndarray, shape (K, 2)
        Returns of each scan in the world [m].
    thing : list of ndarray, shape (K,), int64
        Static object of every return; -1 for none.
    maps : list of CircleElements or None
        None where the scan was refused.
    """

    seconds: NDArray[np.float64]
    points: Sequence[Points]
    thing: Sequence[NDArray[np.int64]]
    maps: Sequence[CircleElements | None]

    @property
    def minutes(self) -> float:
        """Length of the recording [min]."""
        return float(self.seconds[-1] - self.seconds[0]) / 60


def standing_measures(seen: Seen) -> list[Measure]:
    """Share of static elements with speed, and IDs per small static object and minute."""
    small = _small_things(seen)
    step = float(np.median(np.diff(seen.seconds))) / 60
    rows = fast = 0
    numbers: dict[int, set[int]] = {}
    sight: dict[int, float] = {}
    for points, thing, found in zip(seen.points, seen.thing, seen.maps, strict=True):
        for one in small.intersection(thing.tolist()):
            sight[one] = sight.get(one, 0.0) + step
        if found is None:
            continue
        speeds = np.linalg.norm(found.velocity, axis=1)
        for row in np.flatnonzero(found.visible):
            reach = found.radius[row] + NEAR
            own = thing[np.linalg.norm(points - found.center[row], axis=1) < reach]
            if len(own) < FEWEST or np.mean(own >= 0) < MOSTLY:
                continue
            rows += 1
            fast += int(speeds[row] > FAST)
            one = int(np.bincount(own[own >= 0]).argmax())
            if one in small:
                numbers.setdefault(one, set()).add(int(found.id[row]))
    count = sum(len(some) for some in numbers.values())
    minutes = sum(max(1.0, sight[one]) for one in numbers)
    return [
        ("standing rows", "1", float(rows)),
        ("standing, reported faster than 0.3 m/s", "1", fast / rows if rows else None),
        ("numbers per standing thing and minute", "1", count / minutes if minutes else None),
    ]


def identity_measures(seen: Seen) -> list[Measure]:
    """Measures of position jumps of an element, and of reported elements without a position."""
    last: dict[int, tuple[float, Points]] = {}
    jumps = lost = 0
    for second, found in zip(seen.seconds.tolist(), seen.maps, strict=True):
        if found is None:
            continue
        worst = np.linalg.eigvalsh(found.covariance[:, :2, :2]).max(axis=1, initial=0.0)
        lost += int((worst > LOST * LOST).sum())
        for number, center in zip(found.id.tolist(), found.center, strict=True):
            if number in last:
                before, place = last[number]
                apart = float(np.linalg.norm(center - place))
                jumps += apart > JUMP and apart > JUMP_SPEED * (second - before)
            last[number] = second, center
    return [
        ("jumps per minute", "1/min", jumps / seen.minutes),
        ("reported with a deviation above 1 m", "1", float(lost)),
        ("numbers", "1", float(len(last))),
    ]


def vehicle_measures(
    seen: Seen, place: NDArray[np.float64], velocity: NDArray[np.float64]
) -> list[Measure]:
    """Errors of the element nearest to a vehicle with known place and velocity (S, 2)."""
    errors, speeds, nees, numbers, still = [], [], [], [], []
    due = np.isfinite(velocity).all(axis=1)
    for number in np.flatnonzero(due):
        found = seen.maps[int(number)]
        if found is None or not len(found):
            continue
        off = found.center - place[number]
        row = int(np.linalg.norm(off, axis=1).argmin())
        if np.linalg.norm(off[row]) > VEHICLE_GATE:
            continue
        errors.append(off[row] @ off[row])
        slip = found.velocity[row] - velocity[number]
        speeds.append(slip @ slip)
        nees.append(off[row] @ np.linalg.solve(found.covariance[row, :2, :2], off[row]))
        numbers.append(int(found.id[row]))
        if np.linalg.norm(velocity[number]) > FAST:
            still.append(np.linalg.norm(found.velocity[row]) < STILL)
    changes = sum(one != other for one, other in pairwise(numbers))
    known = bool(errors)
    return [
        ("vehicle, share of scans", "1", len(errors) / max(1, int(due.sum()))),
        ("vehicle, position rms", "m", float(np.sqrt(np.mean(errors))) if known else None),
        ("vehicle, velocity rms", "m/s", float(np.sqrt(np.mean(speeds))) if known else None),
        ("vehicle, NEES of the position (2)", "1", float(np.mean(nees)) if known else None),
        ("vehicle, changes of number", "1", float(changes) if known else None),
        ("vehicle above 0.3 m/s, reported standing", "1", float(np.mean(still)) if still else None),
    ]


def people_measures(seen: Seen, persons: int) -> list[Measure]:
    """Count elements that moved more than 1 m, and persons; `persons` is the true number."""
    paths: dict[int, list[Points]] = {}
    step = float(np.median(np.diff(seen.seconds)))
    alive: dict[int, float] = {}
    for found in seen.maps:
        if found is not None:
            for number in found.id[found.person_probability > PERSON].tolist():
                alive[number] = alive.get(number, 0.0) + step
            for number, center in zip(found.id.tolist(), found.center, strict=True):
                paths.setdefault(number, []).append(center)
    moved = [path for path in paths.values() if np.ptp(np.array(path), axis=0).max() > 1.0]
    return [
        ("persons", "1", float(persons)),
        ("numbers that moved 1 m, per person", "1", len(moved) / persons),
        ("reported as persons for 1 s", "1", float(sum(time >= ALIVE for time in alive.values()))),
    ]


def _small_things(seen: Seen) -> set[int]:
    """Numbers of the static objects with an extent below `SMALL`."""
    low: dict[int, Points] = {}
    high: dict[int, Points] = {}
    for points, thing in zip(seen.points, seen.thing, strict=True):
        for one in np.unique(thing[thing >= 0]).tolist():
            own = points[thing == one]
            low[one] = np.minimum(own.min(axis=0), low.get(one, np.inf))
            high[one] = np.maximum(own.max(axis=0), high.get(one, -np.inf))
    return {one for one, start in low.items() if (high[one] - start).max() < SMALL}
