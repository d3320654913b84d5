"""Simulated targets that cross a square among clutter, and which of them a tracker finds."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lidar_core.evaluation.matching.assignment import cheapest
from lidar_core.fusion import Measurement, MultiTargetConfig, MultiTargetTracker, TargetTracks

STEP_NS = 200_000_000
SCANS = 100
SIDE = 40.0
"""Edge of the square [m]."""
NOISE = 0.15
"""Standard deviation of the sensor's x and y [m]: that of the default filter."""
SPEEDS = (0.5, 2.0)
"""Of targets at first [m/s]."""
UNREST = 0.09
"""Power of the white noise that accelerates them [m^2/s^3]."""
SETTLED = 6
"""Scans of the first 1.1 s, which do not count."""
FAR = 1e6
"""More than any distance in the square [m]."""


@dataclass(frozen=True, slots=True)
class Moment:
    """One scan: true positions of the targets (N, 2) [m], and measurements (M, 2) [m]."""

    stamp_ns: int
    truth: NDArray[np.float64]
    places: NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Arena:
    """Targets, clutter and sensor of a scene.

    Attributes
    ----------
    clutter : float
        Mean number of false measurements of a scan.
    detection : float
        Probability that a scan measures a target.
    lifetime : float or None
        Mean time for which a target stays; others appear meanwhile [s]. None: always the same ones.
    count : int
        Targets at first.
    """

    clutter: float
    detection: float
    lifetime: float | None = None
    count: int = 8

    def moments(self, rng: np.random.Generator) -> Iterator[Moment]:
        """Yield the scans of one run."""
        live = self._all_inside(rng) if self.lifetime is None else self._new(self.count, rng)
        for number in range(SCANS):
            states = live[number] if self.lifetime is None else live
            place = states[:, :2]
            seen = place[rng.random(len(place)) < self.detection]
            seen = seen + rng.normal(0.0, NOISE, seen.shape)
            stray = rng.uniform(-SIDE / 2, SIDE / 2, (rng.poisson(self.clutter), 2))
            yield Moment(number * STEP_NS, place, rng.permutation(np.vstack([seen, stray])))
            if self.lifetime is not None:
                live = self._passed(live, rng)

    def _new(self, count: int, rng: np.random.Generator) -> NDArray[np.float64]:
        """Draw states x, y [m], vx, vy [m/s] of new targets, (count, 4)."""
        speed, heading = rng.uniform(*SPEEDS, count), rng.uniform(-np.pi, np.pi, count)
        velocity = speed * np.stack([np.cos(heading), np.sin(heading)])
        return np.hstack([rng.uniform(-SIDE / 2, SIDE / 2, (count, 2)), velocity.T])

    def _all_inside(self, rng: np.random.Generator) -> NDArray[np.float64]:
        """States (SCANS, N, 4) of targets that never leave the square."""
        kept: list[NDArray[np.float64]] = []
        while len(kept) < self.count:
            way = [self._new(1, rng)]
            while len(way) < SCANS and np.abs(way[-1][:, :2]).max() < SIDE / 2:
                way.append(moved(way[-1], rng))
            if len(way) == SCANS:
                kept.append(np.array(way)[:, 0])
        return np.stack(kept, axis=1)

    def _passed(self, states: NDArray[np.float64], rng: np.random.Generator) -> NDArray[np.float64]:
        """Return the states one step later: targets end, leave the square, and new ones appear."""
        dt, lifetime = STEP_NS * 1e-9, self.lifetime or np.inf
        later = moved(states, rng)
        stays = rng.random(len(later)) < np.exp(-dt / lifetime)
        stays &= (np.abs(later[:, :2]) < SIDE / 2).all(axis=1)
        return np.vstack([later[stays], self._new(rng.poisson(self.count * dt / lifetime), rng)])


def moved(states: NDArray[np.float64], rng: np.random.Generator) -> NDArray[np.float64]:
    """States one step later, accelerated by white noise."""
    dt = STEP_NS * 1e-9
    power = UNREST * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
    push = np.einsum("ij,njk->nik", np.linalg.cholesky(power), rng.normal(size=(len(states), 2, 2)))
    velocity = states[:, 2:]
    return np.hstack([states[:, :2] + dt * velocity + push[:, 0], velocity + push[:, 1]])


def followed(
    arena: Arena, config: MultiTargetConfig, rng: np.random.Generator
) -> Iterator[tuple[Moment, TargetTracks]]:
    """Yield settled scans with every hypothesis of a tracker, reported or not."""
    tracker = MultiTargetTracker(config)
    for number, moment in enumerate(arena.moments(rng)):
        scan = [Measurement(moment.stamp_ns, "lidar", place) for place in moment.places]
        tracker.process(moment.stamp_ns, scan, source="lidar")
        if number >= SETTLED:
            yield moment, tracker.tracks_at(moment.stamp_ns, confirmed=False)


def are_matched(
    places: NDArray[np.float64], reach: NDArray[np.float64], truth: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Return which places have their own target within reach; as many as possible are paired."""
    away = np.linalg.norm(places[:, None] - truth[None], axis=2)
    matched = np.zeros(len(places), np.bool_)
    rows, _ = cheapest(np.where(away <= reach[:, None], away, np.inf), gate=FAR, alone=FAR)
    matched[rows] = True
    return matched
