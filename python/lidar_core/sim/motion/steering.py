"""Sensor that is steered while the simulation runs, for closed loops with a detector."""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from lidar_core._core import SimTrajectory
from lidar_core.arrays import as_stamp
from lidar_core.config import Config, as_config
from lidar_core.errors import InputError
from lidar_core.sim.motion.knots import STEP, poses

STIFFNESS = 1.5
"""Natural frequency of the critically damped controller [rad/s]."""


class Steering(Config):
    """Limits of a steered vehicle, and the gains of its controller."""

    removed: ClassVar[Mapping[str, str]] = {
        "stiffness": "the controller has 1.5 rad/s",
    }
    speed_max: float = Field(default=8.0, gt=0, le=1000, description="Largest speed [m/s].")
    acceleration_max: float = Field(
        default=5.0, gt=0, le=1000, description="Largest acceleration [m/s2]."
    )


class SteeredSensor:
    """A level vehicle that flies towards goals, one after the other.

    Parameters
    ----------
    position : array_like, shape (3,), float64
        Position at the start [m], where it hovers.
    stamp_ns : int
        Time of the start [ns].
    steering : Steering, optional
        Limits of the motion.

    Attributes
    ----------
    position, velocity : ndarray, shape (3,), float64
        Position [m] and velocity [m/s] at `stamp_ns`.
    stamp_ns : int
        End of the flight so far [ns].

    Raises
    ------
    InputError
        The place is not three finite numbers.
    """

    def __init__(
        self, position: ArrayLike, *, stamp_ns: int, steering: Steering | None = None
    ) -> None:
        self.position = _vector(position, "position")
        self.velocity = np.zeros(3)
        self.stamp_ns = as_stamp(stamp_ns, name="stamp_ns")
        self.steering = as_config(steering, Steering)

    def fly(
        self, goal: ArrayLike, *, seconds: float, goal_velocity: ArrayLike = (0, 0, 0)
    ) -> SimTrajectory:
        """Fly on towards a goal that moves steadily, and return the path for `Simulator.scan`.

        Parameters
        ----------
        goal, goal_velocity : array_like, shape (3,), float64
            Position to reach [m] and its velocity [m/s], from now on.
        seconds : float
            Duration of the flight [s], > 0; whole steps of 0.01 s.

        Raises
        ------
        InputError
            A vector is not three finite numbers, or the time is not > 0.
        """
        wanted, drift = _vector(goal, "goal"), _vector(goal_velocity, "goal_velocity")
        if not 0 < seconds < 86_400:
            raise InputError(f"seconds: expected > 0 and less than a day, got {seconds}")
        steps = max(1, round(seconds / STEP))
        places = [self.position]
        for number in range(steps):
            self._step(wanted + number * STEP * drift, drift)
            places.append(self.position)
        stamps = self.stamp_ns + np.round(np.arange(steps + 1) * STEP * 1e9).astype(np.int64)
        self.stamp_ns = int(stamps[-1])
        level = np.tile([0.0, 0.0, 0.0, 1.0], (steps + 1, 1))
        return SimTrajectory(stamps, poses(np.array(places), level))

    def _step(self, goal: NDArray[np.float64], drift: NDArray[np.float64]) -> None:
        """Do one step of the controller, within the limits of acceleration and speed."""
        rate = STIFFNESS
        push = rate**2 * (goal - self.position) + 2 * rate * (drift - self.velocity)
        push = _limit(push, self.steering.acceleration_max)
        velocity = _limit(self.velocity + STEP * push, self.steering.speed_max)
        self.position = self.position + STEP / 2 * (self.velocity + velocity)
        self.velocity = velocity


def _limit(vector: NDArray[np.float64], most: float) -> NDArray[np.float64]:
    length = float(np.linalg.norm(vector))
    return vector if length <= most else vector * (most / length)


def _vector(values: ArrayLike, name: str) -> NDArray[np.float64]:
    vector = np.array(values, np.float64)
    if vector.shape != (3,) or not np.isfinite(vector).all():
        raise InputError(f"{name}: expected three finite numbers, got {values!r}")
    return vector
