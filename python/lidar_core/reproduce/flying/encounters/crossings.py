"""`flying-crossings`: two drones pass each other closely, and keep their tracks or not."""

import numpy as np
from numpy.typing import NDArray

from lidar_core import sim
from lidar_core.reproduce.common import MODES
from lidar_core.reproduce.flying.encounters.common import (
    SENSOR,
    cases,
    draw_numbers,
    drone,
    flown,
    in_sight,
    os1,
    scores,
    tracking_rows,
    yard,
)
from lidar_core.reproduce.flying.simulated.flights import both_modes
from lidar_core.reproduce.jobs import Part
from lidar_core.reproduce.types import Item, Measured, Request, Row
from lidar_core.sim import Scene

SCANS = 45
MIDDLE = 2.7
"""Time of the closest approach [s]."""
APPROACH = (1.0, 2.0)
"""Least distance of the centres [m]."""
SPEED = (2.0, 5.0)
"""Speed of each drone [m/s]."""
ANGLE_DEG = (20.0, 180.0)
"""Between their horizontal directions [deg]."""


def _measure(request: Request) -> Measured:
    parts = cases(crossing, "flying-crossings", request, SCANS)
    return Measured(
        (parts,),
        scans=len(parts),
        note=f"{len(parts)} pairs of drones at {SPEED[0]:g}-{SPEED[1]:g} m/s, closest approach"
        f" {APPROACH[0]:g}-{APPROACH[1]:g} m, 4-19 m from an OS1-128.",
        config=both_modes(),
    )


def crossing(*, seed: int, number: int, scans: int) -> Part:
    """Simulate one crossing and track it with both modes."""
    return flown(_scene(np.random.default_rng([1, seed, number]), scans), seed)


def _scene(rng: np.random.Generator, scans: int) -> Scene:
    times = np.array([0.0, SCANS * 0.1])
    places = _ways(rng, times)
    while not in_sight(places):
        places = _ways(rng, times)
    return sim.Scene(
        bodies=yard(),
        targets=tuple(drone(rng, times, way[[0, -1]]) for way in places),
        lidar=os1(),
        sensor=sim.Hover(position=SENSOR),
        scans=scans,
    )


def _ways(rng: np.random.Generator, times: NDArray[np.float64]) -> NDArray[np.float64]:
    """Two straight paths, (2, 20, 3), whose closest approach is at `MIDDLE`."""
    azimuth, heading = rng.uniform(0, 2 * np.pi, 2)
    distance = rng.uniform(6.0, 13.0)
    centre = np.array(
        [distance * np.cos(azimuth), distance * np.sin(azimuth), rng.uniform(2.5, 6.0)]
    )
    turn = np.deg2rad(rng.uniform(*ANGLE_DEG)) * rng.choice([-1, 1])
    angles = np.array([heading, heading + turn])
    direction = np.stack([np.cos(angles), np.sin(angles), rng.uniform(-0.1, 0.1, 2)], axis=-1)
    velocity = rng.uniform(*SPEED, (2, 1)) * direction
    apart = np.cross(velocity[1] - velocity[0], rng.normal(size=3))
    apart *= rng.uniform(*APPROACH) / np.linalg.norm(apart)
    nearest = centre + np.array([[-0.5], [0.5]]) * apart
    seconds = np.linspace(times[0], times[-1], 20) - MIDDLE
    return np.asarray(nearest[:, None] + seconds[:, None] * velocity[:, None], np.float64)


def _rows(parts: list[Part]) -> list[Row]:
    found = [[scores(part, mode) for part in parts] for mode in MODES]
    switches = [[one.n_switches for one in mode] for mode in found]
    distance = [
        np.linalg.norm(np.diff(part["position"], axis=1)[:, 0], axis=1).min() for part in parts
    ]
    return [
        Row("crossings", "1", None, len(parts), len(parts)),
        Row("id switches", "1", None, *map(sum, switches)),
        Row("crossings with a switch", "1", None, *(sum(map(bool, one)) for one in switches)),
        *tracking_rows(found),
        Row("mean least distance at a scan", "m", None, *[float(np.mean(distance))] * 2),
    ]


ITEM = Item(
    name="flying-crossings",
    title="ids of drones that pass each other at 1-2 m",
    scans=100,
    minutes=6,
    measure=_measure,
    rows=_rows,
    draw=draw_numbers,
    grid="",
    heading="Crossings",
    counts="crossings",
)
