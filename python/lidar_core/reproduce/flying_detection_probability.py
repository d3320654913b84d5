"""`flying-detection-probability`: is a target met by a ray at all? Eq. 49 against scans."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_core.flying import detection_probability
from lidar_core.reproduce.jobs import Job, Part, run
from lidar_core.reproduce.types import Item, Request, Result, Row

SENSORS = {"os0-128": (10.0, 20.0, 30.0, 40.0, 49.0), "os1-128": (20.0, 40.0, 60.0, 80.0, 98.0)}
"""Distances up to the greatest range of each [m]."""
RADIUS = 0.325
"""Of the paper's target [m]."""
TARGETS = 64
"""Targets in a scan."""


def _run(request: Request) -> Result:
    cases = sum(map(len, SENSORS.values()))
    scans = max(1, request.scans // cases)
    same = {"seed": request.seed, "scans": scans}
    jobs = [
        Job(f"detection-probability-{request.seed}-{name}-{distance:g}-{scans}", share,
            {"sensor": name, "distance": distance, **same}, scans)
        for name, distances in SENSORS.items() for distance in distances
    ]  # fmt: skip
    parts = dict(zip([job.name for job in jobs], run(jobs, request), strict=True))
    return Result(
        rows=tuple(_rows(list(parts.values()))),
        draw=lambda figure: _draw(figure, list(parts.values())),
        scans=scans * cases,
        note=f"Balls of {RADIUS} m, their centres anywhere in the sensor's vertical field of view;"
        f" {scans * TARGETS} of them per point. Predicted: eq. 49; simulated: share with at least"
        " one hit. The paper gives no numbers; both modes are one.",
    )


def share(*, sensor: str, distance: float, seed: int, scans: int) -> Part:
    """Predict the probability, and simulate scans with targets at random places."""
    from lidar_core import sim

    lidar = sim.LidarModel.preset(sensor, snapshot=True, range_std=0.0)
    elevations = np.radians(getattr(lidar.pattern, "elevations_deg", (-30.0, 30.0)))
    view = float(elevations.min()), float(elevations.max())
    rng = np.random.default_rng([20240607, seed, round(distance)])
    met, made = [], None
    for number in range(scans):
        places = distance * _apart(rng, view, 3 * RADIUS / distance)
        ball = sim.Sphere(radius=RADIUS)
        targets = [sim.Target(shape=ball, motion=sim.Hover(position=tuple(place)))
                   for place in places.tolist()]  # fmt: skip
        scene = sim.Scene(bodies=(), targets=tuple(targets), lidar=lidar,
                          sensor=sim.Hover(position=(0.0, 0.0, 0.0)), scans=1)  # fmt: skip
        made = sim.Simulator(scene, seed=number).scan(0)
        met.append(made.truth.hits > 0)
    directions = np.empty((0, 3)) if made is None else np.asarray(made.scan.directions)
    predicted = detection_probability(
        directions.reshape(-1, 3), radius=RADIUS, distance=distance, field_of_view=view
    )
    return {
        "name": np.array(f"{sensor}@{distance:g}m"),
        "predicted": predicted,
        "met": np.concatenate(met),
    }


def _apart(rng: np.random.Generator, view: tuple[float, float], gap: float) -> NDArray[np.float64]:
    """Directions (TARGETS, 3), evenly over the band, none within `gap` of another [rad]."""
    chosen: list[NDArray[np.float64]] = []
    while len(chosen) < TARGETS:
        height = rng.uniform(np.sin(view[0]), np.sin(view[1]))
        azimuth, flat = rng.uniform(-np.pi, np.pi), np.sqrt(1 - height**2)
        direction = np.array([flat * np.cos(azimuth), flat * np.sin(azimuth), height])
        if all(np.linalg.norm(direction - other) > gap for other in chosen):
            chosen.append(direction)
    return np.array(chosen)


def _rows(parts: list[Part]) -> list[Row]:
    rows = []
    for part in parts:
        predicted, met = float(part["predicted"][0]), float(part["met"].mean())
        for what, value in (("predicted", predicted), ("simulated", met),
                            ("difference", abs(predicted - met))):  # fmt: skip
            rows.append(Row(f"{what}, {part['name']}", "1", None, value, value))
    return rows


def _draw(figure: Any, parts: list[Part]) -> None:
    axes = figure.subplots()
    figure.suptitle("Is a target met by a ray?", x=0.06, ha="left", fontweight="bold")
    for (sensor, distances), colour in zip(SENSORS.items(), ("#be185d", "#0369a1"), strict=True):
        own = [part for part in parts if str(part["name"]).startswith(sensor)]
        axes.plot(distances, [part["predicted"][0] for part in own], color=colour,
                  label=f"{sensor}, eq. 49")  # fmt: skip
        axes.plot(distances, [part["met"].mean() for part in own], "x", color=colour,
                  label=f"{sensor}, simulated")  # fmt: skip
    axes.set(xlabel="distance [m]", ylabel="probability", ylim=(0, 1.05))
    axes.grid(visible=True)
    axes.legend()


ITEM = Item(
    name="flying-detection-probability",
    title="probability that a target is met by a ray, over distance (sec. IV-C)",
    scans=1600,
    minutes=10,
    run=_run,
)
