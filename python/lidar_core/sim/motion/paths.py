"""Paths in a horizontal plane, and a vehicle that tilts: motions that 2D scanners can observe."""

from collections.abc import Mapping
from typing import ClassVar, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from lidar_core.config import Config
from lidar_core.sim.motion.knots import STEP, Knots, from_angles, poses, times_of, upright
from lidar_core.sim.types import Vector

WANDERING_STEP = 0.005
"""Time between the draws of a wandering velocity [s]."""


class FigureEight(Config):
    """A figure eight around a point: two periods along x during one period along y."""

    kind: Literal["figure_eight"] = "figure_eight"
    center: Vector = Field(description="Middle, where it starts [m].")
    half_size: tuple[float, float] = Field(
        default=(1.25, 2.5), description="Reach along x and y [m]."
    )
    speed: float = Field(gt=0, le=1000, description="Largest speed, in the middle [m/s].")

    def knots(self, seconds: float) -> Knots:
        """Return times and poses; the position is x = a sin 2wt, y = b sin wt from the centre."""
        times = times_of(seconds)
        a, b = self.half_size
        angle = self.speed / float(np.hypot(2 * a, b)) * times
        way = np.stack([a * np.sin(2 * angle), b * np.sin(angle), 0 * angle], axis=-1)
        heading = np.arctan2(b * np.cos(angle), 2 * a * np.cos(2 * angle))
        return times, poses(way + np.array(self.center), upright(heading))

    @model_validator(mode="after")
    def _has_a_size(self) -> Self:
        if self.half_size == (0, 0):
            raise ValueError("expected a half_size that is not zero")
        return self


RAMP = 1.0
"""Time of speeding up, and of braking [s]."""
STEADY, REST = 2.0, 2.0
"""Time at the full velocity, and at rest after a leg [s]."""
LEGS = 2
"""Legs before it turns back."""


class StopAndGo(Config):
    """Legs along a line with a pause after each; after several legs the direction reverses."""

    removed: ClassVar[Mapping[str, str]] = {
        "ramp": "speeding up and braking take 1 s each",
        "steady": "it keeps its velocity for 2 s",
        "rest": "it rests for 2 s after a leg",
        "legs": "it turns back after two legs",
    }
    kind: Literal["stop_and_go"] = "stop_and_go"
    start: Vector = Field(description="Place at the start [m].")
    velocity: Vector = Field(description="Velocity of the steady part of the first leg [m/s].")

    def knots(self, seconds: float) -> Knots:
        """Return times and poses along the line."""
        times = times_of(seconds)
        period = 2 * RAMP + STEADY + REST
        leg = np.floor(times / period)
        clock = times - leg * period
        way = self._way(clock)
        length = RAMP + STEADY  # in seconds at the full velocity
        turn, number = np.divmod(leg, LEGS)
        is_back = turn % 2 == 1
        out = np.where(is_back, (LEGS - number) * length - way, number * length + way)
        places = np.array(self.start) + out[:, None] * np.array(self.velocity)
        heading = np.arctan2(self.velocity[1], self.velocity[0]) + np.pi * is_back
        return times, poses(places, upright(heading))

    def _way(self, clock: NDArray[np.float64]) -> NDArray[np.float64]:
        """Distance within a leg at time `clock` [s], divided by the full speed [s]."""
        left = np.clip(2 * RAMP + STEADY - clock, 0, None)  # time to the stop
        speeding = np.minimum(clock, RAMP) ** 2 / (2 * RAMP)
        braking = np.minimum(left, RAMP) ** 2 / (2 * RAMP)
        going = speeding + np.clip(clock - RAMP, 0, None)
        return np.where(left > RAMP, going, RAMP + STEADY - braking)


WANDERING_TIME = 2.0
"""Correlation time of a wandering velocity [s], as of a person who strolls about."""
LOW, HIGH = (1.5, -4.0), (7.0, 4.0)
"""Corners of the rectangle in which it wanders, in front of a scanner at the origin [m]."""


class Wandering(Config):
    """A random velocity that decays (Ornstein-Uhlenbeck per axis), reflected at a rectangle."""

    removed: ClassVar[Mapping[str, str]] = {
        "time_constant": "the velocity forgets itself within 2 s",
        "low": "the rectangle begins at x = 1.5 m, y = -4 m",
        "high": "the rectangle ends at x = 7 m, y = 4 m",
    }
    kind: Literal["wandering"] = "wandering"
    start: Vector = Field(description="Place at the start [m].")
    speed: float = Field(gt=0, le=1000, description="Root mean square of the speed [m/s].")
    seed: int = Field(default=0, ge=0, description="Seed of the velocity (no unit).")

    @model_validator(mode="after")
    def _starts_inside(self) -> Self:
        inside = zip(LOW, self.start[:2], HIGH, strict=True)
        if not all(low <= value <= high for low, value, high in inside):
            raise ValueError(f"expected a start between {LOW} and {HIGH}")
        return self

    def knots(self, seconds: float) -> Knots:
        """Return times and poses; velocities are drawn every 5 ms and integrated trapezoidally."""
        count = int(np.ceil(seconds / STEP)) * round(STEP / WANDERING_STEP) + 1
        times = np.arange(count, dtype=np.float64) * WANDERING_STEP
        velocity = self._velocity(count)
        steps = (velocity[1:] + velocity[:-1]) * (WANDERING_STEP / 2)
        free = np.vstack([np.zeros(2), np.cumsum(steps, axis=0)]) + self.start[:2]
        places = np.column_stack([self._reflect(free), np.full(count, self.start[2])])
        return times, poses(places, upright(0 * times))

    def _velocity(self, count: int) -> NDArray[np.float64]:
        """Draw velocities (count, 2) [m/s] of the process, which starts at rest."""
        drawn = np.random.default_rng([20240607, self.seed]).normal(size=(count - 1, 2))
        keep = float(np.exp(-WANDERING_STEP / WANDERING_TIME))
        drawn *= np.sqrt(1 - keep**2) * self.speed / np.sqrt(2)
        velocity = np.zeros((count, 2))
        for number, kick in enumerate(drawn):
            velocity[number + 1] = keep * velocity[number] + kick
        return velocity

    def _reflect(self, free: NDArray[np.float64]) -> NDArray[np.float64]:
        """Reflect positions of an unbounded path at the walls of the rectangle."""
        low, side = np.array(LOW), np.subtract(HIGH, LOW)
        folded = np.mod(free - low, 2 * side)
        inside: NDArray[np.float64] = low + np.where(folded > side, 2 * side - folded, folded)
        return inside


REACH_RATE = 0.8
"""Angular rate of the motion along the line [rad/s]."""
PITCH_PERIOD = 4.0
"""Period of the pitch [s]."""
ROLL_PERIOD = 5.0
"""Period of the roll [s]."""
YAW_RATE = 0.5
"""Angular rate of the turn [rad/s]."""


class Swinging(Config):
    """A vehicle near a place: it moves along a line, turns, pitches and rolls, all as sines."""

    removed: ClassVar[Mapping[str, str]] = {
        "reach_rate": "the way swings with 0.8 rad/s",
        "pitch_period": "pitch has a period of 4 s",
        "roll_period": "roll has a period of 5 s",
        "yaw_rate": "the turn swings with 0.5 rad/s",
    }
    kind: Literal["swinging"] = "swinging"
    position: Vector = Field(description="Middle [m].")
    reach: Vector = Field(default=(0.5, 0.0, 0.0), description="Largest distance from it [m].")
    yaw: float = Field(default=0.3, description="Largest turn [rad].")
    pitch_deg: float = Field(default=15.0, ge=0, lt=90, description="Largest pitch [deg].")
    roll_deg: float = Field(default=10.0, ge=0, lt=90, description="Largest roll [deg].")

    def knots(self, seconds: float) -> Knots:
        """Return times and poses Rz(yaw) Ry(pitch) Rx(roll), with zero angles at the start."""
        times = times_of(seconds)
        way = np.sin(REACH_RATE * times)[:, None] * np.array(self.reach)
        roll = np.deg2rad(self.roll_deg) * np.sin(2 * np.pi * times / ROLL_PERIOD)
        pitch = np.deg2rad(self.pitch_deg) * np.sin(2 * np.pi * times / PITCH_PERIOD)
        half = np.stack([roll, pitch, self.yaw * np.sin(YAW_RATE * times)]) / 2
        return times, poses(way + np.array(self.position), from_angles(np.sin(half), np.cos(half)))
