"""`flying-fig8`: the three real flights, simulated: manual, following, interception."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_core import sim
from lidar_core.reproduce.common import KINDS, MODES, Kind, evaluation_config
from lidar_core.reproduce.flying.simulated.flights import both_modes, fly
from lidar_core.reproduce.flying.simulated.pursuit import (
    FOLLOW_DISTANCE,
    Interceptor,
    follow,
    pursue,
)
from lidar_core.reproduce.flying.simulated.sightings import Sightings, sightings
from lidar_core.reproduce.jobs import Job, Part, run
from lidar_core.reproduce.types import Item, Measured, Request, Row
from lidar_core.sim import NoisyPoses, PoseNoise, Scene, Simulator

SCANS_PER_FLIGHT = 200
FLIGHTS = ("manual", "following", "interception")
PAPER = {"detections": (0.92, 0.98), "tracks": (0.91, 0.76)}
"""Mean and standard deviation of the position error [m], Table III, real world."""
FIELD = 12.0
"""Half the side of the open field in the street [m]."""
START = (-8.0, 0.0, 4.0)
HEIGHTS = (2.5, 7.0)
PASS = 3.0
"""Approaches nearer than this are counted as passes [m]."""

Parts = Mapping[tuple[str, str], Sequence[Part]]
"""Flights by their kind and mode."""


def _measure(request: Request) -> Measured:
    each = max(1, min(SCANS_PER_FLIGHT, request.scans // len(FLIGHTS)))
    rounds = max(1, round(request.scans / (len(FLIGHTS) * SCANS_PER_FLIGHT)))
    todo = list(_jobs(request.seed, rounds, each))
    made = dict(zip([job.name for job in todo], run(todo, request), strict=True))
    parts = {
        (kind, mode): [
            part
            for name, part in made.items()
            if f"-{kind}-" in name and (kind == "manual" or f"-{mode}-" in name)
        ]
        for kind in FLIGHTS
        for mode in MODES
    }
    noise = _noise()
    return Measured(
        (parts,),
        scans=rounds * each * len(FLIGHTS),
        note=f"OS0-128; ranges 0.03 m; poses {noise.position_std:g} m / {noise.angle_std_deg:g} deg"
        f" per axis, forgotten in {noise.time_constant:g} s. Following and interception are closed"
        " loops: each mode flies by its own tracks. The paper's numbers are those of real flights,"
        " all three together.",
        config={**both_modes(), "pose_noise": noise, "evaluation": evaluation_config()},
    )


def _jobs(seed: int, rounds: int, scans: int) -> Iterator[Job]:
    for number in range(rounds):
        for kind in FLIGHTS:
            for mode in ("both",) if kind == "manual" else MODES:
                arguments = {
                    "kind": kind,
                    "mode": mode,
                    "seed": seed,
                    "number": number,
                    "scans": scans,
                }
                share = scans if mode != "best" else 0  # both modes fly the same scans
                yield Job(f"fig8-{seed}-{kind}-{mode}-{number}-{scans}", flight, arguments, share)


def flight(*, kind: str, mode: str, seed: int, number: int, scans: int) -> Part:
    """Simulate one flight; `mode` is both for the manual one, which no detector steers."""
    name = (seed * 1_000_003 + 10 * number + FLIGHTS.index(kind)) % 2**32
    simulator = Simulator(scene(kind, name, scans), seed=name)
    noise = NoisyPoses(_noise(), seed=name)
    if kind == "manual":
        return fly(simulator, both_modes(), scans=scans, noise=noise)
    low, high = (
        np.array([side, side, height])
        for side, height in zip((-FIELD - 2, FIELD + 2), HEIGHTS, strict=True)
    )
    guide = follow if kind == "following" else Interceptor()
    config = both_modes()[mode]
    return pursue(simulator, mode, config, guide, scans=scans, noise=noise, box=(low, high))


def scene(kind: str, name: int, scans: int) -> Scene:
    """Make a street with an open field, a hexacopter over it, and the observer."""
    side = np.arange(-FIELD - 2, FIELD + 3, 2.0)
    field = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    fast = kind == "manual"
    loop = sim.Loop(
        center=(0.0, 0.0, 4.0), straight=8.0, radius=4.0, speed=3.0, yaw_rate=0.2, tilt_deg=5.0
    )
    return sim.Scene(
        bodies=sim.scenes.street(name, keep_clear=field, clearance=2.5),
        targets=(
            sim.Target(
                shape=sim.Hexacopter(),
                motion=sim.RandomMotion(
                    box_min=(-FIELD, -FIELD, HEIGHTS[0]),
                    box_max=(FIELD, FIELD, HEIGHTS[1]),
                    speed_max=5.0 if fast else 3.0,
                    acceleration_max=4.0 if fast else 2.0,
                    clearance=2.0,
                ),
            ),
        ),
        lidar=sim.LidarModel.preset("os0-128", ideal=True),
        sensor=loop if fast else sim.Hover(position=START),
        scans=scans,
    )


def _noise() -> PoseNoise:
    return PoseNoise(time_constant=1.0)


def _rows(parts: Parts) -> list[Row]:
    rows: list[Row] = []
    for kinds, what in ((FLIGHTS, "all flights"), *(((one,), one) for one in FLIGHTS)):
        for kind in KINDS:
            flights = {mode: [part for one in kinds for part in parts[one, mode]] for mode in MODES}
            columns = (
                _numbers(sightings(some, mode, kind, target=0, config=evaluation_config()))
                for mode, some in flights.items()
            )
            names = (f"{what}, {kind}: {name}" for name, _ in QUANTITIES)
            known = PAPER[kind] if kinds == FLIGHTS else (None, None)
            rows += map(Row, names, (unit for _, unit in QUANTITIES), (*known, None), *columns)
    paper, best = (_distance_error(parts["following", mode]) for mode in MODES)
    rows.append(Row("following: mean error of the distance kept", "m", None, paper, best))
    passes = (_passes(parts["interception", mode]) for mode in MODES)
    rows.append(Row(f"interception: passes nearer than {PASS:g} m", "count", None, *passes))
    return rows


QUANTITIES = (("mean error", "m"), ("std of the error", "m"), ("recall", "1"))


def _numbers(seen: Sightings) -> list[float | None]:
    """Values of `QUANTITIES`; None where nothing was seen or found."""
    error = seen.error[seen.is_found]
    recall = float(seen.is_found.mean()) if len(seen.error) else None
    return [float(error.mean()), float(error.std()), recall] if len(error) else [None, None, recall]


def _distances(part: Part) -> NDArray[np.float64]:
    return np.asarray(np.linalg.norm(part["position"][:, 0] - part["sensor"], axis=1), np.float64)


def _distance_error(parts: Sequence[Part]) -> float | None:
    """Mean deviation of the true distance from the set distance, once it was reached [m]."""
    errors: list[float] = []
    for part in parts:
        error = np.abs(_distances(part) - FOLLOW_DISTANCE)
        burn_in = max(int(part[key]) for key in part if key.endswith("_burn_in_scans"))
        reached = np.flatnonzero((error < 1) & (np.arange(len(error)) >= burn_in))
        errors += error[reached[0] :].tolist() if len(reached) else []
    return float(np.mean(errors)) if errors else None


def _passes(parts: Sequence[Part]) -> int:
    """Count the approaches of the observer to the target after it was far away."""
    near = [_distances(part) < PASS for part in parts]
    return sum(int(np.count_nonzero(np.diff(one.astype(int)) == 1)) for one in near)


def _draw(figure: Any, parts: Parts) -> None:
    """Draw track errors over time above, distances below; for the first flight of each kind."""
    panels = figure.subplots(2, len(FLIGHTS), sharey="row", sharex=True)
    for column, flight_kind in enumerate(FLIGHTS):
        for mode, colour in (("paper", "#be185d"), ("best", "#0369a1")):
            part = parts[flight_kind, mode][0]
            seconds = part["stamp_ns"] * 1e-9
            panels[1, column].plot(seconds, _distances(part), color=colour)
            for kind, style in zip(KINDS, (".", "-"), strict=True):
                error = _errors_over_time(part, mode, kind)
                panels[0, column].plot(
                    seconds, error, style, color=colour, ms=2, lw=1, label=f"{mode} mode, {kind}"
                )
        panels[0, column].set_title(flight_kind)
        panels[1, column].set_xlabel("time [s]")
    panels[0, 0].set(ylabel="position error [m]", ylim=(0, None))
    panels[1, 0].set(ylabel="distance of the drone [m]", ylim=(0, None))
    panels[0, 0].legend(fontsize=8)


def _errors_over_time(part: Part, mode: str, kind: Kind) -> NDArray[np.float64]:
    """Error of every scan [m]; NaN if the drone is not found or does not have to be found."""
    seen = sightings([part], mode, kind, target=0, config=evaluation_config())
    error = np.full(len(part["stamp_ns"]), np.nan)
    error[seen.scan.astype(int)] = seen.error
    return error


ITEM = Item(
    name="flying-fig8",
    title="the three real flights, simulated: manual, following, interception (Fig. 8)",
    scans=1200,
    minutes=3,
    measure=_measure,
    rows=_rows,
    draw=_draw,
    heading="The three flights, simulated with noise",
)
