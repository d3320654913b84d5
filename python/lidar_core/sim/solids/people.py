"""Shapes of several surfaces that a 2D scanner meets: people, barrels."""

from dataclasses import dataclass
from typing import Annotated, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from lidar_core._core import SimShape
from lidar_core.config import Config
from lidar_core.sim.motion.knots import poses

Length: TypeAlias = Annotated[float, Field(gt=0)]
Placed: TypeAlias = list[tuple[SimShape, NDArray[np.float64]]]
"""Surfaces, and where each is in the shape's frame [m]."""


@dataclass(frozen=True, slots=True)
class Swing:
    """A limb: it swings about a line along y, forwards and backwards.

    Attributes
    ----------
    pivot : ndarray, shape (3,), float64
        A point of that line, frame of the shape [m].
    reach : float
        Greatest angle [rad].
    rate : float
        Swings per second [Hz].
    phase : float
        Angle of the sine at time 0 [rad].
    """

    pivot: NDArray[np.float64]
    reach: float
    rate: float
    phase: float

    def places(
        self, place: NDArray[np.float64], seconds: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Poses (K, 4, 4), frame of the shape, of a surface that rests at `place`."""
        angle = self.reach * np.sin(2 * np.pi * self.rate * seconds + self.phase)
        half = np.stack([0 * angle, np.sin(angle / 2), 0 * angle, np.cos(angle / 2)], axis=-1)
        turned = poses(np.tile(self.pivot, (len(angle), 1)), half)
        turned[:, :3, 3] += turned[:, :3, :3] @ (place - self.pivot)
        return turned


class Person(Config):
    """Somebody who walks along x: a trunk (elliptic cylinder), a head, arms and legs that swing.

    They stand on the origin of their frame. Sizes: about the 50th percentile of men.
    """

    kind: Literal["person"] = "person"
    height: Length = Field(1.75, description="From the ground to the top of the head [m].")
    depth: Length = Field(0.24, description="Of the trunk, along x [m].")
    width: Length = Field(0.36, description="Of the trunk without the arms, along y [m].")
    arm_radius: Length = Field(0.045, description="Radius of an arm [m].")
    arm_gap: float = Field(0.01, ge=0, description="Between trunk and arm [m].")
    arm_swing_deg: float = Field(25.0, ge=0, le=80, description="Greatest angle of an arm [deg].")
    leg_radius: Length = Field(0.07, description="Radius of a leg [m].")
    leg_swing_deg: float = Field(20.0, ge=0, le=80, description="Greatest angle of a leg [deg].")
    rate: float = Field(0.9, gt=0, le=10, description="Swings, two steps each, per second [Hz].")

    def surfaces(self) -> Placed:
        """Trunk, head, left and right arm, left and right leg."""
        shoulder, hip, head = self._heights()
        arm = self.width / 2 + self.arm_gap + self.arm_radius  # its axis from the middle plane [m]
        arm_length = 0.37 * self.height
        trunk = SimShape.elliptic_cylinder((self.depth / 2, self.width / 2), shoulder - hip)
        limb = SimShape.cylinder(self.arm_radius, arm_length)
        leg = SimShape.cylinder(self.leg_radius, hip)
        hang = shoulder - arm_length / 2
        return [
            (trunk, np.array([0, 0, (shoulder + hip) / 2])),
            (SimShape.sphere(0.065 * self.height), np.array([0, 0, head])),
            (limb, np.array([0, arm, hang])),
            (limb, np.array([0, -arm, hang])),
            (leg, np.array([0, self.width / 4, hip / 2])),
            (leg, np.array([0, -self.width / 4, hip / 2])),
        ]

    def swings(self) -> list[Swing | None]:
        """Swing of every surface; arm and leg of one side move in opposite directions."""
        shoulder, hip, _ = self._heights()
        arm, leg = np.deg2rad([self.arm_swing_deg, self.leg_swing_deg]).tolist()
        limbs = ((shoulder, arm, 0.0), (shoulder, arm, np.pi), (hip, leg, np.pi), (hip, leg, 0.0))
        moving = [Swing(np.array([0, 0, z]), reach, self.rate, at) for z, reach, at in limbs]
        return [None, None, *moving]

    def _heights(self) -> tuple[float, float, float]:
        """Heights of shoulders, hips and the middle of the head [m]."""
        return 0.82 * self.height, 0.5 * self.height, 0.935 * self.height


class Barrel(Config):
    """A drum with two hoops; it stands on the origin of its frame. Sizes: a 200 l drum."""

    kind: Literal["barrel"] = "barrel"
    radius: Length = Field(0.286, description="Radius between the hoops [m].")
    height: Length = Field(0.88, description="Height [m].")
    hoop: Length = Field(0.01, description="How far the hoops stand out [m].")

    def surfaces(self) -> Placed:
        """Drum and hoops."""
        drum = SimShape.cylinder(self.radius, self.height)
        hoop = SimShape.cylinder(self.radius + self.hoop, 0.04 * self.height)
        up = np.array([0.0, 0.0, self.height])
        return [(drum, up / 2), (hoop, up / 3), (hoop, 2 / 3 * up)]
