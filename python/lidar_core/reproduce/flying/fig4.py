"""`flying-fig4`: drones on the ground count as part of it, and take off."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_core import sim
from lidar_core.evaluation import EvaluationConfig, pair
from lidar_core.flying import FlyingConfig
from lidar_core.reproduce.common import BLUE, GREY, KINDS, MODES, RED, Kind, scene_rng
from lidar_core.reproduce.flying.simulated.flights import both_modes, fly, tables
from lidar_core.reproduce.jobs import Part, flights, run
from lidar_core.reproduce.types import Item, Measured, Request, Row
from lidar_core.sim import Scene, Simulator

SCANS_PER_FLIGHT = 80
START, HEIGHT = 2.0, 3.5
"""Time of the start [s], and climb [m]."""
SPEEDS = (0.5, 1.0, 2.0, 3.0)
"""Greatest speed of each of the drones that take off together [m/s]."""
RESTING = 0.16
"""Height of the centre of a drone that stands on its skids [m]."""


def _measure(request: Request) -> Measured:
    jobs = flights("flying-fig4", flight, request, longest=SCANS_PER_FLIGHT)
    parts = run(jobs, request)
    return Measured(
        (parts,),
        scans=sum(job.scans for job in jobs),
        note=f"{len(jobs) * len(SPEEDS)} take-offs of a hexacopter, 6 to 14 m away; mean over those"
        " that were detected while the run lasted.",
        config=both_modes(),
    )


def flight(*, seed: int, number: int, scans: int) -> Part:
    """Simulate one flight and detect in it with both modes, with and without removal."""
    simulator = Simulator(_scene(seed, number, scans), seed=seed)
    return fly(simulator, _configs(), scans=scans)


def _configs() -> dict[str, FlyingConfig]:
    """Configurations of both modes, with and without the removal of separate background.

    Without removal, no group of occupied voxels counts as too small.
    """
    configs = both_modes()
    for name, config in both_modes().items():
        separate = config.separate.model_copy(update={"min_confident": 0})
        configs[f"{name}_without"] = config.model_copy(update={"separate": separate})
    return configs


def _scene(seed: int, number: int, scans: int) -> Scene:
    """Make four drones on the ground around a hovering sensor; no noise, as in the paper."""
    rng = scene_rng(seed, number)
    azimuth = np.pi / 2 * np.arange(4) + rng.uniform(-0.5, 0.5, 4)
    distance = rng.permutation(np.linspace(6, 14, 4)) + rng.uniform(-0.5, 0.5, 4)
    places = distance[:, None] * np.stack([np.cos(azimuth), np.sin(azimuth)], axis=-1)
    targets = tuple(
        sim.Target(
            shape=sim.Hexacopter(),
            motion=sim.TakeOff(position=(x, y, RESTING), height=HEIGHT, start=START, speed=speed),
        )
        for (x, y), speed in zip(places.tolist(), rng.permutation(SPEEDS).tolist(), strict=True)
    )
    keep_clear = np.concatenate([places, [[0.0, 0.0]]])
    return sim.Scene(
        bodies=sim.scenes.street(int(rng.integers(2**31)), keep_clear=keep_clear, clearance=3.0),
        targets=targets,
        lidar=sim.LidarModel.preset("os1-128", ideal=True, snapshot=True, range_std=0.0),
        sensor=sim.Hover(position=(0.0, 0.0, 2.5)),
        scans=scans,
    )


def first_scans(part: Part, name: str, kind: Kind) -> NDArray[np.float64]:
    """Return the first scan after the start in which each drone is found; infinite for none."""
    start = np.searchsorted(part["stamp_ns"], round(START * 1e9), side="right")
    config = EvaluationConfig()
    drones = len(part["id"])
    is_found = pair(*tables(part, name, kind, config=config), config=config).estimate_of >= 0
    is_found = is_found.reshape(-1, drones)[start:]
    if not len(is_found):
        return np.full(drones, np.inf)
    first = np.where(is_found.any(axis=0), start + is_found.argmax(axis=0), np.inf)
    return np.asarray(first, np.float64)


def _rows(parts: list[Part]) -> list[Row]:
    rows: list[Row] = []
    for removal, suffix in (("", ""), (", without removal", "_without")):
        for kind in KINDS:
            paper, best = (_summary(parts, mode + suffix, kind) for mode in MODES)
            what = kind.removesuffix("s") + removal
            names = (f"time to first {what}", f"height at first {what}", f"share with a {what}")
            rows += map(Row, names, ("s", "m", "1"), (None,) * 3, paper, best)
    return rows


def _summary(parts: list[Part], name: str, kind: Kind) -> tuple[float | None, float | None, float]:
    """Mean time after the start and mean climb until drones are found; share that are found."""
    times, climbs, count = [], [], 0
    for part in parts:
        first = first_scans(part, name, kind)
        count += len(first)
        for target in np.flatnonzero(np.isfinite(first)):
            scan = int(first[target])
            times.append(part["stamp_ns"][scan] * 1e-9 - START)
            climbs.append(part["position"][scan, target, 2] - RESTING)
    share = len(times) / count
    return (float(np.mean(times)), float(np.mean(climbs)), share) if times else (None, None, share)


def _draw(figure: Any, parts: list[Part]) -> None:
    """Draw heights over time, with the first detections."""
    panels = figure.subplots(1, 2, sharey=True)
    drones = sum(len(part["id"]) for part in parts)
    for axes, mode in zip(panels, MODES, strict=True):
        for part in parts:
            axes.plot(_seconds(part), part["position"][:, :, 2], color=GREY, lw=0.8)
        for name, marker, colour, what in (
            (mode, "o", BLUE, "with removal"),
            (f"{mode}_without", "x", RED, "without removal"),
        ):
            points = np.concatenate([_first_points(part, name) for part in parts])
            label = f"{what}: {len(points)} of {drones}"
            axes.plot(*points.T, marker, color=colour, ms=6, mfc="none", label=label)
        axes.set(title=f"{mode} mode", xlabel="time after the start [s]")
        axes.legend(loc="lower right")
    panels[0].set_ylabel("height of the centre [m]")


def _first_points(part: Part, name: str) -> NDArray[np.float64]:
    """Time after the start and height at the first detection of every drone that has one."""
    first = first_scans(part, name, "detections")
    target = np.flatnonzero(np.isfinite(first))
    scan = first[target].astype(int)
    return np.stack([_seconds(part)[scan], part["position"][scan, target, 2]], axis=-1)


def _seconds(part: Part) -> NDArray[np.float64]:
    return np.asarray(part["stamp_ns"] * 1e-9 - START, np.float64)


ITEM = Item(
    name="flying-fig4",
    title="take-off from the ground, with and without removal of separate background",
    scans=160,
    minutes=6,
    measure=_measure,
    rows=_rows,
    draw=_draw,
    heading="Take-off: first detections",
)
