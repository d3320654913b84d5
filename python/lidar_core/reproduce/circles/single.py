"""Single cylinders on their ways, in front of a sensor that hovers or swings: Tables IV and V."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from lidar_core.reproduce.circles.runs import (
    CONFIRM_TIME,
    MODES,
    SETTLED,
    MapRun,
    Measure,
    Mode,
    both,
    config_of,
    lasting,
    mapped,
    network_of,
)
from lidar_core.reproduce.common import BLUE, GREY, RED, simulator_seed
from lidar_core.reproduce.jobs import Job, Part, run
from lidar_core.reproduce.types import Request, Row

if TYPE_CHECKING:
    from lidar_core.sim.circle_scenes import SensorMotion

Case: TypeAlias = tuple[float, int, float, str]
"""Radius [m], trajectory, speed [m/s], sensor."""
SENSORS: "tuple[SensorMotion, SensorMotion]" = ("hovering", "swinging")
SPEEDS = (1.0, 0.3, 1.5)
"""[m/s]; the first is that of the rows without a speed."""
LEAST_SCANS = 60
"""Of a short run: the largest errors count after 2 s."""
QUANTITIES = (
    ("radius, MSE", "m^2"),
    ("radius, largest error", "m"),
    ("x, MSE", "m^2"),
    ("x, largest error", "m"),
    ("y, MSE", "m^2"),
    ("y, largest error", "m"),
)
COLUMNS = (2, 0, 1)
"""Columns of errors in the order of `QUANTITIES`."""


def single(
    *,
    seed: int,
    radius: float,
    trajectory: int,
    speed: float,
    sensor: "SensorMotion",
    scans: int,
    network: str,
) -> Part:
    """Simulate and map one cylinder; `network` is that of `config_of`."""
    from lidar_core.sim import circle_scenes

    scene = circle_scenes.single(radius, trajectory, speed=speed, sensor=sensor, seed=seed)
    config = config_of(scene, network)
    return mapped(scene, config, seed=seed, scans=min(scans, scene.scans))


def runs(
    name: str, cases: Sequence[tuple[float, int]], request: Request
) -> dict[Mode, dict[Case, MapRun]]:
    """All speeds and both sensors for cases of radius and trajectory, in both modes."""
    keys = [
        (radius, trajectory, speed, sensor)
        for radius, trajectory in cases
        for speed in SPEEDS
        for sensor in SENSORS
    ]
    scans = max(LEAST_SCANS, request.scans // len(keys))
    jobs = [
        Job(
            name=f"{name}-{request.seed}-{mode}-{radius:g}-{trajectory}-{speed:g}-{sensor}",
            function=single,
            arguments={
                "seed": simulator_seed(request.seed, number),
                "radius": radius,
                "trajectory": trajectory,
                "speed": speed,
                "sensor": sensor,
                "scans": scans,
                "network": network_of(mode),
            },
            scans=scans // len(MODES),
        )
        for mode in MODES
        for number, (radius, trajectory, speed, sensor) in enumerate(keys)
    ]
    parts = iter(run(jobs, request))
    return {mode: {key: MapRun.of(next(parts)) for key in keys} for mode in MODES}


def settled(one: MapRun) -> NDArray[np.float64]:
    """Errors from `SETTLED` after the first report on, (N, 3), without gaps."""
    errors = one.errors(0)
    known = np.isfinite(errors[:, 0])
    if not known.any():
        return np.zeros((0, 3))
    is_late = one.seconds >= one.seconds[known][0] + SETTLED - 1e-6
    late: NDArray[np.float64] = errors[known & is_late]
    return late


def numbers(some: Sequence[MapRun]) -> list[float | None]:
    """Values of `QUANTITIES` over runs; None where nothing was reported."""
    every = np.concatenate([one.errors(0) for one in some])
    every = every[np.isfinite(every[:, 0])]
    late = np.concatenate([settled(one) for one in some])
    found: list[float | None] = []
    for column in COLUMNS:
        found.append(float(np.mean(every[:, column] ** 2)) if len(every) else None)
        found.append(float(np.abs(late[:, column]).max()) if len(late) else None)
    return found


def rows(
    name: str,
    some: Mapping[Mode, Sequence[MapRun]],
    paper: Sequence[float | None] = (None,) * 6,
) -> list[Row]:
    """Rows of `QUANTITIES` over runs, beside those of the paper."""
    columns = (paper, *(numbers(some[mode]) for mode in MODES))
    return [
        Row(f"{name}: {what}", unit, *values)
        for (what, unit), *values in zip(QUANTITIES, *columns, strict=True)
    ]


def worst_rows(some: Mapping[Mode, Sequence[MapRun]]) -> tuple[Row, ...]:
    """Over all runs: the largest of each number, and what the map lost or made up."""
    return both(_worst(some["paper"]), _worst(some["best"]))


def _worst(some: Sequence[MapRun]) -> list[Measure]:
    table = np.array([numbers([one]) for one in some], np.float64).T
    worst: list[Measure] = [
        (f"worst of {len(some)} runs: {what}", unit, _largest(column))
        for (what, unit), column in zip(QUANTITIES, table, strict=True)
    ]
    reported, due = np.sum([one.presence() for one in some], axis=0).tolist()
    delays = np.concatenate([one.delays() for one in some])
    return [
        *worst,
        ("present while visible", "1", reported / due if due else None),
        ("reported within 0.5 s", "1", share_of(delays <= CONFIRM_TIME)),
        ("changes of identity", "count", sum(one.switches() for one in some)),
        ("ghosts", "count", sum(lasting(one.ghosts()) for one in some)),
    ]


def draw_errors(figure: Any, panels: dict[str, MapRun], title: str) -> None:
    """Errors of radius and centre over time, a column for each run."""
    axes = figure.subplots(2, len(panels), sharex=True, sharey="row", squeeze=False)
    figure.suptitle(title, x=0.06, ha="left", fontweight="bold")
    for column, (name, one) in zip(axes.T, panels.items(), strict=True):
        errors = 1e3 * one.errors(0)
        column[0].plot(one.seconds, errors[:, 2], color=BLUE, lw=0.8)
        column[1].plot(one.seconds, errors[:, 0], color=BLUE, lw=0.8, label="x")
        column[1].plot(one.seconds, errors[:, 1], color=RED, lw=0.8, label="y")
        column[0].set(title=name)
        column[1].set(xlabel="time [s]")
        for panel in column:
            panel.axhline(0, color=GREY, lw=0.8)
            panel.grid(visible=True)
    axes[0, 0].set_ylabel("error of the radius [mm]")
    axes[1, 0].set_ylabel("error of the centre [mm]")
    axes[1, 0].legend(loc="upper right")


def share_of(is_good: NDArray[np.bool_]) -> float | None:
    """Share of what is true; None of nothing."""
    return float(is_good.mean()) if len(is_good) else None


def _largest(values: NDArray[np.float64]) -> float | None:
    values = values[np.isfinite(values)]
    return float(values.max()) if len(values) else None
