"""Scenes of `flying-situations`: a street, a sensor at rest, and moving objects around it."""

from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from lidar_core import sim
from lidar_core.reproduce.common import scene_rng
from lidar_core.reproduce.flying.situations.shapes import SIZES
from lidar_core.sim import Body, Scene, Target
from lidar_core.sim.air import Particles
from lidar_core.sim.motion.motions import Scripted

HEIGHT = 4.0
"""Of the sensor above the ground [m]."""
ASIDE = 8.0
"""Least distance of a straight pass [m]."""
FAR = 32.0
"""Passes begin and end this far away: beyond the range in which targets are sought [m]."""
PASS_SPEEDS = (5.0, 10.0, 20.0, 30.0, 40.0)
HEAD_ON = 15.0
GAPS = (0.5, 0.3)
"""Between the surfaces of the target and of a wall [m]."""
WALL, BESIDE_WALL = 9.0, 2.5
"""Distance of the wall from the sensor, and of a target from it in the open [m]."""
DRONE = 0.325
"""Radius of the targets, if nothing else is said [m]."""
HOVERS, MOVES = 4.0, 3.0
"""A target hovers for so long from the first scan on [s], then it moves [m/s]."""
FALSE = ("people", "cars", "insects", "dust", "rain", "leaves", "lamp")
"""Scenes in which nothing flies."""
SWARM = 50
FEW = {25.0: 0.5, 60.0: 1.2}
"""Spans of balls that give about one return per scan of a Mid-360, by their distance [m]."""
FEW_REACH = 90.0
"""Range of the Mid-360 in bright targets, rounded [m]."""

_Place = tuple[float, float, float]


def scene(name: str, seed: int, number: int, scans: int) -> Scene:
    """Make the scene of a situation."""
    rng = scene_rng(seed, number, sum(map(ord, name)))
    targets, more, air = _contents(name, rng, scans)
    ways = [way for target in targets for way in _way(target, scans * 0.1)]
    is_few = name.startswith("few")
    clear = np.concatenate(
        [np.zeros((1, 2)), *((_sight if is_few else _between)(way) for way in ways)]
    )
    street = sim.scenes.street(int(rng.integers(2**31)), keep_clear=clear, clearance=2.5)
    return Scene(
        bodies=(*street, *more),
        targets=targets,
        air=air,
        lidar=_sparse() if is_few else sim.LidarModel.preset("os1-128"),
        sensor=sim.Hover(position=(0.0, 0.0, HEIGHT)),
        scans=scans,
    )


def _sparse() -> sim.LidarModel:
    """Return the model of the sensor Livox Mid-360."""
    return sim.LidarModel.preset("livox-mid360").model_copy(update={"range_max": FEW_REACH})


def _sight(way: NDArray[np.float64]) -> NDArray[np.float64]:
    """Positions (K, 2) between the sensor and a path, which must stay free of obstacles."""
    some = way[:: max(1, len(way) // 24)]
    return (np.linspace(0.0, 1.0, 30)[:, None, None] * some).reshape(-1, 2)


def _way(target: Target, seconds: float) -> list[NDArray[np.float64]]:
    """Horizontal positions (K, 2) of a target; an empty list if it moves at random."""
    if isinstance(target.motion, sim.RandomMotion):
        return []
    return [target.motion.knots(seconds)[1][:, :2, 3]]


def _between(way: NDArray[np.float64]) -> NDArray[np.float64]:
    """Positions on a path within 40 m, one metre apart."""
    parts = [way[:1]]
    for start, end in pairwise(way):
        steps = max(2, int(np.linalg.norm(end - start)))
        parts.append(start + np.linspace(0, 1, steps)[:, None] * (end - start))
    places = np.concatenate(parts)
    return np.asarray(places[np.linalg.norm(places, axis=1) < 40.0], np.float64)


def _contents(
    name: str, rng: np.random.Generator, scans: int
) -> tuple[tuple[Target, ...], tuple[Body, ...], tuple[Particles, ...]]:
    """Make targets, bodies and particles of a situation."""
    kind, value = (*name.split(), "")[:2]
    if kind == "wall":
        return _wall(rng, float(value), scans)
    if kind == "few":
        return (_few(rng, float(value)),), (), ()
    if name in SIZES:
        return (_sized(name, rng),), (), ()
    if name in FALSE:
        return _false(name, rng, scans)
    flying: dict[str, Callable[[], list[Target]]] = {
        "pass": lambda: [_drone(_passes(rng, float(value), ASIDE, scans))],
        "head-on": lambda: [_drone(_passes(rng, float(value), 1.0, scans))],
        "edge": lambda: [_drone(_over_the_edge(rng))],
        "hovering": lambda: [_drone(_hovers_first(rng))],
        "swarm": lambda: _swarm(rng),
    }
    return tuple(flying[kind]()), (), ()


def _drone(motion: Scripted) -> Target:
    return Target(shape=sim.Hexacopter(radius=DRONE), motion=motion)


def _few(rng: np.random.Generator, distance: float) -> Target:
    """Make a ball far away that flies to and fro across the line of sight."""
    elevation, speed = np.deg2rad(rng.uniform(8.0, 25.0)), rng.uniform(2.0, 8.0)
    level, height = distance * np.cos(elevation), HEIGHT + distance * np.sin(elevation)
    half, rise = rng.uniform(4.0, 8.0), rng.uniform(-1.0, 1.0)
    ends = _turned(
        [(level, -half, height - rise), (level + rise, half, height + rise)],
        rng.uniform(0, 2 * np.pi),
    )
    return Target(
        shape=sim.Sphere(radius=FEW[distance] / 2),
        motion=sim.Shuttle(start=ends[0], end=ends[1], speed=float(speed), acceleration=4.0),
    )


def _turned(places: Sequence[_Place], angle: float) -> tuple[_Place, ...]:
    """Rotate positions about the vertical axis by `angle` [rad]."""
    cosine, sine = np.cos(angle), np.sin(angle)
    return tuple(
        (float(cosine * x - sine * y), float(sine * x + cosine * y), z) for x, y, z in places
    )


def _passes(rng: np.random.Generator, speed: float, aside: float, scans: int) -> sim.Waypoints:
    """Path to and fro past the sensor at constant speed, which starts after 1.5 s."""
    height = HEIGHT + rng.uniform(0.5, 2.0)
    ends = _turned([(-FAR, aside, height), (FAR, aside, height)], rng.uniform(0, 2 * np.pi))
    times, places, number = [1.5], [ends[0]], 0
    while times[-1] < scans * 0.1:
        number += 1
        times += [times[-1] + 2 * FAR / speed, times[-1] + 2 * FAR / speed + rng.uniform(0.5, 0.8)]
        places += [ends[number % 2], ends[number % 2]]
    return sim.Waypoints(times=tuple(times), positions=tuple(places))


def _wall(
    rng: np.random.Generator, gap: float, scans: int
) -> tuple[tuple[Target, ...], tuple[Body, ...], tuple[Particles, ...]]:
    """Make a wall and a target that repeatedly comes to it, flies along it at 1 m/s and leaves."""
    angle, seconds = rng.uniform(0, 2 * np.pi), scans * 0.1
    height = HEIGHT + rng.uniform(-0.5, 1.0)
    near, away = WALL - gap - DRONE, WALL - BESIDE_WALL
    times, places, side = [0.0, 2.0], [(away, -2.0, height), (away, -1.0, height)], -1.0
    while times[-1] < seconds:
        for wait, x, y in (
            (1.5, near, side),
            (2.0, near, -side),
            (1.5, away, -side),
            (1.0, away, -side),
        ):
            times.append(times[-1] + wait)
            places.append((x, y, height + 0.1 * len(times) % 0.3))
        side = -side
    turned = _turned(places, angle)
    half = np.array([0.0, 0.0, np.sin(angle / 2), np.cos(angle / 2)])
    (middle,) = _turned([(WALL + 0.15, 0.0, 4.0)], angle)
    wall = Body(
        shape=sim.Box(size=(0.3, 14.0, 8.0)), position=middle, rotation=tuple(half.tolist())
    )
    drone = _drone(sim.Waypoints(times=tuple(times), positions=turned))
    return (drone,), (wall,), ()


def _over_the_edge(rng: np.random.Generator) -> sim.Waypoints:
    """Path up and down across the upper edge of the field of view, 22.5 deg above horizontal."""
    angle, away, times, places = rng.uniform(0, 2 * np.pi), 9.0, [0.0], [(9.0, 0.0, HEIGHT + 2.0)]
    edge = HEIGHT + away * np.tan(np.deg2rad(22.0))
    for number in range(20):
        times += [times[-1] + 1.5, times[-1] + 2.5]
        y = 0.3 * (number % 5)
        places += [(away, y, float(edge - 0.1)), (away, y, HEIGHT + 2.0)]
    return sim.Waypoints(times=tuple(times), positions=_turned(places, angle))


def _hovers_first(rng: np.random.Generator) -> sim.Waypoints:
    """Motion that hovers at one place and then follows a straight line."""
    distance, height = rng.uniform(5.0, 10.0), HEIGHT + rng.uniform(0.0, 2.0)
    start, end = (distance, 0.0, height), (distance, 12.0, height)
    ends = _turned([start, end], rng.uniform(0, 2 * np.pi))
    return sim.Waypoints(times=(HOVERS, HOVERS + 12.0 / MOVES), positions=ends)


def _swarm(rng: np.random.Generator) -> list[Target]:
    """Make targets on separate circles, 1.5 m above or beside each other."""
    targets = []
    for number in range(SWARM):
        row, column = divmod(number, 10)
        distance, azimuth = 6.0 + 2.2 * row, 2 * np.pi * column / 10 + 0.3 * row
        targets.append(
            Target(
                shape=sim.Quadcopter(radius=0.25),
                motion=sim.Circle(
                    center=(
                        float(distance * np.cos(azimuth)),
                        float(distance * np.sin(azimuth)),
                        float(HEIGHT + rng.uniform(0.3, 1.5)),
                    ),
                    radius=float(rng.uniform(0.5, 0.9)),
                    speed=float(rng.choice([-1, 1]) * rng.uniform(1.0, 3.0)),
                    phase=float(rng.uniform(0, 2 * np.pi)),
                ),
            )
        )
    return targets


def _sized(name: str, rng: np.random.Generator) -> Target:
    """Make the target of the size that `name` states; it circles around the sensor."""
    shape, span = SIZES[name]
    return Target(
        shape=shape,
        motion=sim.Circle(
            center=(0.0, 0.0, HEIGHT + float(rng.uniform(0.5, 1.5))),
            radius=float(rng.uniform(5.0, 9.0)),
            speed=float(rng.choice([-1, 1]) * rng.uniform(2.0, 4.0)) * min(1.0, span + 0.5),
            phase=float(rng.uniform(0, 2 * np.pi)),
        ),
    )


def _false(
    name: str, rng: np.random.Generator, scans: int
) -> tuple[tuple[Target, ...], tuple[Body, ...], tuple[Particles, ...]]:
    """Make the moving objects that do not fly, of the situation `name`."""
    seconds = scans * 0.1
    air: dict[str, Callable[[], list[Particles]]] = {
        "rain": lambda: [sim.Rain()],
        "dust": lambda: [_puff(rng, seconds) for _ in range(6)],
    }
    bodies: dict[str, Callable[[], list[Body]]] = {
        "leaves": lambda: [_tree(rng) for _ in range(6)],
        "lamp": lambda: [_lamp(rng)],
    }
    targets: dict[str, Callable[[], list[Target]]] = {
        "insects": lambda: [_insect(rng) for _ in range(20)],
        "people": lambda: [_walker(rng, seconds) for _ in range(6)],
        "cars": lambda: [_car(rng, seconds, lane) for lane in (-7.0, 5.0, 8.0)],
    }
    return (
        tuple(targets[name]() if name in targets else ()),
        tuple(bodies[name]() if name in bodies else ()),
        tuple(air[name]() if name in air else ()),
    )


def _lamp(rng: np.random.Generator) -> Body:
    """Make a ball that hangs in free air, such as a lamp."""
    angle = rng.uniform(0, 2 * np.pi)
    (place,) = _turned([(6.0, 0.0, HEIGHT + 1.0)], angle)
    return Body(shape=sim.Sphere(radius=0.2), position=place)


def _tree(rng: np.random.Generator) -> Body:
    """Make a tree with few small leaves that sway in the wind."""
    angle, distance = rng.uniform(0, 2 * np.pi), rng.uniform(5.0, 14.0)
    (place,) = _turned([(float(distance), 0.0, 0.0)], angle)
    tree = sim.Tree(
        trunk_height=rng.uniform(3, 5),
        crown_radius=rng.uniform(1.3, 2.2),
        leaves=60,
        leaf_radius=0.06,
        sway=0.25,
        seed=int(rng.integers(2**31)),
    )
    return Body(shape=tree, position=place)


def _walker(rng: np.random.Generator, seconds: float) -> Target:
    """Make a person who walks along a line and faces the direction of walking."""
    angle, side = rng.uniform(0, 2 * np.pi), rng.uniform(3.0, 9.0)
    speed = rng.uniform(0.8, 1.6)
    half = speed * seconds / 2
    ends = _turned([(-half, side, 0.0), (half, side, 0.0)], angle)
    facing = (0.0, 0.0, float(np.sin(angle / 2)), float(np.cos(angle / 2)))
    return Target(
        shape=sim.Person(height=rng.uniform(1.6, 1.9)),
        motion=sim.Waypoints(times=(0.0, seconds), positions=ends, rotations=(facing, facing)),
        clutter=True,
    )


def _car(rng: np.random.Generator, seconds: float, lane: float) -> Target:
    """Make a car that drives to and fro at 8 m/s."""
    start = rng.uniform(-20, 20)
    ends = ((float(start - 25), lane, 0.85), (float(start + 25), lane, 0.85))
    return Target(
        shape=sim.Box(size=(4.2, 1.8, 1.5)),
        motion=sim.Shuttle(start=ends[0], end=ends[1], speed=8.0, acceleration=3.0),
        clutter=True,
    )


def _insect(rng: np.random.Generator) -> Target:
    """Make a speck of 1 to 3 cm that circles within a few metres of the sensor."""
    return Target(
        shape=sim.Sphere(radius=rng.uniform(0.01, 0.03)),
        motion=sim.Circle(
            center=(rng.uniform(-8, 8), rng.uniform(-5, 5), rng.uniform(2, 6)),
            radius=rng.uniform(0.2, 1.0),
            speed=rng.uniform(0.5, 3.0),
            phase=rng.uniform(0, 2 * np.pi),
        ),
        clutter=True,
    )


def _puff(rng: np.random.Generator, seconds: float) -> sim.Dust:
    """Make a cloud of dust that drifts past the sensor and grows."""
    velocity = np.array([rng.uniform(-2, 2), rng.uniform(-2, 2), rng.uniform(0, 0.3)])
    middle = np.array([rng.uniform(-12, 12), rng.uniform(-8, 8), rng.uniform(1, 5)])
    x, y, z = (middle - seconds / 2 * velocity).tolist()
    vx, vy, vz = velocity.tolist()
    return sim.Dust(
        center=(x, y, z),
        velocity=(vx, vy, vz),
        radius=rng.uniform(0.3, 1.5),
        growth=rng.uniform(0, 0.1),
        free_path=rng.uniform(2, 10),
    )
