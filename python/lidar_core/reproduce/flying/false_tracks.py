"""`flying-false-tracks`: tracks without a target, in ideal and noisy scans, in bad weather."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_core import sim
from lidar_core.flying import FlyingObjectDetector, Tracks
from lidar_core.reproduce.common import COLOURS, GATE, MODES, scene_rng, simulator_seed
from lidar_core.reproduce.flying.simulated.flights import both_modes, is_paper, processed
from lidar_core.reproduce.jobs import Job, Part, grouped, run
from lidar_core.reproduce.types import Item, Measured, Request, Row
from lidar_core.sim import Body, NoisyPoses, PoseNoise, Scene, Simulator, Target
from lidar_core.sim.air import Particles

SCANS_PER_FLIGHT = 100
SHARES = {"ideal": 1, "noisy": 10, "rain": 1, "dust": 1, "insects": 1, "foliage": 1}
"""Conditions, and how the scans are shared among them."""
WORSE = ("thick dust", "swarm", "sparse leaves")
"""Conditions that were added later, each with the scans of one share on top."""
CONDITIONS = (*SHARES, *WORSE)
NOISY_RANGE, IDEAL_RANGE = 0.05, 0.0
"""Standard deviation of the ranges [m]."""
POSITION_STD, ANGLE_STD_DEG = 0.1, 0.5
"""Noise of the poses, white, per scan and axis [m], [deg]."""
SWAY = 0.25
LEAVES, LEAF_RADIUS, WALK = 60, 0.06, 2.0
"""Of sparse trees [m], and the speed of the sensor among them [m/s]."""
INSECTS, SWARM = 20, 60
PUFFS, THICK_PUFFS = 6, 16


def _measure(request: Request) -> Measured:
    todo = jobs(request)
    of = grouped(todo, run(todo, request), "condition", CONDITIONS)
    return Measured(
        (of,),
        scans=sum(job.scans for job in todo),
        note=f"Tracks that were ever further than {GATE:g} m from every drone. Every second street"
        f" has two drones. noisy: ranges with {NOISY_RANGE} m, poses with {POSITION_STD} m and"
        f" {ANGLE_STD_DEG} deg, white per scan and axis; best mode knows how wrong the poses are.",
        config=both_modes(),
    )


def jobs(request: Request) -> list[Job]:
    """Jobs of flights through streets, at least one per condition."""
    each = min(SCANS_PER_FLIGHT, request.scans)
    found = []
    for condition in CONDITIONS:
        scans = request.scans * SHARES.get(condition, 1) / sum(SHARES.values())
        for number in range(max(1, round(scans / each))):
            arguments = {
                "seed": request.seed,
                "number": number,
                "scans": each,
                "condition": condition,
            }
            name = f"false-{condition}-{request.seed}-{number}-{each}"
            found.append(Job(name, street, arguments, each))
    return found


def street(*, seed: int, number: int, scans: int, condition: str) -> Part:
    """Fly through one street; return per mode NAME the false tracks as NAME_false.

    A row of it has scan, track ID and position.
    """
    name = simulator_seed(seed, number)
    simulator = Simulator(_scene(seed, number, scans, condition), seed=name)
    noise = None
    if condition == "noisy":
        noise = NoisyPoses(
            PoseNoise(position_std=POSITION_STD, angle_std_deg=ANGLE_STD_DEG), seed=name
        )
    return _flown(simulator, scans, noise)


def _flown(simulator: Any, scans: int, noise: NoisyPoses | None) -> Part:
    detectors = {name: FlyingObjectDetector(config) for name, config in both_modes().items()}
    false: dict[str, list[NDArray[np.float64]]] = {name: [] for name in detectors}
    for number in range(scans):
        made = simulator.scan(number)
        given = made if noise is None else noise.observed(made)
        for name, detector in detectors.items():
            covariance = None if noise is None or is_paper(name) else noise.covariance
            tracks = processed(detector, given, pose_covariance=covariance).tracks.flying
            false[name].append(_false(number, tracks, made.truth.position))
    part: Part = {"scans": np.array(scans)}
    return part | {f"{name}_false": np.concatenate(rows) for name, rows in false.items()}


def _false(number: int, tracks: Tracks, targets: NDArray[np.float64]) -> NDArray[np.float64]:
    """Tracks that are far from every target: rows of scan, track ID and position."""
    away = np.linalg.norm(tracks.position[:, None] - targets, axis=2)
    is_false = np.min(away, axis=1, initial=np.inf) > GATE
    found = np.column_stack([tracks.id, tracks.position])[is_false]
    return np.insert(found.astype(np.float64), 0, number, axis=1)


def _scene(seed: int, number: int, scans: int, condition: str) -> Scene:
    """Make a street of the demo, every second one without drones, in the given condition."""
    rng = scene_rng(seed, number)
    base = sim.scenes.demo(int(rng.integers(2**31)), scans=scans)
    drones = base.targets if number % 2 else ()
    noise = NOISY_RANGE if condition == "noisy" else IDEAL_RANGE
    insects = {"insects": INSECTS, "swarm": SWARM}.get(condition, 0)
    changes = {
        "targets": (*drones, *_insects(rng, insects)),
        "air": _air(rng, condition, scans * 0.1),
        "lidar": sim.LidarModel.preset("os1-128", ideal=True, range_std=noise),
    }
    if condition == "foliage":
        changes["bodies"] = _trees_with(base.bodies, sway=SWAY)
    if condition == "sparse leaves":
        changes["bodies"] = _trees_with(
            (*base.bodies, *_grove(rng)), sway=SWAY, leaves=LEAVES, leaf_radius=LEAF_RADIUS
        )
        changes["sensor"] = sim.Shuttle(
            start=(-10.0, 0.0, 3.0), end=(10.0, 0.0, 3.0), speed=WALK, acceleration=WALK
        )
    return base.model_copy(update=changes)


def _grove(rng: np.random.Generator) -> list[Body]:
    """Make trees on both sides of the x axis, about 5 m apart."""
    return [
        sim.Body(
            shape=sim.Tree(
                crown_radius=rng.uniform(1.2, 2.2),
                trunk_height=rng.uniform(3.0, 5.0),
                seed=int(rng.integers(2**31)),
            ),
            position=(x + rng.uniform(-1, 1), y + rng.uniform(-1, 1), 0.0),
        )
        for x in range(-15, 16, 5)
        for y in (-10, -5, 5, 10)
    ]


def _trees_with(bodies: Sequence[Body], **values: float) -> tuple[Body, ...]:
    """Return the bodies with these `values` for the leaves of all trees.

    With `sway` [m] the outermost leaves swing this far to either side.
    """
    return tuple(
        body.model_copy(update={"shape": body.shape.model_copy(update=values)})
        if body.shape.kind == "tree"
        else body
        for body in bodies
    )


def _insects(rng: np.random.Generator, count: int) -> list[Target]:
    """Make specks of 1 to 3 cm that circle within a few metres of the sensor's path."""
    return [
        sim.Target(
            shape=sim.Sphere(radius=rng.uniform(0.01, 0.03)),
            motion=sim.Circle(
                center=(rng.uniform(-8, 8), rng.uniform(-5, 5), rng.uniform(2, 5)),
                radius=rng.uniform(0.2, 1.0),
                speed=rng.uniform(0.5, 3.0),
                phase=rng.uniform(0, 2 * np.pi),
            ),
            clutter=True,
        )
        for _ in range(count)
    ]


def _air(rng: np.random.Generator, condition: str, seconds: float) -> tuple[Particles, ...]:
    """Make rain, or clouds of dust of 0.3 to 1.5 m that drift over the street and grow."""
    if condition == "rain":
        return (sim.Rain(),)
    count = {"dust": PUFFS, "thick dust": THICK_PUFFS}.get(condition, 0)
    puffs = []
    for _ in range(count):
        velocity = np.array([rng.uniform(-2, 2), rng.uniform(-2, 2), rng.uniform(0, 0.3)])
        middle = np.array([rng.uniform(-12, 12), rng.uniform(-8, 8), rng.uniform(1, 5)])
        x, y, z = (middle - seconds / 2 * velocity).tolist()
        vx, vy, vz = velocity.tolist()
        puffs.append(
            sim.Dust(
                center=(x, y, z),
                velocity=(vx, vy, vz),
                radius=rng.uniform(0.3, 1.5),
                growth=rng.uniform(0, 0.1),
                free_path=rng.uniform(2, 10),
            )
        )
    return tuple(puffs)


def _rows(of: dict[str, list[Part]]) -> list[Row]:
    rows = []
    for condition, parts in of.items():
        scans = float(sum(int(part["scans"]) for part in parts))
        counts = [
            float(sum(len(np.unique(part[f"{mode}_false"][:, 1])) for part in parts))
            for mode in MODES
        ]
        rows.append(Row(f"scans, {condition}", "1", None, scans, scans))
        rows.append(Row(f"false tracks, {condition}", "1", None, *counts))
        rates = (count / scans * 1000 for count in counts)
        rows.append(Row(f"false tracks per 1000 scans, {condition}", "1", None, *rates))
    return rows


def _draw(figure: Any, of: dict[str, list[Part]]) -> None:
    """Draw false tracks per 1000 scans, one group of bars per condition."""
    axes = figure.subplots()
    axes.set_title("Tracks of nothing", loc="left", fontweight="bold")
    rows = {row.name: row for row in _rows(of)}
    for offset, mode in zip((-0.2, 0.2), MODES, strict=True):
        colour = COLOURS[mode]
        rates = [
            rows[f"false tracks per 1000 scans, {condition}"]._asdict()[f"{mode}_mode"]
            for condition in of
        ]
        bars = axes.bar(
            np.arange(len(of)) + offset, rates, 0.38, color=colour, label=f"{mode} mode"
        )
        axes.bar_label(bars, fmt="%.2g", fontsize=8)
    axes.set_xticks(range(len(of)), list(of))
    axes.set_yscale("symlog", linthresh=1.0)
    axes.set(ylabel="false tracks per 1000 scans", ylim=(0, None))
    axes.legend()


ITEM = Item(
    name="flying-false-tracks",
    title="false tracks: ideal, with noise, in rain, dust, insects and swaying trees",
    scans=4500,
    minutes=30,
    measure=_measure,
    rows=_rows,
    draw=_draw,
    grid="",
)
