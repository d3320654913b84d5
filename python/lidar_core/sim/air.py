"""Rain, dust and fog, whose returns belong to no object."""

from collections.abc import Mapping
from typing import Annotated, ClassVar, Literal, TypeAlias

from pydantic import Field

from lidar_core.config import Config
from lidar_core.sim.types import Vector

KOSCHMIEDER = 3.912
"""Extinction times visibility: the logarithm of 2 % (no unit)."""


class Rain(Config):
    """Drops everywhere: a ray ends on the first one that fills enough of its cross-section.

    Drops of 3 mm are seen up to 6.6 m, of 4 mm up to 9.8 m. With ten large drops per cubic metre,
    the default, 3 % of the rays end on drops. The cross-section of a ray is that of an Ouster OS1
    (its data sheet); the required share is a typical value.
    """

    removed: ClassVar[Mapping[str, str]] = {
        "beam_size": "a ray is 9.5 mm wide where it leaves the sensor",
        "beam_divergence": "a ray widens by 3.1 mrad",
        "least_share": "a drop is seen from 1 % of the ray's section",
    }
    kind: Literal["rain"] = "rain"
    density: float = Field(default=10.0, gt=0, le=1e6, description="Drops of that size [1/m^3].")
    drop_size: float = Field(default=0.003, gt=0, le=0.02, description="Diameter of a drop [m].")


class Dust(Config):
    """A ball of dust that drifts and grows; a ray ends in it after a random distance."""

    kind: Literal["dust"] = "dust"
    center: Vector = Field(description="Middle at time 0 [m].")
    velocity: Vector = Field(default=(0, 0, 0), description="Drift [m/s].")
    radius: float = Field(gt=0, le=1000, description="Radius at time 0 [m].")
    growth: float = Field(default=0.0, ge=0, le=100, description="Growth of the radius [m/s].")
    free_path: float = Field(
        default=5.0,
        gt=0,
        le=1e4,
        description="Mean length of a ray in the dust before it ends [m].",
    )


class Fog(Config):
    """Fog everywhere: light fades on its path to a surface and back; droplets nearby scatter some.

    A return that fades below the limit of the sensor is lost; dark and inclined surfaces are lost
    first (`Surface`; a surface without values counts as reflectivity 0.3, hit head-on).
    """

    removed: ClassVar[Mapping[str, str]] = {
        "speckle_range": "droplets give returns up to 6 m away",
    }
    kind: Literal["fog"] = "fog"
    visibility: float = Field(
        gt=0,
        le=1e5,
        description="Distance at which 2 % of the contrast are left (Koschmieder) [m].",
    )
    speckle: float = Field(
        default=0.01,
        ge=0,
        le=100,
        description="Returns of droplets per metre of a ray's path [1/m].",
    )

    @property
    def extinction(self) -> float:
        """Loss of light per metre [1/m]."""
        return KOSCHMIEDER / self.visibility


Particles: TypeAlias = Annotated[Dust | Fog | Rain, Field(discriminator="kind")]
