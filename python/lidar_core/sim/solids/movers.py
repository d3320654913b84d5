"""Surfaces of moving targets."""

import numpy as np
from numpy.typing import NDArray

from lidar_core._core import SimShape, SimTrajectory
from lidar_core.sim.solids.people import Person, Placed
from lidar_core.sim.solids.shapes import Solid


def reach_of(surfaces: Placed) -> float:
    """Radius of the sphere around the origin of a shape's frame that holds its surfaces [m]."""
    return max(float(np.linalg.norm(place)) + shape.radius for shape, place in surfaces)


def movers_of(
    shape: Solid, way: SimTrajectory, stamps_ns: NDArray[np.int64], seconds: NDArray[np.float64]
) -> list[tuple[SimShape, SimTrajectory]]:
    """Return every surface of a shape with its path, at `stamps_ns`, `seconds` after the start."""
    surfaces = shape.surfaces()
    if len(surfaces) == 1:
        return [(surfaces[0][0], way)]
    frames = way.poses_at(stamps_ns)
    swings = shape.swings() if isinstance(shape, Person) else [None] * len(surfaces)
    movers = []
    for (surface, place), swing in zip(surfaces, swings, strict=True):
        local = np.eye(4)
        local[:3, 3] = place
        poses = frames @ (local if swing is None else swing.places(place, seconds))
        movers.append((surface, SimTrajectory(stamps_ns, np.ascontiguousarray(poses))))
    return movers
