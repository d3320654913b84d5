"""`flying-drivers`: simulated sensors as their drivers deliver them, nothing configured."""

from typing import Any

import numpy as np

from lidar_core import sim
from lidar_core.flying import FlyingConfig, FlyingObjectDetector
from lidar_core.reproduce.common import BLUE, scene_rng, simulator_seed
from lidar_core.reproduce.flying.real_data.reported import Reported, false_tracks
from lidar_core.reproduce.flying.real_data.scores import FEWEST, START_S, scores
from lidar_core.reproduce.jobs import Job, Part, grouped, run
from lidar_core.reproduce.types import Item, Measured, Request, Row
from lidar_core.sim import Scene, Simulator
from lidar_core.sim.motion.motions import Scripted

SENSORS = ("livox-mid360", "livox-avia", "vlp-16", "hdl-32e", "xt32")
SCANS_PER_FLIGHT = 100
SHAPES = ("sphere", "hexacopter", "quadcopter")
DISTANCES, ELEVATIONS_DEG = (4.0, 11.0), (-3.0, 9.0)
"""Of the middles of the flights, as the sensor sees them [m], [deg]."""
SECTORS_DEG = (-22.0, 0.0, 22.0)
"""Directions of the flights: within the narrowest field of view [deg]."""
RADII, SPEEDS = (0.4, 1.0), (1.0, 3.0)
"""Of the circles that the targets fly [m], [m/s]."""
HEIGHT = 4.0
"""Of the sensor above the ground [m]."""


def _measure(request: Request) -> Measured:
    todo = jobs(request)
    of = grouped(todo, run(todo, request), "sensor", SENSORS)
    return Measured(
        (of,),
        scans=sum(job.scans for job in todo),
        note="Default configuration, scans as the sensor's driver gives them: rows without return"
        " dropped or zeros, no directions. Targets 3 to 12 m away; recall of tracks from"
        f" {START_S} s on, where a target has {FEWEST} returns; errors from its centre. Every"
        " second flight is without targets.",
        config={"best": FlyingConfig()},
    )


def jobs(request: Request) -> list[Job]:
    """Jobs of flights per sensor, alternately with and without targets, at least two each."""
    each = max(15, min(SCANS_PER_FLIGHT, request.scans // (2 * len(SENSORS))))
    count = max(2, round(request.scans / (each * len(SENSORS))))
    return [
        Job(
            f"flying-drivers-{name}-{request.seed}-{number}-{each}",
            flight,
            {"seed": request.seed, "number": number, "scans": each, "sensor": name},
            each,
        )
        for name in SENSORS
        for number in range(count)
    ]


def flight(*, seed: int, number: int, scans: int, sensor: str) -> Part:
    """Simulate one flight and run the detector over it; even ones have targets."""
    simulator = Simulator(scene(seed, number, scans, sensor), seed=simulator_seed(seed, number))
    detector, kept = FlyingObjectDetector(FlyingConfig()), Reported()
    places, hits, seconds = [], [], []
    for step in range(scans):
        made = simulator.scan(step)
        kept.add(step, made.posed, detector.process(made, sensor=sensor))
        places.append(made.truth.position)
        hits.append(made.truth.hits)
        seconds.append(made.scan.stamp_ns * 1e-9)
    return kept.columns() | {
        "place": np.reshape(places, (scans, -1, 3)),
        "hits": np.reshape(hits, (scans, -1)).astype(np.int64),
        "seconds": np.array(seconds) - seconds[0],
        "number": np.array(number),
    }


def scene(seed: int, number: int, scans: int, sensor: str) -> Scene:
    """Make a street with open sky, a sensor that hovers or drifts to and fro, three targets."""
    rng = scene_rng(seed, number, SENSORS.index(sensor))
    observer: Scripted = sim.Hover(position=(0.0, 0.0, HEIGHT))
    if number % 4 >= 2:
        observer = sim.Shuttle(
            start=(-1.0, 0.0, HEIGHT), end=(1.0, 0.0, HEIGHT), speed=1.0, acceleration=1.0
        )
    motions = [_circle(azimuth, rng) for azimuth in rng.permutation(SECTORS_DEG)]
    ways = [one.knots(scans * 0.1)[1][::25, :2, 3] for one in (*motions, observer)]
    solids = (sim.Sphere(radius=0.325), sim.Hexacopter(radius=0.325), sim.Quadcopter(radius=0.25))
    targets = tuple(
        sim.Target(shape=shape, motion=motion)
        for shape, motion in zip(solids, motions, strict=True)
    )
    return sim.Scene(
        bodies=sim.scenes.street(
            int(rng.integers(2**31)), keep_clear=np.concatenate(ways), clearance=2.5
        ),
        targets=targets if number % 2 == 0 else (),
        lidar=sim.LidarModel.preset(sensor),
        sensor=observer,
        scans=scans,
    )


def _circle(azimuth_deg: float, rng: np.random.Generator) -> Scripted:
    """Circular path of a target in front of the sensor."""
    azimuth, elevation = np.deg2rad(azimuth_deg), np.deg2rad(rng.uniform(*ELEVATIONS_DEG))
    distance = rng.uniform(*DISTANCES)
    level = distance * np.cos(elevation)
    return sim.Circle(
        center=(
            float(level * np.cos(azimuth)),
            float(level * np.sin(azimuth)),
            float(HEIGHT + distance * np.sin(elevation)),
        ),
        radius=float(rng.uniform(*RADII)),
        speed=float(rng.choice([-1, 1]) * rng.uniform(*SPEEDS)),
        phase=float(rng.uniform(0, 2 * np.pi)),
    )


def _rows(of: dict[str, list[Part]]) -> list[Row]:
    rows = []
    for name, parts in of.items():
        empty = [part for part in parts if part["number"] % 2]
        false = sum(len(false_tracks(part)) for part in empty)
        shares = [float(part["sky_share"][-1]) for part in parts]
        share = float(np.mean(shares)) if np.isfinite(shares).all() else None
        values: list[tuple[str, str, float | None]] = [
            ("scans without targets", "1", float(sum(len(part["sensor"]) for part in empty))),
            ("false_tracks", "1", float(false)),
            ("sky_share", "1", share),
            *scores([part for part in parts if part["number"] % 2 == 0], SHAPES),
        ]
        rows += [Row(f"{name}/{what}", unit, None, None, value) for what, unit, value in values]
    return rows


def _draw(figure: Any, of: dict[str, list[Part]]) -> None:
    """Draw recall per sensor and shape."""
    rows = {row.name: row.best_mode for row in _rows(of)}
    axes = figure.subplots()
    for offset, shape in zip((-0.25, 0.0, 0.25), SHAPES, strict=True):
        values = [rows[f"{name}/recall, {shape}"] or 0.0 for name in of]
        axes.bar(np.arange(len(of)) + offset, values, 0.23, label=shape)
    axes.axhline(0.95, color=BLUE, linewidth=1)
    axes.set(ylabel="recall of tracks", ylim=(0, 1))
    axes.set_xticks(range(len(of)), list(of))
    axes.legend()


ITEM = Item(
    name="flying-drivers",
    title="simulated sensors as their drivers deliver them, nothing configured",
    scans=4000,
    minutes=8,
    measure=_measure,
    rows=_rows,
    draw=_draw,
    grid="",
)
