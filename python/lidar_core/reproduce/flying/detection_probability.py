"""`flying-detection-probability`: does any ray hit a target? Eq. 49 against scans."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_core import sim
from lidar_core.flying import detection_probability
from lidar_core.reproduce.common import BLUE, RED, scene_rng
from lidar_core.reproduce.jobs import Job, Part, run
from lidar_core.reproduce.types import Item, Measured, Request, Row
from lidar_core.sim import LidarModel

SENSORS = {"os0-128": (5.0, 10.0, 20.0, 35.0, 49.0), "os1-128": (10.0, 25.0, 50.0, 75.0, 98.0)}
"""Distances up to the greatest range of each [m]."""
RADIUS = 0.325
"""Of the paper's target [m]."""
TARGETS = 64
"""Targets in a scan."""
GOAL = 0.01
"""Greatest difference of the probabilities that is asked for (no unit)."""
TRIES = 100
"""Places that are tried for a target before it may overlap another."""
COLOURS = (RED, "#f472b6", BLUE, "#38bdf8")


def _measure(request: Request) -> Measured:
    cases = [
        {"sensor": sensor, "distance": distance, "whole": whole}
        for sensor, distances in SENSORS.items()
        for whole in (True, False)
        for distance in distances
    ]
    scans = max(1, request.scans // len(cases))
    same = {"seed": request.seed, "scans": scans}
    jobs = [
        Job(f"detection-probability-{request.seed}-{number}-{scans}", share, case | same, scans)
        for number, case in enumerate(cases)
    ]
    parts = run(jobs, request)
    return Measured(
        (parts,),
        scans=scans * len(cases),
        note=f"Balls of {RADIUS} m, their centres anywhere on the sphere (eq. 47) or in the"
        f" vertical field of view; {scans * TARGETS} of them per point. Predicted: eq. 49;"
        " simulated: share with at least one hit, and its standard error. Goal: they differ by"
        f" {GOAL} at most. The paper gives no numbers; both modes are one.",
    )


def share(*, sensor: str, distance: float, whole: bool, seed: int, scans: int) -> Part:
    """Predict the probability that a ray hits a target; simulate targets at random places."""
    lidar = sim.LidarModel.preset(sensor, ideal=True, snapshot=True, range_std=0.0)
    view = (-np.pi / 2, np.pi / 2) if whole else _field_of_view(lidar)
    rng = scene_rng(seed, round(distance), int(whole))
    ball, observer = sim.Sphere(radius=RADIUS), sim.Hover(position=(0.0, 0.0, 0.0))
    met, directions = [], np.empty((0, 3))
    for number in range(scans):
        places = distance * _apart(rng, view, 3 * RADIUS / distance)
        targets = [
            sim.Target(shape=ball, motion=sim.Hover(position=tuple(place)))
            for place in places.tolist()
        ]
        scene = sim.Scene(bodies=(), targets=tuple(targets), lidar=lidar, sensor=observer, scans=1)
        made = sim.Simulator(scene, seed=number).scan(0)
        met.append(made.truth.hits > 0)
        directions = np.asarray(made.scan.directions, np.float64).reshape(-1, 3)
    predicted = detection_probability(
        directions, radius=RADIUS, distance=distance, field_of_view=view
    )
    what = "whole sphere" if whole else "field of view"
    return {
        "name": np.array(f"{sensor}, {what}@{distance:g}m"),
        "distance": np.array(distance),
        "predicted": predicted,
        "met": np.concatenate(met),
    }


def _field_of_view(lidar: LidarModel) -> tuple[float, float]:
    """Least and largest elevation of a spinning LiDAR [rad]."""
    elevations = np.radians(getattr(lidar.pattern, "elevations_deg", (-90.0, 90.0)))
    return float(elevations.min()), float(elevations.max())


def _apart(rng: np.random.Generator, view: tuple[float, float], gap: float) -> NDArray[np.float64]:
    """Draw directions (TARGETS, 3), uniform over the band `view`, at least `gap` [rad] apart.

    One in each of as many bands of equal area: the share that is met scatters less.
    """
    shares = (rng.permutation(TARGETS) + rng.uniform(size=TARGETS)) / TARGETS
    low, high = np.sin(view)
    chosen: list[NDArray[np.float64]] = []
    for height in low + (high - low) * shares:
        flat = np.sqrt(1 - height**2)
        for _ in range(TRIES):
            azimuth = rng.uniform(-np.pi, np.pi)
            direction = np.array([flat * np.cos(azimuth), flat * np.sin(azimuth), height])
            if all(np.linalg.norm(direction - other) > gap for other in chosen):
                break
        chosen.append(direction)
    return np.array(chosen)


def _rows(parts: list[Part]) -> list[Row]:
    rows = []
    for part in parts:
        predicted, met = float(part["predicted"][0]), float(part["met"].mean())
        for what, value in (
            ("predicted", predicted),
            ("simulated", met),
            ("difference", abs(predicted - met)),
        ):
            rows.append(Row(f"{what}, {part['name']}", "1", None, value, value))
        error = standard_error(part)
        rows.append(Row(f"standard error, {part['name']}", "1", None, error, error))
    return rows


def standard_error(part: Part) -> float | None:
    """Standard error of the simulated share, from its spread over scans; None for a single scan."""
    shares = part["met"].reshape(-1, TARGETS).mean(axis=1)
    return float(shares.std(ddof=1) / np.sqrt(len(shares))) if len(shares) > 1 else None


def _draw(figure: Any, parts: list[Part]) -> None:
    """Draw one curve per sensor and region."""
    axes = figure.subplots()
    curves: dict[str, list[Part]] = {}
    for part in parts:
        curves.setdefault(str(part["name"]).partition("@")[0], []).append(part)
    for (label, own), colour in zip(curves.items(), COLOURS, strict=True):
        distances = [float(part["distance"]) for part in own]
        axes.plot(distances, [part["predicted"][0] for part in own], color=colour, label=label)
        axes.plot(distances, [part["met"].mean() for part in own], "x", color=colour)
    axes.set(xlabel="distance [m]", ylabel="probability", ylim=(0, 1.05))
    axes.legend(title="lines: eq. 49; x: simulated", fontsize=8)


ITEM = Item(
    name="flying-detection-probability",
    title="probability that a target is met by a ray, over distance (sec. IV-C)",
    scans=1600,
    minutes=3,
    measure=_measure,
    rows=_rows,
    draw=_draw,
    heading="Is a target met by a ray?",
)
