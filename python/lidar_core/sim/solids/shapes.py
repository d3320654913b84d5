"""Shapes of a scene, and their surfaces in the core."""

from collections.abc import Mapping
from typing import Annotated, ClassVar, Literal, TypeAlias

import numpy as np
from pydantic import Field

from lidar_core._core import SimShape
from lidar_core.config import Config
from lidar_core.sim.solids.meshes import hexacopter_mesh, quadcopter_mesh
from lidar_core.sim.solids.people import Barrel, Length, Person, Placed
from lidar_core.sim.types import Vector

Sway: TypeAlias = tuple[Vector, float, float]
"""Greatest offset [m], swings per second [Hz], angle at time 0 [rad]."""


class Plane(Config):
    """The plane z = 0 of its frame, or a rectangle of it."""

    kind: Literal["plane"] = "plane"
    size: tuple[Length, Length] | None = Field(
        default=None, description="Lengths along x and y [m]; without it the plane has no end."
    )

    def surfaces(self) -> Placed:
        """Return the single surface of the shape, with its position [m]."""
        return [(SimShape.plane(self.size or (float("inf"), float("inf"))), np.zeros(3))]


class Box(Config):
    """A box around the origin of its frame."""

    kind: Literal["box"] = "box"
    size: tuple[Length, Length, Length] = Field(description="Lengths along x, y and z [m].")

    def surfaces(self) -> Placed:
        """Return the single surface of the shape, with its position [m]."""
        return [(SimShape.cuboid(self.size), np.zeros(3))]


class Cylinder(Config):
    """A closed cylinder around the z axis of its frame, its middle at the origin."""

    kind: Literal["cylinder"] = "cylinder"
    radius: Length = Field(description="Radius [m].")
    height: Length | None = Field(
        default=None, description="Length along z [m]; without it the cylinder has no ends."
    )

    def surfaces(self) -> Placed:
        """Return the single surface of the shape, with its position [m]."""
        return [(SimShape.cylinder(self.radius, self.height or float("inf")), np.zeros(3))]


class EllipticCylinder(Config):
    """An elliptic cylinder of infinite length around the z axis of its frame."""

    removed: ClassVar[Mapping[str, str]] = {
        "height": "it has no ends",
    }
    kind: Literal["elliptic_cylinder"] = "elliptic_cylinder"
    half_axes: tuple[Length, Length] = Field(description="Half axes along x and y [m].")

    def surfaces(self) -> Placed:
        """Return the single surface of the shape, with its position [m]."""
        return [(SimShape.elliptic_cylinder(self.half_axes, float("inf")), np.zeros(3))]


class Sphere(Config):
    """A sphere around the origin of its frame."""

    kind: Literal["sphere"] = "sphere"
    radius: Length = Field(description="Radius [m].")

    def surfaces(self) -> Placed:
        """Return the single surface of the shape, with its position [m]."""
        return [(SimShape.sphere(self.radius), np.zeros(3))]


class Mesh(Config):
    """Triangles, seen from both sides."""

    kind: Literal["mesh"] = "mesh"
    vertices: tuple[Vector, ...] = Field(min_length=3, description="Corners [m].")
    faces: tuple[tuple[int, int, int], ...] = Field(
        min_length=1, description="Three indices of vertices each (no unit)."
    )

    def surfaces(self) -> Placed:
        """Return the single surface of the shape, with its position [m]."""
        faces = np.array(self.faces, np.int64).clip(-1, 2**32 - 1).astype(np.uint32)
        return [(SimShape.mesh(np.array(self.vertices, np.float64), faces), np.zeros(3))]


class Hexacopter(Config):
    """A mesh like a drone with six rotors."""

    kind: Literal["hexacopter"] = "hexacopter"
    radius: Length = Field(default=0.325, description="Radius of the sphere around it [m].")

    def surfaces(self) -> Placed:
        """Return the single surface of the shape, with its position [m]."""
        return [(SimShape.mesh(*hexacopter_mesh(self.radius)), np.zeros(3))]


class Quadcopter(Config):
    """A mesh like a drone with four rotors."""

    kind: Literal["quadcopter"] = "quadcopter"
    radius: Length = Field(default=0.25, description="Radius of the sphere around it [m].")

    def surfaces(self) -> Placed:
        """Return the single surface of the shape, with its position [m]."""
        return [(SimShape.mesh(*quadcopter_mesh(self.radius)), np.zeros(3))]


class HeightField(Config):
    """Ground of given heights, its middle at x = y = 0 of its frame."""

    kind: Literal["height_field"] = "height_field"
    heights: tuple[tuple[float, ...], ...] = Field(
        min_length=2, description="Heights [m]: rows along x, entries of a row along y."
    )
    cell: Length = Field(description="Distance of neighbouring heights [m].")

    def surfaces(self) -> Placed:
        """Return the single surface of the shape, with its position [m]."""
        if len({len(row) for row in self.heights}) > 1:
            heights = np.zeros((0, 0))  # refused by the core, with its reason
        else:
            heights = np.array(self.heights, np.float64)
        return [(SimShape.height_field(heights, self.cell), np.zeros(3))]


class Tree(Config):
    """A trunk from the origin of its frame upwards, and a round crown of small spheres."""

    kind: Literal["tree"] = "tree"
    trunk_radius: Length = Field(default=0.2, description="Radius of the trunk [m].")
    trunk_height: Length = Field(
        default=4.0, description="Height of the trunk's top, the crown's middle [m]."
    )
    crown_radius: Length = Field(default=1.8, description="Radius of the crown [m].")
    leaf_radius: Length = Field(default=0.12, description="Radius of a leaf sphere [m].")
    leaves: int = Field(default=300, ge=0, le=100_000, description="Leaf spheres (no unit).")
    seed: int = Field(
        default=0, ge=0, description="Seed of their places and of their sway (no unit)."
    )
    sway: float = Field(
        default=0.0,
        ge=0,
        le=10,
        description="Largest displacement of the outermost leaves to either side in wind [m].",
    )
    sway_rate: float = Field(default=0.5, gt=0, le=100, description="Mean swings per second [Hz].")

    def surfaces(self) -> Placed:
        """Return the surfaces: trunk and leaves."""
        trunk = SimShape.cylinder(self.trunk_radius, self.trunk_height)
        leaf = SimShape.sphere(self.leaf_radius)
        rng = np.random.default_rng(self.seed)
        way = rng.normal(size=(self.leaves, 3))
        way /= np.linalg.norm(way, axis=1, keepdims=True)
        reach = max(self.crown_radius - self.leaf_radius, 0.0)
        way *= reach * np.cbrt(rng.uniform(size=(self.leaves, 1)))  # even in the volume
        middle = np.array([0.0, 0.0, self.trunk_height])
        return [(trunk, 0.5 * middle), *((leaf, middle + step) for step in way)]

    def sways(self) -> list[Sway | None]:
        """Return reach [m], rate [Hz] and phase [rad] of every surface; reach grows outwards."""
        rng = np.random.default_rng([self.seed, 1])
        out = [
            float(np.linalg.norm(place - [0, 0, self.trunk_height]))
            for _, place in self.surfaces()[1:]
        ]
        wind = rng.uniform(0, 2 * np.pi)
        along = np.array([np.cos(wind), np.sin(wind), 0.2])
        swings: list[Sway | None] = [None]
        for reach in out:
            lateral = rng.normal(0, 0.3, 3)
            size = self.sway * reach / self.crown_radius
            rate = self.sway_rate * rng.uniform(0.7, 1.4)
            x, y, z = (size * (along + lateral)).tolist()
            swings.append(((x, y, z), float(rate), float(rng.uniform(0, 2 * np.pi))))
        return swings


Solid: TypeAlias = Annotated[
    Barrel | Box | Cylinder | EllipticCylinder | Hexacopter | Mesh | Person | Quadcopter | Sphere,
    Field(discriminator="kind"),
]
"""Shapes that can move."""

Shape: TypeAlias = Annotated[
    Solid | HeightField | Plane | Tree,
    Field(discriminator="kind"),
]
