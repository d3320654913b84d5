"""Built-in scenes."""

from collections.abc import Callable
from math import hypot
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from lidar_core.arrays import as_rows
from lidar_core.errors import ConfigError, InputError
from lidar_core.sim.config import Body, Scene, Target
from lidar_core.sim.hard_scenes import (
    dark_street,
    encounter,
    fog_street,
    moving_car,
    windy_trees,
)
from lidar_core.sim.lidar import LidarModel, Spinning
from lidar_core.sim.motion.motions import Loop, RandomMotion, Waypoints
from lidar_core.sim.solids.shapes import Box, Cylinder, Plane, Sphere, Tree

__all__ = [
    "DRONE_RADIUS",
    "dark_street",
    "demo",
    "encounter",
    "fog_street",
    "moving_car",
    "performance",
    "street",
    "windy_trees",
]

DRONE_RADIUS = 0.325
"""Radius of the sphere that stands for a drone [m]."""
DRAWS = 20_000
"""Number of places that are tried for houses, poles or trees before an error."""
IsClear: TypeAlias = Callable[[float, float, float], bool]
"""Whether a body of some radius may stand at x, y [m]."""


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
        elevations_deg=tuple(np.linspace(22.5, -22.5, 128).tolist()),
        columns=1024,
        azimuth_start=0.001,
        azimuth_per_scan=0.05,
    )
    return Scene(
        bodies=_street(np.random.default_rng(seed), _is_clear),
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
        bodies=_street(rng, _is_clear) + _trees(rng, _is_clear, count=10),
        targets=(_drone(), _drone()),
        lidar=LidarModel.preset("os1-128", ideal=True),
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


def street(seed: int, *, keep_clear: ArrayLike, clearance: float) -> tuple[Body, ...]:
    """Make a street like that of `demo` around given places: ground, houses, poles and trees.

    Parameters
    ----------
    seed : int
        Seed of sizes and places.
    keep_clear : array_like, shape (N, 2), float64
        Places that only the ground may be near to [m]; many along a path keep it free.
    clearance : float
        Least horizontal distance from them to a house, pole or tree [m].

    Returns
    -------
    bodies : tuple of Body

    Raises
    ------
    InputError
        Wrong shape, or the places leave no room.

    Examples
    --------
    >>> len(street(0, keep_clear=[[0, 0], [5, 5]], clearance=2.0))
    41
    """
    places = as_rows(keep_clear, name="keep_clear", rows=None, shape=(2,), dtype=np.float64)

    def is_clear(x: float, y: float, radius: float) -> bool:
        away = np.hypot(places[:, 0] - x, places[:, 1] - y)
        return bool((away > radius + clearance).all())

    rng = np.random.default_rng([20240607, seed])
    return _street(rng, is_clear) + _trees(rng, is_clear, count=10)


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


def _street(rng: np.random.Generator, is_clear: IsClear) -> tuple[Body, ...]:
    """Make ground, 15 houses and 15 poles, each where it `is_clear`."""
    bodies = [Body(shape=Plane(size=(100.0, 100.0)))]

    def house() -> Body | None:
        size_x, size_y, height = rng.uniform(4, 12), rng.uniform(4, 12), rng.uniform(6, 22)
        x, y = rng.uniform(-42, 42), rng.uniform(-42, 42)
        if not is_clear(x, y, hypot(size_x, size_y) / 2):
            return None
        return Body(shape=Box(size=(size_x, size_y, height)), position=(x, y, height / 2))

    def pole() -> Body | None:
        radius, height = rng.uniform(0.3, 1.5), rng.uniform(8, 18)
        x, y = rng.uniform(-30, 30), rng.uniform(-30, 30)
        if not is_clear(x, y, radius):
            return None
        return Body(shape=Cylinder(radius=radius, height=height), position=(x, y, height / 2))

    return (*bodies, *_several(house, 15), *_several(pole, 15))


def _trees(rng: np.random.Generator, is_clear: IsClear, *, count: int) -> tuple[Body, ...]:
    def tree() -> Body | None:
        crown = rng.uniform(1.2, 2.2)
        x, y = rng.uniform(-25, 25), rng.uniform(-25, 25)
        if not is_clear(x, y, crown):
            return None
        shape = Tree(
            trunk_radius=rng.uniform(0.12, 0.3),
            trunk_height=rng.uniform(3.0, 5.0),
            crown_radius=crown,
            leaves=round(60 * crown**3),
            seed=int(rng.integers(2**31)),
        )
        return Body(shape=shape, position=(x, y, 0.0))

    return _several(tree, count)


def _several(draw: Callable[[], Body | None], count: int) -> tuple[Body, ...]:
    """Call `draw` until it has returned `count` bodies."""
    found: list[Body] = []
    for _ in range(DRAWS):
        if len(found) == count:
            return tuple(found)
        body = draw()
        found += [body] if body is not None else []
    raise InputError("keep_clear: the places leave no room for houses, poles and trees")


def _is_clear(x: float, y: float, radius: float) -> bool:
    return hypot(max(abs(x) - 5.5, 0), y) > radius + 4


def _line(
    start: tuple[float, float, float], step: tuple[float, float, float], scans: int
) -> Waypoints:
    """Make a straight path of `step` [m] per scan of 0.1 s."""
    x, y, z = (a + scans * b for a, b in zip(start, step, strict=True))
    return Waypoints(times=(0.0, scans * 0.1), positions=(start, (x, y, z)))


def _drifting(
    start: tuple[float, float, float], step: tuple[float, float, float], scans: int
) -> Target:
    return Target(shape=Sphere(radius=DRONE_RADIUS), motion=_line(start, step, scans))


def __dir__() -> list[str]:
    return __all__
