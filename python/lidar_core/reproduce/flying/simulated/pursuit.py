"""Closed loops in which the tracks of its own detector steer an observer, sec. V-B."""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from lidar_core.flying import FlyingConfig, FlyingObjectDetector, Tracks
from lidar_core.reproduce.flying.simulated.flights import Seen, is_paper, processed, truth_columns
from lidar_core.reproduce.jobs import Part
from lidar_core.sim import NoisyPoses, SimulatedScan, Simulator, SteeredSensor

Vector: TypeAlias = NDArray[np.float64]
Guide: TypeAlias = Callable[[Vector, "Vector | None"], Vector]
"""From the observer's place and the place of the target, if it is tracked, to the next goal."""
FOLLOW_DISTANCE = 8.0
"""Distance that the follower keeps [m]."""
ATTACK_FROM, ATTACK_TO = 12.0, 2.5
"""The interceptor closes in to the second distance, then draws back to the first [m]."""


def follow(observer: Vector, target: Vector | None) -> Vector:
    """Return a goal at `FOLLOW_DISTANCE` from the target, on the observer's side.

    Without a target, the goal is the observer's own position.
    """
    return observer if target is None else _at_distance(observer, target, FOLLOW_DISTANCE)


@dataclass(slots=True)
class Interceptor:
    """Guide that approaches the target again and again and turns away just before contact.

    Attributes
    ----------
    is_attacking : bool
        True while the observer approaches, false while it withdraws.
    """

    is_attacking: bool = True

    def __call__(self, observer: Vector, target: Vector | None) -> Vector:
        """Return the next goal [m]; without a target, the observer's own position."""
        if target is None:
            self.is_attacking = False
            return observer
        distance = float(np.linalg.norm(target - observer))
        if self.is_attacking and distance < ATTACK_TO:
            self.is_attacking = False
        elif not self.is_attacking and distance > 0.9 * ATTACK_FROM:
            self.is_attacking = True
        return target if self.is_attacking else _at_distance(observer, target, ATTACK_FROM)


def _at_distance(observer: Vector, target: Vector, distance: float) -> Vector:
    """Return the point at `distance` [m] from the target, horizontally towards the observer."""
    away = (observer - target) * (1.0, 1.0, 0.0)
    return np.asarray(target + away * (distance / max(float(np.linalg.norm(away)), 1e-6)))


@dataclass(slots=True)
class Quarry:
    """Choice of the track to follow: one until it ends, then the nearest to its last position."""

    id: int | None = None
    last: Vector | None = field(default=None)

    def choose(self, tracks: Tracks, observer: Vector) -> tuple[Vector, Vector] | None:
        """Choose a track; return its position [m] and velocity [m/s], None without tracks."""
        if not len(tracks):
            return None
        same = np.flatnonzero(tracks.id == self.id)
        around = observer if self.last is None else self.last
        nearest = np.argmin(np.linalg.norm(tracks.position - around, axis=1))
        row = int(same[0] if len(same) else nearest)
        self.id, self.last = int(tracks.id[row]), tracks.position[row]
        return tracks.position[row], tracks.velocity[row]


def pursue(
    simulator: Simulator,
    name: str,
    config: FlyingConfig,
    guide: Guide,
    *,
    scans: int,
    noise: NoisyPoses,
    box: tuple[Vector, Vector],
) -> Part:
    """Fly a closed loop; the columns are those of `flights.fly`.

    A scan steers the flight one scan after its end: the detector needs that time, and `tracks_at`
    predicts over it.
    """
    detector = FlyingObjectDetector(config)
    covariance = None if is_paper(name) else noise.noise.covariance
    period = simulator.scene.lidar.period_ns
    start = simulator.sensor.poses_at(np.array([simulator.scene.start_ns]))[0, :3, 3]
    observer = SteeredSensor(start, stamp_ns=simulator.scene.start_ns)
    seen, quarry = Seen(), Quarry()
    truth: list[SimulatedScan] = []
    plan = deque([(observer.position, np.zeros(3))] * 2)
    for number in range(scans):
        goal, drift = plan.popleft()
        way = observer.fly(goal, goal_velocity=drift, seconds=period * 1e-9)
        made = simulator.scan(number, sensor=way)
        truth.append(made)
        given = noise.observed(made)
        seen.add(number, processed(detector, given, pose_covariance=covariance))
        found = quarry.choose(
            detector.tracks_at(observer.stamp_ns + period).flying, observer.position
        )
        place, velocity = found or (None, np.zeros(3))
        plan.append((np.clip(guide(observer.position, place), *box), velocity))
    columns = truth_columns(simulator, truth)
    return columns | {f"{name}_{key}": value for key, value in seen.columns().items()}
