"""Scenes for 2D scanners: moving round objects, alone, together, hidden, in a room.

World frame [m]; the sensor is near the origin, 1 m high, and looks along +x.
"""

from typing import Literal, TypeAlias

import numpy as np

from lidar_core.errors import ConfigError
from lidar_core.sim.config import Body, Scene, Target
from lidar_core.sim.lidar import LidarModel
from lidar_core.sim.motion.motions import Circle, Hover, Loop, Motion, Scripted, Shuttle, Waypoints
from lidar_core.sim.motion.paths import FigureEight, StopAndGo, Swinging, Wandering
from lidar_core.sim.solids.people import Barrel, Person
from lidar_core.sim.solids.shapes import Box, Cylinder, Plane
from lidar_core.sim.types import Vector

__all__ = [
    "ENDLESS",
    "HEIGHT",
    "LAB_VOLUME",
    "RATE",
    "SensorMotion",
    "cluttered",
    "hidden",
    "lab",
    "neighbours",
    "occlusion",
    "scanner",
    "several",
    "single",
    "trees",
    "walkers",
]

HEIGHT = 1.0
"""Height of the sensor [m]."""
RATE = 20.0
"""Scans per second [Hz]."""
ENDLESS = 1000.0
"""Height of walls that no tilted ray misses [m]."""
LAB_VOLUME = ((-2.5, -3.0, 0.1), (2.5, 3.0, 5.0))
"""Least and greatest corner of the operating volume of the lab [m]."""

SensorMotion: TypeAlias = Literal["hovering", "swinging"]


def scanner() -> LidarModel:
    """Make a 2D scanner: 1081 beams, 270 degrees in 18.75 ms, 20 Hz, 0.1 to 10 m, 0.01 m noise."""
    return LidarModel.preset("utm-30lx", scan_rate=RATE, range_max=10.0)


def single(
    radius: float,
    trajectory: int,
    *,
    speed: float = 1.0,
    sensor: SensorMotion = "hovering",
    seed: int = 0,
) -> Scene:
    """Make one cylinder on one of five paths: line, circle, eight, stop and go, wandering.

    Parameters
    ----------
    radius : float
        Radius of the cylinder [m].
    trajectory : int
        1 to 5.
    speed : float
        Largest speed on the path [m/s]; on the wandering path, the root mean square of the speed.
    sensor : str
        Motion of the sensor: it hovers, or moves along x, turns, pitches and rolls.
    seed : int
        Seed of the wandering.

    Raises
    ------
    ConfigError
        There is no such trajectory.
    """
    ways: dict[int, Motion] = {
        1: Waypoints(times=(0, 10 / speed), positions=((4, -5, HEIGHT), (4, 5, HEIGHT))),
        2: Circle(center=(4, 0, HEIGHT), radius=2, speed=speed),
        3: FigureEight(center=(4, 0, HEIGHT), speed=speed),
        4: StopAndGo(start=(4, -3 * speed, HEIGHT), velocity=(0, speed, 0)),
        5: Wandering(start=(4, 0, HEIGHT), speed=speed, seed=seed),
    }
    if trajectory not in ways:
        raise ConfigError(f"trajectory: expected 1 to 5, got {trajectory}")
    seconds = min(60.0, 10 / speed) if trajectory == 1 else 60.0
    return Scene(
        targets=(_post(radius, ways[trajectory]),),
        lidar=scanner(),
        sensor=_sensor(sensor),
        scans=round(seconds * RATE),
    )


def several(
    seed: int, *, walls: bool = False, sensor: SensorMotion = "swinging", scans: int = 6000
) -> Scene:
    """Make posts at rest and in motion, which hide one another; `walls` close a room.

    Radii, phases and speeds depend on the seed. The duration is five minutes unless `scans` is
    given.
    """
    rng = np.random.default_rng([20240608, seed])
    places = np.array(
        [(1.8, 0.9), (1.7, -1.2), (5, 2.4), (5.1, -2.2), (7.4, 0.4), (-1.2, 4.9), (7.6, -4.4)]
    ) + rng.uniform(-0.1, 0.1, (7, 2))
    at_rest = [_post(rng.uniform(0.1, 0.4), _still(x, y)) for x, y in places.tolist()]
    pace = rng.uniform(0.5, 1.2, 4)
    lead = rng.uniform(0, 10, 4)
    ways: list[Motion] = [
        Circle(center=(0, 0, HEIGHT), radius=3.2, speed=float(pace[0]), phase=float(lead[0])),
        _shuttle((6.2, -5.0), (6.2, 5.0), pace[1], lead[1]),
        _shuttle((-2.0, -4.6), (4.4, -4.6), pace[2], lead[2]),
        _shuttle((0.5, 4.0), (4.3, 4.0), pace[3], lead[3]),
    ]
    moving = [_post(rng.uniform(0.1, 0.35), way) for way in ways]
    return Scene(
        bodies=_room((-6.0, -6.5), (9.0, 6.5), ENDLESS) if walls else (),
        targets=(*at_rest, *moving),
        lidar=scanner(),
        sensor=_sensor(sensor),
        scans=scans,
    )


def lab(seed: int, *, scans: int = 1200) -> Scene:
    """Make a person who walks and a barrel in a room wider than the operating volume `LAB_VOLUME`.

    The seed gives pace and phase of the walk. The barrel hides the person now and then.
    """
    rng = np.random.default_rng([20240609, seed])
    eight = FigureEight(
        center=(1.2, 0.3 + rng.uniform(-0.2, 0.2), 0),
        half_size=(0.6, 2.0),
        speed=float(rng.uniform(0.5, 1.0)),
    )
    person = Person(rate=float(rng.uniform(0.7, 1.0)), height=float(rng.uniform(1.6, 1.9)))
    barrel = Barrel(height=1.3)
    sensor = Swinging(
        position=(-2.0, 0, HEIGHT), reach=(0.2, 0, 0), yaw=0.2, pitch_deg=4, roll_deg=3
    )
    return Scene(
        bodies=(Body(shape=Plane()), *_room((-3.5, -4.0), (4.0, 4.0), 4.0)),
        targets=(
            Target(shape=person, motion=eight),
            Target(shape=barrel, motion=Hover(position=(-0.4, -0.9, 0))),
        ),
        lidar=scanner(),
        sensor=sensor,
        scans=scans,
    )


def walkers(seed: int, *, height: float = 0.3, scans: int = 600) -> Scene:
    """Make three people who walk crossing figures of eight, and four thin posts.

    `height` is the height of the static scanner [m]: at 0.3 m it sees legs, at 1.2 m trunks and
    arms. Places, paces and sizes depend on the seed.
    """
    rng = np.random.default_rng([20240614, seed])
    middles = np.array([(3.0, 0.0), (3.4, 0.8), (2.6, -1.0)]) + rng.uniform(-0.2, 0.2, (3, 2))
    people = []
    for x, y in middles.tolist():
        pace = float(rng.uniform(0.6, 1.3))
        way = FigureEight(
            center=(x, y, 0),
            half_size=(float(rng.uniform(0.5, 1.0)), float(rng.uniform(1.6, 2.4))),
            speed=pace,
        )
        # A swing is two steps: as long as people of that pace make them.
        person = Person(rate=0.55 + 0.3 * pace, height=float(rng.uniform(1.6, 1.9)))
        people.append(Target(shape=person, motion=way))
    posts = [
        _post(0.05, _still(x, y)) for x, y in ((5.0, 2.5), (5.2, -2.4), (5.5, 0.4), (5.5, 0.9))
    ]
    return Scene(
        bodies=(*_room((-1.0, -4.0), (7.0, 4.0), ENDLESS),),
        targets=(*people, *posts),
        lidar=scanner(),
        sensor=Hover(position=(0.0, 0.0, height)),
        scans=scans,
    )


def trees(seed: int, *, scans: int = 1200) -> Scene:
    """Make thirty trunks at rest, and a robot that drives rounds among them.

    Places and radii, 0.08 to 0.35 m, depend on the seed. A round takes 28 s. Every trunk is in view
    once per round, and out of view in between.
    """
    rng = np.random.default_rng([20240613, seed])
    sensor = Loop(center=(0, 0, HEIGHT), straight=8, radius=4, speed=1.5)
    way = sensor.knots(30.0)[1][:, :2, 3]
    places: list[list[float]] = []
    while len(places) < 30:
        place = rng.uniform(-14, 14, 2)
        room = np.linalg.norm(np.reshape([*places, [99, 99]], (-1, 2)) - place, axis=1).min()
        if room > 1.5 and np.linalg.norm(way - place, axis=1).min() > 1:
            places.append(place.tolist())
    trunks = tuple(_post(rng.uniform(0.08, 0.35), _still(x, y)) for x, y in places)
    return Scene(targets=trunks, lidar=scanner(), sensor=sensor, scans=scans)


def cluttered(seed: int, *, scans: int = 600) -> Scene:
    """Make a room full of boxes and thin posts, and a robot that drives rounds among them.

    Parts of the walls are visible for moments in the gaps between the objects. Places and sizes
    depend on the seed: ten boxes of 0.2 to 1 m, eighteen posts with radii of 0.015 to 0.15 m.
    """
    rng = np.random.default_rng([20240618, seed])
    sensor = Loop(center=(0, 0, HEIGHT), straight=3, radius=1, speed=0.8)
    way = sensor.knots(30.0)[1][:, :2, 3]
    places: list[list[float]] = []
    targets: list[Target] = []
    while len(targets) < 28:
        place = rng.uniform((-4.5, -3.5), (4.5, 3.5))
        room = np.linalg.norm(np.reshape([*places, [99, 99]], (-1, 2)) - place, axis=1).min()
        if room < 0.7 or np.linalg.norm(way - place, axis=1).min() < 0.9:
            continue
        places.append(place.tolist())
        if len(targets) % 3:
            targets.append(_post(rng.uniform(0.015, 0.15), _still(*place.tolist())))
            continue
        half, size = rng.uniform(0, np.pi / 2), rng.uniform((0.2, 0.2), (1.0, 0.6)).tolist()
        turned = Hover(
            position=(float(place[0]), float(place[1]), HEIGHT),
            rotation=(0.0, 0.0, float(np.sin(half)), float(np.cos(half))),
        )
        targets.append(Target(shape=Box(size=(size[0], size[1], ENDLESS)), motion=turned))
    return Scene(
        bodies=_room((-5.0, -4.0), (5.0, 4.0), ENDLESS),
        targets=tuple(targets),
        lidar=scanner(),
        sensor=sensor,
        scans=scans,
    )


def hidden(seed: int, *, sensor: SensorMotion = "hovering", scans: int = 200) -> Scene:
    """Make three posts, each 25 to 75 % hidden by another in front of it.

    The targets come in pairs: a hidden one, and one that hides it.
    """
    rng = np.random.default_rng([20240610, seed])
    targets = []
    for bearing in (-0.9, 0.0, 0.9):
        radius, front = rng.uniform(0.15, 0.45), rng.uniform(0.1, 0.3)
        distance = rng.uniform(3.0, 7.0)
        nearer = min(rng.uniform(0.4, 0.7) * distance, distance - radius - front - 0.4)
        half, half_front = np.arcsin(radius / distance), np.arcsin(front / nearer)
        share = min(rng.uniform(0.25, 0.75), half_front / half)
        # The front one covers this share of the angle, from one side.
        offset = rng.choice([-1.0, 1.0]) * (half + half_front - 2 * share * half)
        for length, angle, size in ((distance, bearing, radius), (nearer, bearing + offset, front)):
            way = _still(length * float(np.cos(angle)), length * float(np.sin(angle)))
            targets.append(_post(size, way))
    return Scene(targets=tuple(targets), lidar=scanner(), sensor=_sensor(sensor), scans=scans)


def neighbours(
    seed: int,
    *,
    gap: float = 0.3,
    distance: float = 5.0,
    sensor: SensorMotion = "hovering",
    scans: int = 100,
) -> Scene:
    """Make two posts side by side, `gap` apart from surface to surface, at `distance` [m]."""
    rng = np.random.default_rng([20240611, seed])
    first, second = rng.uniform(0.1, 0.45, 2)
    bearing, turn = rng.uniform(-1.2, 1.2), rng.uniform(-0.3, 0.3)
    middle = distance * np.array([np.cos(bearing), np.sin(bearing)])
    beside = np.array([-np.sin(bearing + turn), np.cos(bearing + turn)])
    a, b = middle + beside * (gap / 2 + first), middle - beside * (gap / 2 + second)
    return Scene(
        targets=(_post(first, _still(*a.tolist())), _post(second, _still(*b.tolist()))),
        lidar=scanner(),
        sensor=_sensor(sensor),
        scans=scans,
    )


def occlusion(
    seed: int,
    *,
    seconds: float = 2.0,
    sensor: SensorMotion = "hovering",
    scans: int = 240,
) -> Scene:
    """Make a post that passes behind another one, wholly hidden for about `seconds`.

    The first target passes, the second hides it from 6 - `seconds` / 2 s on.
    """
    rng = np.random.default_rng([20240612, seed])
    radius, distance = rng.uniform(0.1, 0.35), rng.uniform(5.0, 7.0)
    speed, nearer = rng.uniform(0.3, 1.0), rng.uniform(1.5, 2.5)
    # Half the shadow holds the half way and the post's own half angle.
    half = np.arctan2(speed * seconds / 2, distance) + np.arcsin(radius / distance)
    front = float(nearer * np.sin(half))
    forwards = rng.choice([-1.0, 1.0]) * speed
    way = Waypoints(
        times=(0.0, 12.0),
        positions=((distance, -6 * forwards, HEIGHT), (distance, 6 * forwards, HEIGHT)),
    )
    return Scene(
        targets=(_post(radius, way), _post(front, _still(nearer, 0.0))),
        lidar=scanner(),
        sensor=_sensor(sensor),
        scans=scans,
    )


def _sensor(kind: SensorMotion) -> Scripted:
    place = (0.0, 0.0, HEIGHT)
    if kind == "hovering":
        return Hover(position=place)
    if kind == "swinging":
        return Swinging(position=place)
    raise ConfigError(f"sensor: expected hovering or swinging, got {kind}")


def _post(radius: float, motion: Motion) -> Target:
    return Target(shape=Cylinder(radius=float(radius)), motion=motion)


def _still(x: float, y: float) -> Hover:
    return Hover(position=(float(x), float(y), HEIGHT))


def _shuttle(
    start: tuple[float, float], end: tuple[float, float], speed: float, lead: float
) -> Shuttle:
    return Shuttle(
        start=(*start, HEIGHT),
        end=(*end, HEIGHT),
        speed=float(speed),
        acceleration=1.0,
        pause=1.0,
        lead=float(lead),
    )


def _room(low: tuple[float, float], high: tuple[float, float], height: float) -> tuple[Body, ...]:
    """Make four walls, 0.2 m thick, around a rectangle."""
    middle, size = np.add(low, high) / 2, np.subtract(high, low)
    x, y = middle.tolist()
    thick = 0.2

    def wall(length_x: float, length_y: float, place: Vector) -> Body:
        return Body(shape=Box(size=(length_x, length_y, height)), position=place)

    level = height / 2 if height < ENDLESS else 0.0
    return (
        wall(thick, size[1], (low[0] - thick / 2, y, level)),
        wall(thick, size[1], (high[0] + thick / 2, y, level)),
        wall(size[0], thick, (x, low[1] - thick / 2, level)),
        wall(size[0], thick, (x, high[1] + thick / 2, level)),
    )


def __dir__() -> list[str]:
    return __all__
