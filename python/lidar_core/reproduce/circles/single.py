"""`circles-table4`, `-table5`, `-fig7`: one cylinder before a sensor that hovers or swings."""

from collections.abc import Mapping, Sequence
from typing import Any, TypeAlias

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
    both_modes,
    config_of,
    lasting,
    mapped,
    network_of,
)
from lidar_core.reproduce.common import BLUE, GREY, RED, mean, share, simulator_seed
from lidar_core.reproduce.jobs import Job, Part, run
from lidar_core.reproduce.types import Item, Measured, Request, Row
from lidar_core.sim import circle_scenes
from lidar_core.sim.circle_scenes import SensorMotion

Case: TypeAlias = tuple[float, int, float, str]
"""Radius [m], trajectory, speed [m/s], sensor."""
SENSORS: tuple[SensorMotion, SensorMotion] = ("hovering", "swinging")
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


RADIUS, TRAJECTORY, SPEED = 0.3, 2, 1.0
"""Of all runs of Table V and of Fig. 7; of Table IV and Fig. 7; of all rows without a speed."""
RADII = {
    0.1: (8.7482e-6, 0.0073, 0.0014, 0.0610, 0.0011, 0.0680),
    0.15: (1.1542e-5, 0.0097, 0.0014, 0.0638, 0.0012, 0.0715),
    0.3: (7.5769e-6, 0.0081, 0.0013, 0.0691, 0.0015, 0.0711),
    0.45: (7.7660e-6, 0.0075, 0.0013, 0.0735, 0.0014, 0.0714),
    0.6: (0.0019, 0.0751, 0.0054, 0.1552, 0.0012, 0.0724),
}
"""Table IV, by radius [m]: MSE and largest error of radius, x and y."""
TRAJECTORIES = {
    1: (1.3187e-5, 0.0088, 0.0012, 0.0628, 0.0016, 0.0766),
    2: (7.5769e-6, 0.0081, 0.0013, 0.0691, 0.0015, 0.0711),
    3: (9.2896e-6, 0.0141, 0.0015, 0.0725, 0.0013, 0.0632),
    4: (2.8435e-5, 0.0099, 0.0018, 0.0703, 0.0010, 0.0588),
    5: (1.8651e-5, 0.0111, 0.0014, 0.0795, 0.0016, 0.0792),
}
"""Table V, by trajectory: the same."""
NAMES = {1: "line", 2: "circle", 3: "eight", 4: "stop and go", 5: "wandering"}
"""Our ways; the paper does not say what its are."""


def single(
    *,
    seed: int,
    radius: float,
    trajectory: int,
    speed: float,
    sensor: SensorMotion,
    scans: int,
    network: str,
) -> Part:
    """Simulate and map one cylinder; `network` is that of `config_of`."""
    scene = circle_scenes.single(radius, trajectory, speed=speed, sensor=sensor, seed=seed)
    config = config_of(scene, network)
    return mapped(scene, config, seed=seed, scans=min(scans, scene.scans))


def runs(
    name: str, cases: Sequence[tuple[float, int]], request: Request
) -> dict[Mode, dict[Case, MapRun]]:
    """Run the given cases (radius, trajectory) with all speeds and both sensors, in both modes."""
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
    """Errors from `SETTLED` after the first report on, (N, 3) [m]; scans without one left out."""
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
    """Return the largest of each number over all runs, and lost and false elements."""
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
        ("present while visible", "1", share(reported, due)),
        ("reported within 0.5 s", "1", mean(delays <= CONFIRM_TIME)),
        ("changes of identity", "count", sum(one.switches() for one in some)),
        ("ghosts", "count", sum(lasting(one.ghosts()) for one in some)),
    ]


def draw_errors(figure: Any, panels: dict[str, MapRun]) -> None:
    """Draw errors of radius and centre over time, one column per run."""
    axes = figure.subplots(2, len(panels), sharex=True, sharey="row", squeeze=False)
    for column, (name, one) in zip(axes.T, panels.items(), strict=True):
        errors = 1e3 * one.errors(0)
        column[0].plot(one.seconds, errors[:, 2], color=BLUE, lw=0.8)
        column[1].plot(one.seconds, errors[:, 0], color=BLUE, lw=0.8, label="x")
        column[1].plot(one.seconds, errors[:, 1], color=RED, lw=0.8, label="y")
        column[0].set(title=name)
        column[1].set(xlabel="time [s]")
        for panel in column:
            panel.axhline(0, color=GREY, lw=0.8)
    axes[0, 0].set_ylabel("error of the radius [mm]")
    axes[1, 0].set_ylabel("error of the centre [mm]")
    axes[1, 0].legend(loc="upper right")


def _largest(values: NDArray[np.float64]) -> float | None:
    values = values[np.isfinite(values)]
    return float(values.max()) if len(values) else None


Found: TypeAlias = dict[Mode, dict[Case, MapRun]]


def _measure_radii(request: Request) -> Measured:
    found = runs("circles-table4", [(radius, TRAJECTORY) for radius in RADII], request)
    return _measured(
        {f"r = {radius:g} m": ((radius, TRAJECTORY), paper) for radius, paper in RADII.items()},
        {f"r = {radius:g} m": (radius, TRAJECTORY) for radius in RADII},
        found,
        "On a circle of 2 m, 4 m ahead; rows at 1 m/s, hovering and swinging sensor together;"
        " the worst of 0.3, 1 and 1.5 m/s below. Largest errors from 2 s after the first report"
        " on. Paper mode: the network paper-cnn and all stages as published.",
    )


def _measure_trajectories(request: Request) -> Measured:
    found = runs("circles-table5", [(RADIUS, number) for number in TRAJECTORIES], request)
    return _measured(
        {f"{key} {NAMES[key]}": ((RADIUS, key), paper) for key, paper in TRAJECTORIES.items()},
        {NAMES[key]: (RADIUS, key) for key in TRAJECTORIES},
        found,
        "Radius 0.3 m; rows at 1 m/s, hovering and swinging sensor together; the worst of"
        " 0.3, 1 and 1.5 m/s below. Largest errors from 2 s after the first report on. The paper"
        " does not define its trajectories. Paper mode: the network paper-cnn and all stages as"
        " published.",
    )


def _measured(
    table: Mapping[str, tuple[tuple[float, int], Sequence[float]]],
    shown: Mapping[str, tuple[float, int]],
    found: Found,
    note: str,
) -> Measured:
    """Return the measurements of an item from the runs `found`.

    `table` has the rows by name: radius and trajectory, and the paper's values. `shown` has the
    panels of the picture by name.
    """
    best = found["best"]
    return Measured(
        (table, found),
        scans=sum(len(one.seconds) for one in best.values()),
        note=note,
        config=both_modes(),
        drawn=({name: best[*case, SPEED, "swinging"] for name, case in shown.items()},),
    )


def _rows(
    table: Mapping[str, tuple[tuple[float, int], Sequence[float]]], found: Found
) -> list[Row]:
    listed: list[Row] = []
    for name, (case, paper) in table.items():
        some = {
            mode: [one for key, one in made.items() if key[:3] == (*case, SPEED)]
            for mode, made in found.items()
        }
        listed += rows(name, some, paper)
    return [*listed, *worst_rows({mode: list(made.values()) for mode, made in found.items()})]


def _measure_one(request: Request) -> Measured:
    scans = max(LEAST_SCANS, request.scans)
    made = {
        mode: MapRun.of(
            single(
                seed=simulator_seed(request.seed, 0),
                radius=RADIUS,
                trajectory=TRAJECTORY,
                speed=SPEED,
                sensor="swinging",
                scans=scans,
                network=network_of(mode),
            )
        )
        for mode in MODES
    }
    request.advance(scans)
    return Measured(
        (made,),
        scans=len(made["best"].seconds),
        note="Radius 0.3 m on a circle of 2 m at 1 m/s; the sensor moves and tilts."
        " Paper mode: the network paper-cnn and all stages as published. The picture: best mode.",
        config=both_modes(),
        drawn=(made["best"],),
    )


def _rows_of_one(made: Mapping[Mode, MapRun]) -> list[Row]:
    """Rows of Table V, and the mean errors of x, y and radius."""
    late = (settled(made[mode]) for mode in MODES)
    means = (one.mean(axis=0).tolist() if len(one) else [None] * 3 for one in late)
    some = {mode: [one] for mode, one in made.items()}
    return [
        *rows("trajectory 2", some, TRAJECTORIES[TRAJECTORY]),
        *(
            Row(f"trajectory 2: {name}, mean error", "m", None, *both)
            for name, *both in zip(("x", "y", "radius"), *means, strict=True)
        ),
    ]


def _draw_one(figure: Any, one: MapRun) -> None:
    """Draw truth and estimate above and errors below, as in the paper."""
    panels = figure.subplots(2, 3, sharex=True)
    errors = one.errors(0)
    center = one.part["center"][:, 0]
    radius = np.full(len(center), one.part["radius"][0])
    for column, name in enumerate(("x", "y", "radius")):
        truth = radius if name == "radius" else center[:, column]
        panels[0, column].plot(one.seconds, truth, color=BLUE, label="truth")
        panels[0, column].plot(
            one.seconds, truth + errors[:, column], color=RED, ls=":", label="map"
        )
        panels[1, column].plot(one.seconds, 1e3 * errors[:, column], color=RED, lw=0.8)
        panels[1, column].axhline(0, color=GREY, lw=0.8)
        panels[0, column].set(title=f"{name} [m]")
        panels[1, column].set(xlabel="time [s]")
    panels[0, 2].set_ylim(RADIUS - 0.02, RADIUS + 0.02)
    panels[0, 0].legend()
    panels[1, 0].set_ylabel("error [mm]")


TABLE4 = Item(
    name="circles-table4",
    title="single cylinders of five radii: errors of radius and centre (Table IV)",
    scans=36_000,
    minutes=2,
    measure=_measure_radii,
    rows=_rows,
    draw=draw_errors,
    heading="A cylinder on a circle, tilting sensor",
)
TABLE5 = Item(
    name="circles-table5",
    title="a cylinder on five ways: errors of radius and centre (Table V)",
    scans=30_000,
    minutes=2,
    measure=_measure_trajectories,
    rows=_rows,
    draw=draw_errors,
    heading="A cylinder of 0.3 m, tilting sensor",
)
FIG7 = Item(
    name="circles-fig7",
    title="place and radius of a cylinder over time (Fig. 7)",
    scans=1200,
    minutes=0.1,
    measure=_measure_one,
    rows=_rows_of_one,
    draw=_draw_one,
    heading="A cylinder of 0.3 m on a circle",
)
