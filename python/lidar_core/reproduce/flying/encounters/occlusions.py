"""`flying-occlusions`: a drone is hidden by a building for 2 s, and keeps its track or not."""

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
    numbers,
    os1,
    scores,
    tracking_rows,
    yard,
)
from lidar_core.reproduce.flying.simulated.flights import both_modes
from lidar_core.reproduce.jobs import Part
from lidar_core.reproduce.types import Item, Measured, Request, Row
from lidar_core.sim import Body, Scene

SCANS = 64
MIDDLE, HIDDEN = 3.7, 2.0
"""Middle and length of the time behind the building [s]."""
SPEED = (1.5, 4.0)
"""[m/s]"""
ACCELERATION = 0.5
"""Greatest acceleration while it is hidden [m/s^2]; before and after there is none."""
THICKNESS, HEIGHT, GAP = 1.0, 10.0, 2.0
"""Of the building, and between it and the drone's way at the middle [m]."""
STEP = 0.05
"""Between points of the way [s]."""


def _measure(request: Request) -> Measured:
    parts = cases(occlusion, "flying-occlusions", request, SCANS)
    return Measured(
        (parts,),
        scans=len(parts),
        note=f"{len(parts)} drones at {SPEED[0]:g}-{SPEED[1]:g} m/s, hidden for about {HIDDEN:g} s"
        f" with up to {ACCELERATION:g} m/s^2 meanwhile. An id is kept if the track from before"
        " follows the drone at the end, and no other one in between.",
        config=both_modes(),
    )


def occlusion(*, seed: int, number: int, scans: int) -> Part:
    """Simulate one drone behind a building and track it with both modes."""
    return flown(_scene(np.random.default_rng([2, seed, number]), scans), seed)


def _scene(rng: np.random.Generator, scans: int) -> Scene:
    times = np.linspace(0.0, SCANS * 0.1, round(SCANS * 0.1 / STEP) + 1)
    while True:
        azimuth, distance, speed = rng.uniform([0, 9, SPEED[0]], [2 * np.pi, 14, SPEED[1]])
        places = _way(rng, times, azimuth, distance, speed)
        if in_sight(places):
            break
    near = rng.uniform(4.0, distance - GAP - THICKNESS)
    half_width = (speed * HIDDEN / 2 + sim.scenes.DRONE_RADIUS) * near / distance
    return sim.Scene(
        bodies=(*yard(), _building(azimuth, near, half_width)),
        targets=(drone(rng, times, places),),
        lidar=os1(),
        sensor=sim.Hover(position=SENSOR),
        scans=scans,
    )


def _building(azimuth: float, near: float, half_width: float) -> Body:
    """Make a wall across the line of sight; its front is `near` metres away."""
    centre = near + THICKNESS / 2
    return sim.Body(
        shape=sim.Box(size=(THICKNESS, 2 * half_width, HEIGHT)),
        position=(centre * np.cos(azimuth), centre * np.sin(azimuth), HEIGHT / 2),
        rotation=(0.0, 0.0, np.sin(azimuth / 2), np.cos(azimuth / 2)),
    )


def _way(
    rng: np.random.Generator,
    times: NDArray[np.float64],
    azimuth: float,
    distance: float,
    speed: float,
) -> NDArray[np.float64]:
    """Positions on a path across the line of sight, (K, 3) [m].

    The target accelerates only while it is hidden.
    """
    sight = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    across = np.array([-sight[1], sight[0], 0.0]) * rng.choice([-1, 1])
    slope = np.array([0.0, 0.0, rng.uniform(-0.05, 0.05)])
    velocity = speed * (across + rng.uniform(-0.15, 0.15) * sight + slope)
    acceleration = rng.normal(size=3) * [1.0, 1.0, 0.3]
    acceleration *= rng.uniform(0, ACCELERATION) / np.linalg.norm(acceleration)
    since = np.clip(times - (MIDDLE - HIDDEN / 2), 0, None)[:, None]
    during = np.minimum(since, HIDDEN)
    bend = acceleration * (during**2 / 2 + during * (since - during))
    height = np.array([0.0, 0.0, rng.uniform(2.5, 5.0)])
    return np.asarray(
        sight * distance + height + (times - MIDDLE)[:, None] * velocity + bend, np.float64
    )


def is_kept(part: Part, mode: str) -> bool:
    """Return whether the earlier track exists at the end, and no other track ever did."""
    table, hidden = numbers(part, mode)[:, 0], np.flatnonzero(part["hits"][:, 0] == 0)
    if not len(hidden) or not hidden[0]:
        return False
    is_same = table[hidden[0] - 1] == table[-1] >= 0
    return bool(is_same and len(set(table[table >= 0].tolist())) == 1)


def _rows(parts: list[Part]) -> list[Row]:
    kept = [np.mean([is_kept(part, mode) for part in parts]) for mode in MODES]
    found = [[scores(part, mode) for part in parts] for mode in MODES]
    hidden = float(np.mean([(part["hits"] == 0).sum() for part in parts])) * 0.1
    return [
        Row("occlusions", "1", None, len(parts), len(parts)),
        Row("share of ids kept", "1", None, *map(float, kept)),
        Row("mean time without a hit", "s", None, hidden, hidden),
        *tracking_rows(found),
    ]


ITEM = Item(
    name="flying-occlusions",
    title="ids of drones that are hidden for 2 s",
    scans=100,
    minutes=10,
    measure=_measure,
    rows=_rows,
    draw=draw_numbers,
    grid="",
    heading="Behind a building",
    counts="occlusions",
)
