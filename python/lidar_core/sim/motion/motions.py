"""Motions of sensors and targets: given, or random."""

from collections.abc import Mapping
from typing import Annotated, ClassVar, Literal, Self, TypeAlias

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from lidar_core.config import Config
from lidar_core.sim.motion.knots import Knots, from_angles, poses, times_of, upright
from lidar_core.sim.motion.paths import FigureEight, StopAndGo, Swinging, Wandering
from lidar_core.sim.types import Quaternion, Vector


class Hover(Config):
    """Stay at one place."""

    kind: Literal["hover"] = "hover"
    position: Vector = Field(description="Place [m].")
    rotation: Quaternion = Field(
        default=(0, 0, 0, 1), description="Attitude (x, y, z, w) (no unit)."
    )

    def knots(self, seconds: float) -> Knots:
        """Return one pose."""
        return np.zeros(1), poses(np.array([self.position]), np.array([self.rotation]))


class Waypoints(Config):
    """Straight lines between places at given times; at rest before and after."""

    kind: Literal["waypoints"] = "waypoints"
    times: tuple[float, ...] = Field(min_length=1, description="Increasing times [s].")
    positions: tuple[Vector, ...] = Field(min_length=1, description="Places [m].")
    rotations: tuple[Quaternion, ...] = Field(
        default=(), description="Attitudes (x, y, z, w), none for no turns (no unit)."
    )

    @model_validator(mode="after")
    def _lengths_agree(self) -> Self:
        if len(self.positions) != len(self.times):
            raise ValueError("expected as many positions as times")
        if len(self.rotations) not in (0, len(self.times)):
            raise ValueError("expected as many rotations as times, or none")
        if any(after <= before for before, after in zip(self.times, self.times[1:], strict=False)):
            raise ValueError("expected increasing times")
        return self

    def knots(self, seconds: float) -> Knots:
        """Return times and poses of the waypoints."""
        rotations = np.array(self.rotations or [(0, 0, 0, 1)] * len(self.times))
        return np.array(self.times), poses(np.array(self.positions), rotations)


class Circle(Config):
    """A horizontal circle at constant speed, facing ahead."""

    kind: Literal["circle"] = "circle"
    center: Vector = Field(description="Middle [m].")
    radius: float = Field(gt=0, description="Radius [m].")
    speed: float = Field(description="Speed [m/s], < 0 for clockwise.")
    phase: float = Field(default=0.0, description="Angle at the start [rad].")

    def knots(self, seconds: float) -> Knots:
        """Return times and poses along the circle."""
        times = times_of(seconds)
        angle = self.phase + self.speed / self.radius * times
        places = self.radius * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=-1)
        heading = angle + np.copysign(np.pi / 2, self.speed)
        return times, poses(places + np.array(self.center), upright(heading))


TILT_PERIOD = 4.0
"""Period of the tilts [s]."""


class Loop(Config):
    """Two straights along x joined by half circles, at constant speed, turning and tilting."""

    removed: ClassVar[Mapping[str, str]] = {
        "tilt_period": "tilts have a period of 4 s",
    }
    kind: Literal["loop"] = "loop"
    center: Vector = Field(description="Middle [m].")
    straight: float = Field(ge=0, le=1e5, description="Length of a straight [m].")
    radius: float = Field(gt=0, le=1e5, description="Radius of the half circles [m].")
    speed: float = Field(gt=0, le=1000, description="Speed [m/s].")
    start: float = Field(default=0.0, description="Distance along the loop at the start [m].")
    yaw_rate: float = Field(default=0.0, description="Rate of turn [rad/s].")
    tilt_deg: float = Field(default=0.0, ge=0, le=30, description="Largest roll and pitch [deg].")

    def knots(self, seconds: float) -> Knots:
        """Return times and poses along the loop."""
        times = times_of(seconds)
        places = self._places(self.start + self.speed * times) + np.array(self.center)
        swing = 2 * np.pi * times / TILT_PERIOD
        tilt = np.deg2rad(self.tilt_deg)
        roll, pitch = tilt * np.sin(swing), tilt * np.cos(swing)
        half = np.stack([roll, pitch, self.yaw_rate * times]) / 2
        return times, poses(places, from_angles(np.sin(half), np.cos(half)))

    def _places(self, way: NDArray[np.float64]) -> NDArray[np.float64]:
        bend = np.pi * self.radius
        way = np.mod(way, 2 * (self.straight + bend))
        half = self.straight + bend
        back = way >= half
        way = np.where(back, way - half, way)
        angle = np.clip(way - self.straight, 0, None) / self.radius
        x = np.minimum(way, self.straight) - self.straight / 2 + self.radius * np.sin(angle)
        y = -self.radius * np.cos(angle)
        sign = np.where(back, -1.0, 1.0)
        return np.stack([sign * x, sign * y, np.zeros_like(x)], axis=-1)


class TakeOff(Config):
    """Stay on the ground, rise smoothly, then hover."""

    kind: Literal["take_off"] = "take_off"
    position: Vector = Field(description="Place of the centre before the start [m].")
    height: float = Field(gt=0, le=1e4, description="Climb [m].")
    start: float = Field(default=1.0, ge=0, le=3600, description="Time of the start [s].")
    speed: float = Field(
        default=1.0, gt=0, le=1000, description="Largest speed of the climb [m/s]."
    )

    def knots(self, seconds: float) -> Knots:
        """Return times and poses of the climb: height (3 s^2 - 2 s^3) at a share s of its time."""
        times = times_of(seconds)
        duration = 1.5 * self.height / self.speed
        share = np.clip((times - self.start) / duration, 0, 1)
        climb = self.height * (3 - 2 * share) * share**2
        places = np.array(self.position) + climb[:, None] * np.array([0, 0, 1])
        return times, poses(places, upright(0 * times))


class Shuttle(Config):
    """Back and forth between two places, as fast as a speed and an acceleration allow."""

    kind: Literal["shuttle"] = "shuttle"
    start: Vector = Field(description="One end [m].")
    end: Vector = Field(description="Other end [m].")
    speed: float = Field(gt=0, le=1000, description="Largest speed [m/s].")
    acceleration: float = Field(
        gt=0, le=1000, description="Acceleration of starting and stopping [m/s2]."
    )
    pause: float = Field(default=0.0, ge=0, le=3600, description="Rest at either end [s].")
    lead: float = Field(
        default=0.0, ge=0, le=3600, description="Time in motion before the start [s]."
    )

    @model_validator(mode="after")
    def _ends_differ(self) -> Self:
        if self.start == self.end:
            raise ValueError("expected two places")
        return self

    def knots(self, seconds: float) -> Knots:
        """Return times and poses along the line: acceleration, constant speed, deceleration."""
        times = times_of(seconds)
        line = np.array(self.end) - np.array(self.start)
        length = float(np.linalg.norm(line))
        way = self._way(np.mod(times + self.lead, 2 * self.leg(length)), length)
        places = np.array(self.start) + way[:, None] * (line / length)
        return times, poses(places, upright(0 * times))

    def leg(self, length: float) -> float:
        """Time from the departure at one end to the departure at the other [s]."""
        speed = min(self.speed, float(np.sqrt(self.acceleration * length)))
        return length / speed + speed / self.acceleration + self.pause

    def _way(self, clock: NDArray[np.float64], length: float) -> NDArray[np.float64]:
        """Distance from the first end [m], `clock` [s] after leaving it."""
        speed = min(self.speed, float(np.sqrt(self.acceleration * length)))
        leg = self.leg(length)
        is_back = clock >= leg
        clock = np.where(is_back, clock - leg, clock)
        ramp = speed / self.acceleration
        left = np.clip(leg - self.pause - clock, 0, None)  # time to the stop
        speeding = self.acceleration / 2 * np.minimum(clock, ramp) ** 2
        braking = self.acceleration / 2 * np.minimum(left, ramp) ** 2
        steady = speed * np.clip(clock - ramp, 0, None)
        way = np.where(left > ramp, speeding + steady, length - braking)
        return np.where(is_back, length - way, way)


class RandomMotion(Config):
    """A smooth random flight (cubic B-spline) that keeps away from all bodies and other movers."""

    kind: Literal["random"] = "random"
    box_min: Vector = Field(description="Smallest coordinates of the centre [m].")
    box_max: Vector = Field(description="Largest coordinates of the centre [m].")
    speed_max: float = Field(default=4.0, gt=0, le=1000, description="Largest speed [m/s].")
    acceleration_max: float = Field(
        default=3.0, gt=0, le=1000, description="Largest acceleration [m/s2]."
    )
    clearance: float = Field(
        default=1.5,
        ge=0,
        le=1000,
        description="Least distance from surface to surface of anything else [m].",
    )
    sensor_distance: tuple[float, float] | None = Field(
        default=None,
        description="Stay this near to the sensor and, where possible, in its sight [m].",
    )
    sensor_elevation_deg: tuple[float, float] = Field(
        default=(-90.0, 90.0), description="Stay at these elevations, with `sensor_distance` [deg]."
    )


Scripted: TypeAlias = Annotated[
    Circle
    | FigureEight
    | Hover
    | Loop
    | Shuttle
    | StopAndGo
    | Swinging
    | TakeOff
    | Wandering
    | Waypoints,
    Field(discriminator="kind"),
]
Motion: TypeAlias = Annotated[Scripted | RandomMotion, Field(discriminator="kind")]
