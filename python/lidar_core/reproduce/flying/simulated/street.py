"""Flights through a street with given speeds and accelerations: the simulated runs of sec. V-A.

Each flight has four drones around one sensor, each in its own quarter: a sphere and a hexacopter of
the paper's size, and one of each with a radius that the estimator does not know.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from lidar_core import sim
from lidar_core.reproduce.common import Kind, evaluation_config
from lidar_core.reproduce.flying.simulated.flights import both_modes, fly
from lidar_core.reproduce.flying.simulated.sightings import Sightings, sightings
from lidar_core.reproduce.jobs import Job, Part
from lidar_core.reproduce.types import Request
from lidar_core.sim import NoisyPoses, PoseNoise, Scene, Simulator
from lidar_core.sim.motion.motions import Scripted

SCANS_PER_FLIGHT, SHORTEST = 100, 25
PAPER_RADIUS = 0.325
RADII = (0.15, 0.60)
"""Radii of drones of unknown size [m]."""
RANGES = (5.0, 20.0)
"""Ranges that the drones cover evenly [m]."""
HEIGHTS = (3.0, 5.0)
SENSOR_HEIGHT = 4.0
SHAPES = ("sphere", "mesh", "any sphere", "any mesh")
"""The drones of a flight, in the order of the truth; "any" is of unknown size."""


@dataclass(frozen=True, slots=True)
class Way:
    """Motion of the drones of a flight.

    Attributes
    ----------
    kind : str
        circle: in the horizontal plane; line: out and back along the whole range; hover: rest,
        with short hops.
    speed, acceleration : float
        Greatest ones [m/s], [m/s^2].
    """

    kind: str
    speed: float
    acceleration: float


WAYS = (
    Way("hover", 1.0, 1.0),
    Way("line", 1.0, 1.0),
    Way("circle", 2.0, 1.0),
    Way("line", 3.0, 2.0),
    Way("circle", 3.0, 2.0),
    Way("circle", 4.0, 4.0),
    Way("line", 6.0, 4.0),
    Way("circle", 5.0, 8.0),
    Way("circle", 7.0, 8.0),
    Way("line", 10.0, 8.0),
)
"""Ways that the flights take in turn."""


def jobs(request: Request, scans: int, *, is_noisy: bool) -> Iterator[Job]:
    """Flights of `scans` scans in total; fewer scans shorten flights, so all motions appear."""
    each = min(scans, max(SHORTEST, min(SCANS_PER_FLIGHT, scans // len(WAYS))))
    for number in range(max(1, round(scans / each))):
        arguments = {"seed": request.seed, "number": number, "scans": each, "is_noisy": is_noisy}
        name = f"street-{request.seed}-{number}-{each}-{'noisy' if is_noisy else 'ideal'}"
        yield Job(name, flight, arguments, each)


def flight(*, seed: int, number: int, scans: int, is_noisy: bool) -> Part:
    """Simulate one flight and detect in it with both modes.

    Ideal: exact poses, exact ranges, all rays of a scan at once, as in the paper's simulator.
    Noisy: ranges with 0.03 m, poses with 0.05 m and 0.5 deg per axis, white per scan; rays one
    after the other.
    """
    name = (seed * 1_000_003 + number) % 2**32
    simulator = Simulator(scene(seed, number, scans, is_noisy=is_noisy), seed=name)
    noise = NoisyPoses(PoseNoise(), seed=name) if is_noisy else None
    return fly(simulator, both_modes(), scans=scans, noise=noise)


def scene(seed: int, number: int, scans: int, *, is_noisy: bool) -> Scene:
    """Make street, sensor and drones of flight `number`."""
    rng = np.random.default_rng([20240607, seed, number])
    way = WAYS[number % len(WAYS)]
    turn = rng.uniform(0, 2 * np.pi)
    quarters = turn + np.pi / 2 * rng.permutation(4)
    share = (rng.permutation(4) + rng.uniform(size=4)) / 4
    motions = [_motion(way, quarters[k], share[k], rng) for k in range(4)]
    unknown = rng.uniform(*RADII, 2).tolist()
    shapes = (
        sim.Sphere(radius=PAPER_RADIUS),
        sim.Hexacopter(radius=PAPER_RADIUS),
        sim.Sphere(radius=unknown[0]),
        sim.Hexacopter(radius=unknown[1]),
    )
    observer = _observer(number)
    seconds = scans * 0.1
    ways = [motion.knots(seconds)[1][::25, :2, 3] for motion in (*motions, observer)]
    exact = {} if is_noisy else {"snapshot": True, "range_std": 0.0}
    return sim.Scene(
        bodies=sim.scenes.street(
            int(rng.integers(2**31)), keep_clear=np.concatenate(ways), clearance=2.5
        ),
        targets=tuple(
            sim.Target(shape=shape, motion=motion)
            for shape, motion in zip(shapes, motions, strict=True)
        ),
        lidar=sim.LidarModel.preset("os1-128", ideal=True, **exact),
        sensor=observer,
        scans=scans,
    )


def _motion(way: Way, azimuth: float, share: float, rng: np.random.Generator) -> Scripted:
    """Motion of one drone in the quarter around `azimuth`; `share` sets its distance."""
    near, far = RANGES
    low, high = rng.uniform(*HEIGHTS, 2).tolist()
    if way.kind == "circle":
        radius = way.speed**2 / way.acceleration
        middle = near + radius + share * (far - near - 2 * radius)
        return sim.Circle(
            center=_place(azimuth, middle, low),
            radius=radius,
            speed=float(rng.choice([-1, 1])) * way.speed,
            phase=rng.uniform(0, 2 * np.pi),
        )
    if way.kind == "hover":
        middle = near + share * (far - near)
        ends = _place(azimuth, middle - 0.75, low), _place(azimuth, middle + 0.75, high)
        pause = 2.5
    else:
        ends = _place(azimuth - 0.25, near, low), _place(azimuth + 0.25, far, high)
        pause = 0.0
    motion = sim.Shuttle(
        start=ends[0], end=ends[1], speed=way.speed, acceleration=way.acceleration, pause=pause
    )
    length = float(np.linalg.norm(np.subtract(*ends)))
    lead = 1.0 if way.kind == "hover" else 2 * motion.leg(length) * share
    return motion.model_copy(update={"lead": lead})


def _place(azimuth: float, distance: float, height: float) -> tuple[float, float, float]:
    return (distance * float(np.cos(azimuth)), distance * float(np.sin(azimuth)), height)


def _observer(number: int) -> Scripted:
    """Motion of the sensor: by flight number in turn, it hovers, circles or goes to and fro."""
    return (
        sim.Hover(position=(0.0, 0.0, SENSOR_HEIGHT)),
        sim.Circle(center=(0.0, 0.0, SENSOR_HEIGHT), radius=1.5, speed=1.5),
        sim.Shuttle(
            start=(-1.5, 0.0, SENSOR_HEIGHT),
            end=(1.5, 0.0, SENSOR_HEIGHT),
            speed=2.0,
            acceleration=2.0,
        ),
    )[number % 3]


def sample(parts: Sequence[Part], name: str, kind: Kind, shape: str) -> Sightings:
    """Sightings of `shape` by the configuration `name`."""
    return sightings(parts, name, kind, target=SHAPES.index(shape), config=evaluation_config())
