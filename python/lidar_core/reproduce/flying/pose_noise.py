"""`flying-pose-noise`: poses with jitter and drift, with and without a model of them in the map."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_core import sim
from lidar_core.evaluation import EvaluationConfig, score_detections, score_tracks
from lidar_core.flying import FlyingConfig, PoseConfig
from lidar_core.reproduce.common import BLUE, RED, evaluation_config, scene_rng, simulator_seed
from lidar_core.reproduce.flying.simulated.flights import both_modes, fly, tables
from lidar_core.reproduce.jobs import Part, flights, run
from lidar_core.reproduce.types import Item, Measured, Request, Row
from lidar_core.sim import NoisyPoses, PoseNoise, Scene, SimulatedScan, Simulator

SCANS_PER_FLIGHT = 150
JITTER = (0.1, 0.5)
DRIFT = (0.15, 0.3)
"""Standard deviations per axis: position [m], angles [deg]."""
DRIFT_SECONDS = 10.0
RADII = (0.2, 0.35)
"""Of the targets [m]."""
GATE = 1.5
"""Estimates further from every target are false [m]."""
SEEN_HITS, SEEN_RANGE = 3, 19.0
"""Targets with so many hits within this range count for the recall [m]."""


class JitterAndDrift:
    """Source of poses with two errors: independent jitter per scan, and slow drift."""

    def __init__(self, *, seed: int) -> None:
        jitter = PoseNoise(position_std=JITTER[0], angle_std_deg=JITTER[1])
        drift = PoseNoise(
            position_std=DRIFT[0], angle_std_deg=DRIFT[1], time_constant=DRIFT_SECONDS
        )
        self.covariance: NDArray[np.float64] = jitter.covariance + drift.covariance
        self._errors = [NoisyPoses(drift, seed=seed), NoisyPoses(jitter, seed=seed + 2**32)]

    def observed(self, made: SimulatedScan) -> SimulatedScan:
        """Return the scan as the detector gets it."""
        for error in self._errors:
            made = error.observed(made)
        return made


def _measure(request: Request) -> Measured:
    jobs = flights("pose-noise", flight, request, longest=SCANS_PER_FLIGHT)
    parts = run(jobs, request)
    scans = sum(job.scans for job in jobs)
    return Measured(
        (parts, scans),
        scans=scans,
        note=f"Errors of the pose per axis: {JITTER[0]} m and {JITTER[1]} deg, white per scan, and"
        f" {DRIFT[0]} m and {DRIFT[1]} deg with a time constant of {DRIFT_SECONDS:g} s. Every"
        " configuration but the paper's is told their covariance; 'off' has no use for it in the"
        " map.",
        config={**_configs(), "evaluation": _evaluation()},
    )


def _configs() -> dict[str, FlyingConfig]:
    """Configurations of both modes, and of best mode with the other ways to update the map."""
    configs = both_modes()
    for weighting in ("off", "ends", "spread"):
        pose = PoseConfig.load({"weighting": weighting})
        configs[weighting] = FlyingConfig().model_copy(update={"pose": pose})
    return configs


def flight(*, seed: int, number: int, scans: int) -> Part:
    """Simulate one flight and detect in it with every configuration."""
    name = simulator_seed(seed, number)
    simulator = Simulator(_scene(seed, number, scans), seed=name)
    return fly(simulator, _configs(), scans=scans, noise=JitterAndDrift(seed=name))


def _scene(seed: int, number: int, scans: int) -> Scene:
    """Make a street with a moving LiDAR of 64 rows and two moving drones."""
    rng = scene_rng(seed, number)
    seconds = scans * 0.1
    pattern = sim.Spinning(elevations_deg=tuple(np.linspace(22.5, -22.5, 64).tolist()), columns=512)

    def way(low: Sequence[float], high: Sequence[float], places: int) -> sim.Waypoints:
        positions = rng.uniform(low, high, (places, 3)).tolist()
        return sim.Waypoints(
            times=tuple(np.linspace(0, seconds, places).tolist()), positions=tuple(positions)
        )

    targets = tuple(
        sim.Target(shape=sim.Sphere(radius=radius), motion=way((-14, -14, 2), (14, 14, 7), 12))
        for radius in RADII
    )
    return sim.Scene(
        bodies=sim.scenes.street(
            int(rng.integers(2**31)), keep_clear=np.zeros((1, 2)), clearance=5.0
        ),
        targets=targets,
        lidar=sim.LidarModel(pattern=pattern, snapshot=True, range_std=0.03),
        sensor=way((-4, -4, 2.5), (4, 4, 5), 6),
        scans=scans,
    )


def _rows(parts: Sequence[Part], scans: int) -> list[Row]:
    """Rows of false detections, false tracks and recall, for every configuration."""
    names = ("paper", "best", "off", "ends", "spread")
    counts = {name: _counts(parts, name) for name in names}
    kinds = (
        ("false detections per 1000 scans", "1"),
        ("false tracks per 1000 scans", "1"),
        ("recall of detections", "1"),
        ("share of sightings with a track", "1"),
    )
    rows = []
    for number, (what, unit) in enumerate(kinds):
        scale = 1000 / scans if number < 2 else 1.0
        values = {name: scale * counts[name][number] for name in names}
        rows.append(Row(what, unit, None, values["paper"], values["best"]))
        rows += [Row(f"{what}, {name}", unit, None, None, values[name]) for name in names[2:]]
    return rows


def _counts(parts: Sequence[Part], name: str) -> tuple[int, int, float, float]:
    """Counts of false detections and tracks; shares of sightings with a detection, with a track."""
    config = _evaluation()
    found = [
        score_detections(*tables(part, name, "detections", config=config), config=config)
        for part in parts
    ]
    followed = [
        score_tracks(*tables(part, name, "tracks", config=config), config=config) for part in parts
    ]
    seen = max(1, sum(one.n_eligible for one in found))
    return (
        sum(one.n_false for one in found),
        sum(len(one.false_ids) for one in followed),
        sum(one.n_found for one in found) / seen,
        sum(one.n_found for one in followed) / seen,
    )


def _evaluation() -> EvaluationConfig:
    """Scoring in which only sightings count that are near enough and have enough rays."""
    return evaluation_config(gate=GATE, max_distance=SEEN_RANGE, min_hits=SEEN_HITS)


def _draw(figure: Any, parts: Sequence[Part], scans: int) -> None:
    """Draw false detections and recall, one bar per configuration."""
    names = ("off", "ends", "spread")
    panels = figure.subplots(1, 2)
    counts = [_counts(parts, name) for name in names]
    false = [1000 * one[0] / scans for one in counts]
    panels[0].bar(names, false, color=RED)
    panels[0].set_ylabel("false detections per 1000 scans")
    panels[1].bar(names, [one[2] for one in counts], color=BLUE)
    panels[1].set(ylabel="recall of detections", ylim=(0, 1.05))
    for panel in panels:
        panel.set_xlabel("weighting of the map")


ITEM = Item(
    name="flying-pose-noise",
    title="false detections with jittering and drifting poses, by what the map knows of them",
    scans=1500,
    minutes=30,
    measure=_measure,
    rows=_rows,
    draw=_draw,
    grid="y",
    heading="Poses that jitter and drift",
)
