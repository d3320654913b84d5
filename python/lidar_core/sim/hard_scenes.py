"""Scenes with difficulties of real sensors: fog, wet, dark, glass, own body, wind, open sky."""

from math import hypot
from typing import Literal, TypeAlias

import numpy as np

from lidar_core.errors import ConfigError, unknown
from lidar_core.sim import surfaces
from lidar_core.sim.air import Fog
from lidar_core.sim.config import Body, Scene, Target
from lidar_core.sim.lidar import LidarModel
from lidar_core.sim.motion.motions import Circle, Hover, Waypoints
from lidar_core.sim.solids.shapes import (
    Box,
    Cylinder,
    Hexacopter,
    Plane,
    Quadcopter,
    Shape,
    Solid,
    Sphere,
    Tree,
)
from lidar_core.sim.surfaces import Surface

Flier: TypeAlias = Literal["sphere", "hexacopter", "quadcopter"]
FLIERS: dict[str, Solid] = {
    "sphere": Sphere(radius=0.325),
    "hexacopter": Hexacopter(radius=0.45),
    "quadcopter": Quadcopter(radius=0.3),
}
HEIGHT = 1.9
"""Height of the LiDAR on a car above the ground [m]."""
ROAD, GAP = 10.0, 20.0
"""Distance from the middle of the road to the houses, and from one house to the next [m]."""


def moving_car(
    seed: int = 0,
    *,
    scans: int = 200,
    sensor: str = "hdl-32e",
    speed: float = 8.0,
    drone: bool = False,
) -> Scene:
    """Make a street with a driving car whose own roof and bonnet are in view.

    With a `drone`, a quadcopter flies some 5 m ahead of the car, slightly higher, in front of the
    sky at the end of the road.
    """
    return _street(seed, scans, sensor, speed, drone=drone)


def fog_street(
    seed: int = 0,
    *,
    scans: int = 200,
    sensor: str = "hdl-32e",
    speed: float = 8.0,
    visibility: float = 60.0,
    drone: bool = False,
) -> Scene:
    """Make the street of `moving_car` in fog: far and dark objects fade, droplets give returns."""
    scene = _street(seed, scans, sensor, speed, drone=drone)
    return scene.model_copy(update={"air": (Fog(visibility=visibility),)})


def dark_street(
    seed: int = 0,
    *,
    scans: int = 200,
    sensor: str = "hdl-32e",
    speed: float = 8.0,
    drone: bool = False,
    fronts: tuple[Surface, ...] = (surfaces.DARK, surfaces.GLASS, surfaces.GLOSSY),
    road: Surface = surfaces.WET,
) -> Scene:
    """Make the street of `moving_car` after rain: wet road, dark, glossy and glass fronts.

    Houses take the surfaces `fronts` in turn.
    """
    return _street(seed, scans, sensor, speed, drone=drone, fronts=fronts, road=road)


def windy_trees(
    seed: int = 0, *, scans: int = 200, sensor: str = "vlp-16", sparse: bool = True
) -> Scene:
    """Make a meadow with trees in wind and no flying objects: few small leaves, or dense crowns."""
    rng = np.random.default_rng([20240607, seed, 3])
    leaves, size = (60, 0.06) if sparse else (900, 0.1)
    trees = []
    for _ in range(12):
        x, y = rng.uniform(4, 22), rng.uniform(-14, 14)
        tree = Tree(
            trunk_height=rng.uniform(3, 5),
            crown_radius=rng.uniform(1.3, 2.2),
            leaves=leaves,
            leaf_radius=size,
            sway=0.25,
            seed=int(rng.integers(2**31)),
        )
        trees.append(_body(tree, (x, y, 0.0), surfaces.LEAVES))
    way = Waypoints(times=(0.0, scans * 0.1), positions=((-4, 0, 1.5), (-4 + 0.2 * scans, 0, 1.5)))
    return Scene(
        bodies=(_body(Plane(), (0, 0, 0), surfaces.ASPHALT), *trees),
        lidar=LidarModel.preset(sensor),
        sensor=Hover(position=(-4.0, 0.0, 1.5)) if scans > 100 else way,
        scans=scans,
    )


def encounter(
    sensor: str, flier: Flier = "quadcopter", seed: int = 0, *, scans: int = 200
) -> Scene:
    """Make a drone that circles within 12 m of a sensor at rest, in front of open sky and houses.

    The LiDAR delivers scans like its driver; for sensors that look ahead the circle lies ahead.

    Raises
    ------
    ConfigError
        There is no such sensor or flier.
    """
    if flier not in FLIERS:
        raise ConfigError(unknown("flier", flier, list(FLIERS)))
    rng = np.random.default_rng([20240607, seed, 4])
    lidar = LidarModel.preset(sensor)
    ahead = getattr(lidar.pattern, "azimuth_half_deg", None) is not None
    azimuth = rng.uniform(-0.2, 0.2) if ahead else rng.uniform(-np.pi, np.pi)
    away, radius = rng.uniform(6.0, 8.0), rng.uniform(1.0, 1.6 if ahead else 3.0)
    low, high = _reach_of(lidar)
    level = float(np.tan(np.clip(rng.uniform(low + 0.3 * (high - low), high), -0.2, 0.5)) * away)
    flight = Circle(
        center=(away * np.cos(azimuth), away * np.sin(azimuth), 1.8 + 0.6 * level),
        radius=radius,
        speed=rng.uniform(0.8, 2.0),
    )
    return Scene(
        bodies=(_body(Plane(), (0, 0, 0), surfaces.ASPHALT), *_houses_around(rng)),
        targets=(Target(shape=FLIERS[flier], motion=flight, surface=surfaces.PLASTIC),),
        lidar=lidar,
        sensor=Hover(position=(0.0, 0.0, 1.8)),
        scans=scans,
    )


def _street(
    seed: int,
    scans: int,
    sensor: str,
    speed: float,
    *,
    drone: bool,
    fronts: tuple[Surface, ...] = (surfaces.CONCRETE,),
    road: Surface = surfaces.ASPHALT,
) -> Scene:
    rng = np.random.default_rng([20240607, seed, 2])
    lidar = LidarModel.preset(sensor)
    seconds = scans / lidar.scan_rate
    length = seconds * speed
    way = Waypoints(times=(0.0, seconds), positions=((0, 0, HEIGHT), (length, 0, HEIGHT)))
    targets: tuple[Target, ...] = ()
    if drone:
        flight = Waypoints(
            times=(0.0, seconds / 2, seconds),
            positions=((4.5, 1, 2.3), (length / 2 + 6, -1, 2.5), (length + 4.5, 1, 2.3)),
        )
        targets = (Target(shape=FLIERS["quadcopter"], motion=flight, surface=surfaces.PLASTIC),)
    return Scene(
        bodies=(_body(Plane(), (0, 0, 0), road), *_sides(rng, length, fronts)),
        targets=targets,
        own_body=CAR,
        lidar=lidar,
        sensor=way,
        scans=scans,
    )


CAR = (
    Body(shape=Box(size=(2.0, 1.4, 0.1)), position=(-0.2, 0.0, -0.5)),
    Body(shape=Box(size=(1.3, 1.6, 0.1)), position=(1.75, 0.0, -0.95)),
    Body(shape=Cylinder(radius=0.03, height=0.4), position=(-0.7, 0.5, -0.25)),
    Body(shape=Box(size=(0.2, 0.2, 0.1)), position=(0.6, 0.0, -0.2)),
)
"""Roof, bonnet, antenna and a housing of a car in the frame of its LiDAR: 0.5 to 2.7 m away."""


def _sides(
    rng: np.random.Generator, length: float, fronts: tuple[Surface, ...]
) -> tuple[Body, ...]:
    """Make houses with gaps of sky, parked cars and trees on both sides of the street."""
    found: list[Body] = []
    for number, x in enumerate(np.arange(-40.0, length + 60.0, GAP).tolist()):
        for side in (-1.0, 1.0):
            wide, high = rng.uniform(6, 11), rng.uniform(3, 9)
            deep = rng.uniform(6, 10)
            y = side * (ROAD + deep / 2)
            front = fronts[(number + int(side > 0)) % len(fronts)]
            found += _house((x, y), (wide, deep, high), front)
            if rng.random() < 0.5:
                paint = surfaces.GLOSSY if rng.random() < 0.5 else surfaces.DARK
                car = Box(size=(4.2, 1.7, 1.4))
                found.append(_body(car, (x + GAP / 2, side * 4.5, 0.7), paint))
            elif rng.random() < 0.5:
                tree = Tree(leaves=250, sway=0.15, seed=int(rng.integers(2**31)))
                found.append(_body(tree, (x + GAP / 2, side * 7.0, 0.0), surfaces.LEAVES))
    return tuple(found)


def _house(
    place: tuple[float, float], size: tuple[float, float, float], front: Surface
) -> list[Body]:
    """Make a block; behind a glass front there is a smaller one, the inner walls of the room."""
    x, y = place
    wide, deep, high = size
    block = _body(Box(size=size), (x, y, high / 2), front)
    if front.clear == 0:
        return [block]
    inner = Box(size=(wide - 2.0, deep - 3.0, high - 0.5))
    return [block, _body(inner, (x, y, (high - 0.5) / 2), surfaces.CONCRETE)]


def _houses_around(rng: np.random.Generator) -> list[Body]:
    """Make houses at 15 to 40 m that leave about half of the horizon free."""
    found = []
    for number in range(7):
        azimuth = 2 * np.pi * (number + rng.uniform(-0.2, 0.2)) / 7
        away = rng.uniform(18, 40)
        wide, high = rng.uniform(6, 12), rng.uniform(4, 12)
        x, y = away * float(np.cos(azimuth)), away * float(np.sin(azimuth))
        if hypot(x, y) - wide > 10.0:
            found.append(_body(Box(size=(wide, wide, high)), (x, y, high / 2), surfaces.CONCRETE))
    return found


def _reach_of(lidar: LidarModel) -> tuple[float, float]:
    """Least and largest elevation of a 3D LiDAR, reduced by a margin of 5 degrees [rad]."""
    pattern = lidar.pattern
    if pattern.kind == "spinning":
        low, high = min(pattern.elevations_deg), max(pattern.elevations_deg)
    elif pattern.kind == "rosette":
        low, high = pattern.elevation_deg
    else:
        raise ConfigError("sensor: expected a 3D LiDAR, got a planar one")
    return float(np.deg2rad(low + 5)), float(np.deg2rad(high - 5))


def _body(shape: Shape, position: tuple[float, float, float], surface: Surface) -> Body:
    return Body(shape=shape, position=position, surface=surface)
