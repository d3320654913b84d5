"""Shapes of several surfaces for 2D scanners: people, barrels."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from lidar_core._core import SimShape
from lidar_core.config import Config
from lidar_core.sim.motion.knots import poses

Length: TypeAlias = Annotated[float, Field(gt=0, le=1e5)]
Placed: TypeAlias = list[tuple[SimShape, NDArray[np.float64]]]
"""Surfaces, each with its position in the shape's frame [m]."""


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
        """Poses (K, 4, 4) in the shape's frame of a surface that rests at `place` [m]."""
        angle = self.reach * np.sin(2 * np.pi * self.rate * seconds + self.phase)
        half = np.stack([0 * angle, np.sin(angle / 2), 0 * angle, np.cos(angle / 2)], axis=-1)
        turned = poses(np.tile(self.pivot, (len(angle), 1)), half)
        turned[:, :3, 3] += turned[:, :3, :3] @ (place - self.pivot)
        return turned


TRUNK = (0.24, 0.36)
"""Depth of a trunk along x, and its width without the arms along y [m]."""
NECK_RADIUS = 0.06
"""Radius of a neck [m]."""
ARM_RADIUS = 0.045
"""Radius of an arm [m]."""
ARM_GAP = 0.01
"""Gap between trunk and arm [m]."""
ARM_SWING_DEG = 25.0
"""Greatest angle of an arm [deg]."""
LEG_RADIUS = 0.07
"""Radius of a leg [m]."""
LEG_SWING_DEG = 20.0
"""Greatest angle of a leg [deg]."""


class Person(Config):
    """A person who walks along x, with swinging arms and legs.

    A trunk (elliptic cylinder), a neck, a head, two arms and two legs.
    The origin of the frame is on the ground. Sizes: about the 50th percentile of men.
    """

    removed: ClassVar[Mapping[str, str]] = {
        "arm_radius": "an arm is 9 cm thick",
        "arm_gap": "arms are 1 cm beside the trunk",
        "arm_swing_deg": "arms swing by 25 deg",
        "leg_radius": "a leg is 14 cm thick",
        "leg_swing_deg": "legs swing by 20 deg",
        "depth": "a trunk is 0.24 m deep",
        "width": "a trunk is 0.36 m wide",
    }
    kind: Literal["person"] = "person"
    height: Length = Field(
        default=1.75, description="Height of the top of the head above the ground [m]."
    )
    rate: float = Field(
        default=0.9, gt=0, le=10, description="Swings, two steps each, per second [Hz]."
    )

    def surfaces(self) -> Placed:
        """Return the surfaces: trunk, neck, head, left and right arm, left and right leg."""
        depth, width = TRUNK
        shoulder, hip, head = self._heights()
        arm = width / 2 + ARM_GAP + ARM_RADIUS  # its axis from the middle plane [m]
        arm_length = 0.37 * self.height
        trunk = SimShape.elliptic_cylinder((depth / 2, width / 2), shoulder - hip)
        limb = SimShape.cylinder(ARM_RADIUS, arm_length)
        leg = SimShape.cylinder(LEG_RADIUS, hip)
        hang = shoulder - arm_length / 2
        neck = SimShape.cylinder(NECK_RADIUS, head - shoulder)
        return [
            (trunk, np.array([0, 0, (shoulder + hip) / 2])),
            (neck, np.array([0, 0, (shoulder + head) / 2])),
            (SimShape.sphere(0.065 * self.height), np.array([0, 0, head])),
            (limb, np.array([0, arm, hang])),
            (limb, np.array([0, -arm, hang])),
            (leg, np.array([0, width / 4, hip / 2])),
            (leg, np.array([0, -width / 4, hip / 2])),
        ]

    def swings(self) -> list[Swing | None]:
        """Swing of every surface; arm and leg of one side move in opposite directions."""
        shoulder, hip, _ = self._heights()
        arm, leg = np.deg2rad([ARM_SWING_DEG, LEG_SWING_DEG]).tolist()
        limbs = ((shoulder, arm, 0.0), (shoulder, arm, np.pi), (hip, leg, np.pi), (hip, leg, 0.0))
        moving = [Swing(np.array([0, 0, z]), reach, self.rate, at) for z, reach, at in limbs]
        return [None, None, None, *moving]

    def _heights(self) -> tuple[float, float, float]:
        """Heights of shoulders, hips and the middle of the head [m]."""
        return 0.82 * self.height, 0.5 * self.height, 0.935 * self.height


DRUM_RADIUS = 0.286
"""Radius of a 200 l drum between its hoops [m]."""
HOOP = 0.01
"""How far the hoops stand out [m]."""


class Barrel(Config):
    """A drum with two hoops; the origin of its frame is on the ground. Sizes: a 200 l drum."""

    removed: ClassVar[Mapping[str, str]] = {
        "hoop": "hoops stand out by 1 cm",
        "radius": "a drum has a radius of 0.286 m",
    }
    kind: Literal["barrel"] = "barrel"
    height: Length = Field(default=0.88, description="Height [m].")

    @property
    def radius(self) -> float:
        """Radius between the hoops [m]."""
        return DRUM_RADIUS

    def surfaces(self) -> Placed:
        """Return the surfaces: drum and hoops."""
        drum = SimShape.cylinder(self.radius, self.height)
        hoop = SimShape.cylinder(self.radius + HOOP, 0.04 * self.height)
        up = np.array([0.0, 0.0, self.height])
        return [(drum, up / 2), (hoop, up / 3), (hoop, 2 / 3 * up)]
