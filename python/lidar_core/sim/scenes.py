"""Built-in scenes."""

from math import hypot

import numpy as np

from lidar_core.errors import ConfigError
from lidar_core.sim.config import Body, Scene, Target
from lidar_core.sim.lidar import LidarModel, Spinning
from lidar_core.sim.motions import Loop, RandomMotion, Waypoints
from lidar_core.sim.shapes import Box, Cylinder, Plane, Sphere, Tree

DRONE_RADIUS = 0.325
"""Radius of the sphere that stands for a drone [m]."""


def performance(*, scene: int, seed: int = 20240607) -> Scene:
    """Make the scene that performance figures refer to: 1 from 10 m above ground, 2 from 3 m.

    Boxes and cylinders are drawn in a fixed order, so that other programs can make the same
    scene. The default `seed` gives the scene of the figures, which the benches hold as a table.

    Raises
    ------
    ConfigError
        `scene` is neither 1 nor 2.
    """
    heights = {1: 10.0, 2: 3.0}
    if scene not in heights:
        raise ConfigError(f"scene: expected 1 or 2, got {scene}")
    height, scans = heights[scene], 20
    pattern = Spinning(
        elevations_deg=_fan(22.5, 128), columns=1024, azimuth_start=0.001, azimuth_per_scan=0.05
    )
    return Scene(
        bodies=_street(np.random.default_rng(seed)),
        targets=(
            _drifting((8.0, 5.0, height + 1.5), (0.4, 0.1, 0.05), scans),
            _drifting((-6.0, -12.0, height - 1.0), (-0.2, 0.4, -0.05), scans),
        ),
        lidar=LidarModel(pattern=pattern, snapshot=True, range_min=0.0),
        sensor=_line((-4.887, 0.087, height + 0.061), (0.5, 0.0, 0.0), scans),
        scans=scans,
    )


def demo(seed: int = 0, *, scans: int = 60) -> Scene:
    """Make a street with houses, poles, trees and two drones, and a sensor that flies a loop in it.

    Every seed has its own street; the flights of the drones depend on the seed given to
    `simulate`.
    """
    rng = np.random.default_rng([20240607, seed])
    return Scene(
        bodies=_street(rng) + _trees(rng, count=10),
        targets=(_drone(), _drone()),
        lidar=LidarModel.preset("os1-128"),
        sensor=Loop(
            center=(0.0, 0.0, 3.0),
            straight=8.0,
            radius=2.0,
            speed=3.0,
            start=float(rng.uniform(0, 28)),
            yaw_rate=0.2,
            tilt_deg=2.0,
        ),
        scans=scans,
    )


def _drone() -> Target:
    return Target(
        shape=Sphere(radius=DRONE_RADIUS),
        motion=RandomMotion(
            box_min=(-24.0, -24.0, 1.9),
            box_max=(24.0, 24.0, 10.0),
            sensor_distance=(5.0, 20.0),
            sensor_elevation_deg=(-19.0, 19.0),
        ),
    )


def _street(rng: np.random.Generator) -> tuple[Body, ...]:
    """Ground, 15 houses and 15 poles, clear of the middle of the street."""
    bodies = [Body(shape=Plane(size=(100.0, 100.0)))]
    while len(bodies) < 16:
        size_x, size_y, height = rng.uniform(4, 12), rng.uniform(4, 12), rng.uniform(6, 22)
        x, y = rng.uniform(-42, 42), rng.uniform(-42, 42)
        if _is_clear(x, y, hypot(size_x, size_y) / 2):
            house = Box(size=(size_x, size_y, height))
            bodies.append(Body(shape=house, position=(x, y, height / 2)))
    while len(bodies) < 31:
        radius, height = rng.uniform(0.3, 1.5), rng.uniform(8, 18)
        x, y = rng.uniform(-30, 30), rng.uniform(-30, 30)
        if _is_clear(x, y, radius):
            pole = Cylinder(radius=radius, height=height)
            bodies.append(Body(shape=pole, position=(x, y, height / 2)))
    return tuple(bodies)


def _trees(rng: np.random.Generator, *, count: int) -> tuple[Body, ...]:
    trees: list[Body] = []
    while len(trees) < count:
        crown = rng.uniform(1.2, 2.2)
        x, y = rng.uniform(-25, 25), rng.uniform(-25, 25)
        if _is_clear(x, y, crown):
            tree = Tree(
                trunk_radius=rng.uniform(0.12, 0.3),
                trunk_height=rng.uniform(3.0, 5.0),
                crown_radius=crown,
                leaves=round(60 * crown**3),
                seed=int(rng.integers(2**31)),
            )
            trees.append(Body(shape=tree, position=(x, y, 0.0)))
    return tuple(trees)


def _is_clear(x: float, y: float, radius: float) -> bool:
    return hypot(max(abs(x) - 5.5, 0), y) > radius + 4


def _fan(half: float, rows: int) -> tuple[float, ...]:
    return tuple(np.linspace(half, -half, rows).tolist())


def _line(
    start: tuple[float, float, float], step: tuple[float, float, float], scans: int
) -> Waypoints:
    """Make a straight way at `step` metres per scan of 0.1 s."""
    x, y, z = (a + scans * b for a, b in zip(start, step, strict=True))
    return Waypoints(times=(0.0, scans * 0.1), positions=(start, (x, y, z)))


def _drifting(
    start: tuple[float, float, float], step: tuple[float, float, float], scans: int
) -> Target:
    return Target(shape=Sphere(radius=DRONE_RADIUS), motion=_line(start, step, scans))
