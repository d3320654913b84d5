"""A scene: static bodies, moving targets and the sensor; read from TOML."""

from collections.abc import Mapping
from typing import ClassVar, Self

from pydantic import Field, model_validator

from lidar_core.config import Config
from lidar_core.sim.air import Particles
from lidar_core.sim.lidar import LidarModel
from lidar_core.sim.motion.motions import Hover, Motion, Scripted
from lidar_core.sim.solids.shapes import Shape, Solid
from lidar_core.sim.surfaces import Surface
from lidar_core.sim.types import Quaternion, Vector


class Body(Config):
    """A shape at rest. Its label in the truth is its index in the list of bodies."""

    shape: Shape = Field(description="Surface (see the kinds for units).")
    position: Vector = Field(default=(0, 0, 0), description="Origin of the shape's frame [m].")
    rotation: Quaternion = Field(
        default=(0, 0, 0, 1), description="Attitude (x, y, z, w) (no unit)."
    )
    surface: Surface | None = Field(
        default=None,
        description="Reflection of light; none: every ray returns (see there for units).",
    )


class Target(Config):
    """A moving shape. Its label in the truth is the number of bodies plus its index in the list."""

    shape: Solid = Field(description="Surface (see the kinds for units).")
    motion: Motion = Field(description="Motion of the target (see the kinds for units).")
    surface: Surface | None = Field(
        default=None,
        description="Reflection of light; none: every ray returns (see there for units).",
    )
    clutter: bool = Field(
        default=False,
        description="An insect or a bird: it gives returns with its own label, but is not in the"
        " ground truth (no unit).",
    )


class Scene(Config):
    """A world with a sensor, and the number of scans."""

    removed: ClassVar[Mapping[str, str]] = {
        "pose_rate": "there are 100 poses per second",
    }
    bodies: tuple[Body, ...] = Field(default=(), description="Static bodies (see there for units).")
    targets: tuple[Target, ...] = Field(
        default=(), description="Moving targets (see there for units)."
    )
    air: tuple[Particles, ...] = Field(
        default=(), max_length=256, description="Rain, dust and fog (see the kinds for units)."
    )
    own_body: tuple[Body, ...] = Field(
        default=(),
        max_length=64,
        description="Body that carries the sensor, in the sensor's frame (see there for units).",
    )
    lidar: LidarModel = Field(
        default_factory=lambda: LidarModel.preset("os1-128"),
        description="The sensor (see there for units).",
    )
    sensor: Scripted = Field(
        default=Hover(position=(0.0, 0.0, 3.0)),
        description="Motion of the sensor (see the kinds for units).",
    )
    scans: int = Field(
        default=60, ge=1, le=1_000_000, description="Length of the recording [scans]."
    )
    start_ns: int = Field(default=0, ge=0, le=2**62, description="Start of the first scan [ns].")

    def idealised(self) -> Self:
        """Return the same scene in clear air, where every surface returns and all rays are known.

        Rays without return in its scans hit nothing: with the same seed they show which missing
        returns of this scene are sky.
        """
        return self.model_copy(
            update={
                "lidar": self.lidar.model_copy(update={"ideal": True, "dropout": 0.0}),
                "bodies": tuple(one.model_copy(update={"surface": None}) for one in self.bodies),
                "targets": tuple(one.model_copy(update={"surface": None}) for one in self.targets),
                "air": (),
            }
        )

    @model_validator(mode="after")
    def _random_motions_need_room(self) -> Self:
        for index, target in enumerate(self.targets):
            if target.motion.kind == "random":
                low, high = target.motion.box_min, target.motion.box_max
                if any(a > b for a, b in zip(low, high, strict=True)):
                    raise ValueError(f"targets.{index}.motion: expected box_min <= box_max")
        return self
