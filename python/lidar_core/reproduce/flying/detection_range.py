"""`flying-range`: drones 20 to 35 m away."""

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_core import sim
from lidar_core.evaluation import EvaluationConfig, score_tracks
from lidar_core.flying import FlyingConfig
from lidar_core.reproduce.common import (
    COLOURS,
    KINDS,
    MODES,
    Kind,
    mean,
    middles,
    scene_rng,
    simulator_seed,
)
from lidar_core.reproduce.flying.simulated.flights import both_modes, fly, tables
from lidar_core.reproduce.flying.simulated.sightings import sightings
from lidar_core.reproduce.jobs import Part, flights, run
from lidar_core.reproduce.types import Item, Measured, Request, Row
from lidar_core.sim import Body, Scene, Simulator, scenes

SCANS_PER_FLIGHT = 100
RADIUS = 0.325
RANGE_STD = 0.03
EDGES = (20.0, 22.5, 25.0, 27.5, 30.0, 32.5, 35.0)
"""Groups by distance [m]; the first and the last are the limits of the flights."""
FAR = 50.0
"""The larger d_max [m]."""
SHAPES = ("sphere", "mesh")
HOUSES, TREES = slice(1, 4), slice(31, None)
"""Bodies of a street that stand in the open country."""


def _measure(request: Request) -> Measured:
    todo = flights("flying-range", flight, request, longest=SCANS_PER_FLIGHT)
    parts = run(todo, request)
    return Measured(
        (parts,),
        scans=sum(job.scans for job in todo),
        note=f"Counted: after the burn-in, 20 to 35 m away, at least 3 rays on the drone. Ranges"
        f" with {RANGE_STD} m, exact poses.",
        config={**configs(), "evaluation": _evaluation()},
    )


def configs() -> dict[str, FlyingConfig]:
    """Configurations of both modes with d_max 20 m and 50 m, by name."""
    modes = both_modes()
    far = modes["paper"].voxel_map.model_copy(update={"max_range": FAR})
    return {
        **modes,
        "paper_far": modes["paper"].model_copy(update={"voxel_map": far}),
        "best_far": FlyingConfig.long_range(),
    }


def flight(*, seed: int, number: int, scans: int) -> Part:
    """Simulate one flight and detect in it with all configurations."""
    name = simulator_seed(seed, number)
    simulator = Simulator(_scene(seed, number, scans), seed=name)
    return fly(simulator, configs(), scans=scans)


def _scene(seed: int, number: int, scans: int) -> Scene:
    """Make open country: ground, three houses, ten trees; a moving sensor and two drones."""
    rng = scene_rng(seed, number)
    motion = sim.RandomMotion(
        box_min=(-45.0, -45.0, 2.0),
        box_max=(45.0, 45.0, 14.0),
        sensor_distance=(EDGES[0], EDGES[-1]),
        sensor_elevation_deg=(-19.0, 19.0),
    )
    sensor = sim.Loop(
        center=(0.0, 0.0, 3.0),
        straight=8.0,
        radius=2.0,
        speed=3.0,
        start=float(rng.uniform(0, 28)),
        yaw_rate=0.2,
        tilt_deg=2.0,
    )
    return sim.Scene(
        bodies=_country(int(rng.integers(2**31)), sensor),
        targets=tuple(
            sim.Target(shape=shape, motion=motion)
            for shape in (sim.Sphere(radius=RADIUS), sim.Hexacopter(radius=RADIUS))
        ),
        lidar=sim.LidarModel.preset("os1-128", ideal=True, range_std=RANGE_STD),
        sensor=sensor,
        scans=scans,
    )


def _country(seed: int, sensor: Any) -> tuple[Body, ...]:
    way = sensor.knots(10.0)[1][::25, :2, 3]
    street = scenes.street(seed, keep_clear=way, clearance=4.0)
    return (street[0], *street[HOUSES], *street[TREES])


def _evaluation() -> EvaluationConfig:
    return EvaluationConfig(max_distance=EDGES[-1])


def _distances_and_errors(
    parts: Sequence[Part], name: str, kind: Kind, shape: str
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Distances of the sightings of `shape` that count [m], and errors [m]; NaN if not found."""
    seen = sightings(parts, name, kind, target=SHAPES.index(shape), config=_evaluation())
    counts = seen.distance >= EDGES[0]
    return seen.distance[counts], seen.error[counts]


def _rows(parts: Sequence[Part]) -> list[Row]:
    rows = []
    for shape in SHAPES:
        count = float(len(_distances_and_errors(parts, "best_far", "tracks", shape)[0]))
        rows.append(Row(f"sightings, {shape}", "1", None, count, count))
        for what, suffix in (("d_max 50 m", "_far"), ("d_max 20 m", "")):
            for kind in KINDS:
                values = [
                    _distances_and_errors(parts, mode + suffix, kind, shape)[1] for mode in MODES
                ]
                recall = (mean(np.isfinite(one)) for one in values)
                error = (mean(one[np.isfinite(one)]) for one in values)
                rows.append(Row(f"recall of {kind}, {shape}, {what}", "1", None, *recall))
                rows.append(Row(f"error of {kind}, {shape}, {what}", "m", None, *error))
        for kind in KINDS:
            curves = [_curve(parts, f"{mode}_far", kind, shape) for mode in MODES]
            rows += [
                Row(f"recall of {kind}, {shape}@{middle:g}m", "1", None, paper, best)
                for middle, paper, best in zip(middles(EDGES), *curves, strict=True)
            ]
    false = [_false_tracks(parts, f"{mode}_far") for mode in MODES]
    return [*rows, Row("false tracks, d_max 50 m", "1", None, *false)]


def _curve(parts: Sequence[Part], name: str, kind: Kind, shape: str) -> list[float | None]:
    """Recall per group of distances; None where there is nothing to find."""
    distance, error = _distances_and_errors(parts, name, kind, shape)
    groups = ((distance > near) & (distance <= far) for near, far in pairwise(EDGES))
    return [mean(np.isfinite(error[group])) for group in groups]


def _false_tracks(parts: Sequence[Part], name: str) -> float:
    config = _evaluation()
    return float(
        sum(
            len(score_tracks(*tables(part, name, "tracks", config=config), config=config).false_ids)
            for part in parts
        )
    )


def _draw(figure: Any, parts: Sequence[Part]) -> None:
    """Draw recall over distance, one panel per shape."""
    panels = figure.subplots(1, len(SHAPES), sharey=True)
    for panel, shape in zip(panels, SHAPES, strict=True):
        for mode, colour in ((mode, COLOURS[mode]) for mode in MODES):
            for kind, line in zip(KINDS, ("-", "--"), strict=True):
                curve = np.array(_curve(parts, f"{mode}_far", kind, shape), float)
                panel.plot(
                    middles(EDGES),
                    curve,
                    line,
                    marker=".",
                    color=colour,
                    label=f"{mode} mode, {kind}",
                )
        panel.set(title=shape, xlabel="distance [m]", ylim=(0, 1.05))
    panels[0].set_ylabel("recall")
    panels[0].legend(loc="lower left", fontsize=8)


ITEM = Item(
    name="flying-range",
    title="drones 20 to 35 m away: recall and error, d_max 20 m and 50 m",
    scans=600,
    minutes=4,
    measure=_measure,
    rows=_rows,
    draw=_draw,
    heading="Far drones, d_max 50 m",
)
