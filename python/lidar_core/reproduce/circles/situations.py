"""`circles-situations`: difficulties of real rooms, each simulated alone: noise, poses, people."""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_core.circles import CircleElements, CirclePipeline, CirclesConfig
from lidar_core.objects import ObjectTruth
from lidar_core.reproduce.circles.runs import config_of
from lidar_core.reproduce.common import BLUE, simulator_seed
from lidar_core.reproduce.jobs import Job, Part, run
from lidar_core.reproduce.tracking.existence import Hypotheses
from lidar_core.reproduce.types import Item, Measured, Request, Row
from lidar_core.sim import Scene, SimulatedSweep, Simulator, circle_scenes
from lidar_core.sim.config import Target
from lidar_core.sim.motion.motions import Hover
from lidar_core.sim.motion.paths import Swinging
from lidar_core.sim.solids.shapes import Box, Cylinder, EllipticCylinder

Poses = Callable[[SimulatedSweep, SimulatedSweep], NDArray[np.float64]]
"""Poses (K, 4, 4) that a scan is given, from it and the one before."""

GATE = 0.5
"""Elements within this distance of an object are its own [m]."""
SHARE = 0.5
"""Measures begin after this share of a run."""
START = 1.1
"""Those of people begin after this time: before, no earlier scan tells what moves [s]."""
TOUCH = 0.15
"""An element is of an object if its circle is as near to it [m]; else it is a piece of a wall."""
PLACES = ((2.5, 1.5), (2.0, -2.0), (4.5, 3.0), (5.0, -1.0), (-1.5, 3.5), (7.0, 1.0))
RADII = (0.1, 0.2, 0.3, 0.15, 0.25, 0.35)
LARGE = (1.0, 1.5, 2.0, 2.5)
DRIFT = 0.01
"""Turn of the odometry that nothing makes [rad/s]."""


def as_they_are(made: SimulatedSweep, _: SimulatedSweep) -> NDArray[np.float64]:
    """Return poses without an error."""
    return made.poses


def late(_: SimulatedSweep, before: SimulatedSweep) -> NDArray[np.float64]:
    """Return poses that are 50 ms late: those of the scan before."""
    return before.poses


def stretched(made: SimulatedSweep, _: SimulatedSweep) -> NDArray[np.float64]:
    """Return poses of an odometry whose scale is wrong: 1.00 m for every 1.02 m."""
    poses = made.poses.copy()
    poses[:, :2, 3] *= 1.02
    return poses


def turned(made: SimulatedSweep, _: SimulatedSweep) -> NDArray[np.float64]:
    """Return poses of an odometry whose heading drifts."""
    angle = DRIFT * made.pose_stamps_ns * 1e-9
    turn = np.tile(np.eye(4), (len(angle), 1, 1))
    turn[:, 0, 0] = turn[:, 1, 1] = np.cos(angle)
    turn[:, 1, 0], turn[:, 0, 1] = np.sin(angle), -np.sin(angle)
    return turn @ made.poses


def _posts(seed: int, *, std: float = 0.01, moves: bool = False) -> Scene:
    rng = np.random.default_rng([20240615, seed])
    places = np.array(PLACES) + rng.uniform(-0.3, 0.3, (len(PLACES), 2))
    targets = tuple(
        Target(shape=Cylinder(radius=radius), motion=Hover(position=(x, y, circle_scenes.HEIGHT)))
        for (x, y), radius in zip(places.tolist(), RADII, strict=True)
    )
    return _scene(targets, std=std, moves=moves)


def _shapes(seed: int, *, moves: bool = True) -> Scene:
    rng = np.random.default_rng([20240616, seed])
    places = np.array(PLACES[:4]) + rng.uniform(-0.3, 0.3, (4, 2))
    turns = rng.uniform(0, np.pi, 4)
    shapes = (
        Box(size=(0.3, 0.3, circle_scenes.ENDLESS)),
        Box(size=(0.4, 0.2, circle_scenes.ENDLESS)),
        EllipticCylinder(half_axes=(0.2, 0.12)),
        EllipticCylinder(half_axes=(0.3, 0.2)),
    )
    targets = tuple(
        Target(
            shape=shape,
            motion=Hover(
                position=(x, y, circle_scenes.HEIGHT),
                rotation=(0.0, 0.0, float(np.sin(turn / 2)), float(np.cos(turn / 2))),
            ),
        )
        for shape, (x, y), turn in zip(shapes, places.tolist(), turns.tolist(), strict=True)
    )
    return _scene(targets, moves=moves)


def _large(seed: int) -> Scene:
    rng = np.random.default_rng([20240617, seed])
    bearings = np.array([-1.8, -0.6, 0.6, 1.8]) + rng.uniform(-0.1, 0.1, 4)
    targets = tuple(
        Target(
            shape=Cylinder(radius=radius),
            motion=Hover(
                position=(
                    float((radius + 3.0) * np.cos(bearing)),
                    float((radius + 3.0) * np.sin(bearing)),
                    circle_scenes.HEIGHT,
                )
            ),
        )
        for radius, bearing in zip(LARGE, bearings.tolist(), strict=True)
    )
    return _scene(targets, moves=True)


def _scene(targets: tuple[Target, ...], *, std: float = 0.01, moves: bool = False) -> Scene:
    place = (0.0, 0.0, circle_scenes.HEIGHT)
    drives = Swinging(position=place, reach=(0.8, 0.0, 0.0), yaw=1.2, pitch_deg=0, roll_deg=0)
    return Scene(
        targets=targets,
        lidar=circle_scenes.scanner().model_copy(update={"range_std": std}),
        sensor=drives if moves else Hover(position=place),
        scans=600,
    )


SITUATIONS: dict[str, tuple[Callable[[int], Scene], Poses]] = {
    "noise of 3 cm, told 1 cm": (lambda seed: _posts(seed, std=0.03, moves=True), as_they_are),
    "noise as told": (lambda seed: _posts(seed, moves=True), as_they_are),
    "poses 50 ms late": (lambda seed: _posts(seed, moves=True), late),
    "odometry 2 % too long": (lambda seed: _posts(seed, moves=True), stretched),
    "odometry turns by 0.01 rad/s": (lambda seed: _posts(seed, moves=True), turned),
    "square and elliptic posts": (_shapes, as_they_are),
    "circles of 1 to 2.5 m": (_large, as_they_are),
    "cluttered room": (circle_scenes.cluttered, as_they_are),
    "people on two legs": (circle_scenes.walkers, as_they_are),
    "people at 1.2 m": (lambda seed: circle_scenes.walkers(seed, height=1.2), as_they_are),
}
RUNS = 3


def situation(*, name: str, seed: int, scans: int) -> Part:
    """Run a pipeline on a simulated scene; return one row per object and scan."""
    make, poses_of = SITUATIONS[name]
    scene = make(seed)
    simulator = Simulator(scene, seed=seed, scans=scans)
    pipeline = CirclePipeline(config_of(scene, ""))
    rows: list[tuple[float, ...]] = []
    believed: list[tuple[float, bool]] = []
    before: SimulatedSweep | None = None
    for number in range(scans):
        made = simulator.sweep(number)
        poses = poses_of(made, before or made)
        before = made
        scan = made.scan
        found = pipeline.process(
            scan.ranges,
            poses,
            scan.stamp_ns,
            ray_time_ns=scan.stamp_ns + scan.time_increment_ns * np.arange(len(scan.ranges)),
            pose_stamps_ns=made.pose_stamps_ns,
        ).map
        # What is measured is where objects are for the scanner, whatever its pose is. Late poses
        # are moved on by the map, which is in the world then.
        wrong = np.eye(4) if poses_of is late else poses[0] @ np.linalg.inv(made.poses[0])
        rows += ((number, *row) for row in _object_rows(made.truth, found, wrong))
        if number * scene.lidar.period_ns >= START * 1e9:
            believed += _believed(scene, made.truth, found)
    columns = np.array(rows, np.float64).reshape(-1, 9).T
    names = ("scan", "object", "person", "near", "id", "square", "nees", "slip", "likely")
    offset = pipeline.health().pose_offset_s
    return dict(zip(names, columns, strict=True)) | {
        "scans": np.array(scans),
        "minutes": np.array(scans * scene.lidar.period_ns * 1e-9 / 60),
        "offset": np.array(np.nan if offset is None else offset),
        "believed": np.array(believed, np.float64).reshape(-1, 2),
    }


def _believed(
    scene: Scene, truth: ObjectTruth, found: CircleElements
) -> Iterator[tuple[float, bool]]:
    """Yield the existence of every element, and whether its circle is near a true object.

    Near means: the gap between them is less than `TOUCH`.
    """
    reach = [
        float(np.hypot(*target.shape.size[:2])) / 2
        if isinstance(target.shape, Box)
        else float(radius)
        for target, radius in zip(scene.targets, truth.radius, strict=True)
    ]
    for row, existence in enumerate(found.existence.tolist()):
        off = np.linalg.norm(truth.center[:, :2] - found.center[row], axis=1)
        yield existence, bool((off - reach < found.radius[row] + TOUCH).any())


def _object_rows(
    truth: ObjectTruth, found: CircleElements, wrong: NDArray[np.float64]
) -> Iterator[tuple[float, ...]]:
    """Yield a row per object with at least 5 hits that compares it with the map `found`.

    `wrong` transforms the truth into the frame of the map, which has errors of the poses.
    """
    # Where two people pass, each has elements of its own.
    middles = truth.center @ wrong[:2, :2].T + wrong[:2, 3]
    apart = np.linalg.norm(found.center[:, None] - middles, axis=2)
    nearest = apart.argmin(axis=1) if len(middles) else np.zeros(len(found), np.int64)
    for row in range(len(truth.hits)):
        if truth.hits[row] < 5:
            continue
        place = wrong[:2, :2] @ truth.center[row] + wrong[:2, 3]
        velocity = wrong[:2, :2] @ truth.velocity[row]
        off = np.linalg.norm(found.center - place, axis=1)
        # The radius of a large circle reaches further than the gate.
        near = np.flatnonzero(off < GATE)
        values = [np.nan] * 5
        if len(near):
            best = int(near[off[near].argmin()])
            error = found.center[best] - place
            with_radius = np.r_[error, found.radius[best] - truth.radius[row]]
            covariance = found.covariance[best][np.ix_([0, 1, 4], [0, 1, 4])]
            values = [
                float(found.id[best]),
                float(error @ error),
                float(with_radius @ np.linalg.solve(covariance, with_radius)),
                float(((found.velocity[best] - velocity) ** 2).sum()),
                float(found.person_probability[best]),
            ]
        person = float(truth.kind[row] == "person")
        own = float(np.count_nonzero(nearest[near] == row))
        yield row, person, own, *values


def _measure(request: Request) -> Measured:
    share = min(1.0, request.scans / ITEM.scans)
    scans, runs = max(40, round(600 * share)), max(1, round(RUNS * share))
    jobs = [
        Job(
            name=f"circles-situations-{request.seed}-{place}-{number}-{scans}",
            function=situation,
            arguments={
                "name": name,
                "seed": simulator_seed(request.seed, number),
                "scans": scans,
            },
            scans=scans,
        )
        for place, name in enumerate(SITUATIONS)
        for number in range(runs)
    ]
    parts = list(run(jobs, request))
    made = {name: parts[runs * place : runs * (place + 1)] for place, name in enumerate(SITUATIONS)}
    return Measured(
        (made,),
        scans=sum(job.scans for job in jobs),
        note="Default configuration in every situation. NEES: of x, y and radius in the frame of"
        " the scanner, 3 is right. An element is of an object within 0.5 m. Second half of every"
        " run; people: from 1.1 s on.",
        config={"best": CirclesConfig()},
    )


def _rows(made: dict[str, list[Part]]) -> list[Row]:
    return [
        Row(f"{name}/{what}", unit, None, None, value)
        for name, parts in made.items()
        for what, unit, value in _measures(name, parts)
    ]


def _measures(name: str, parts: list[Part]) -> list[tuple[str, str, float | None]]:
    if name.startswith("people"):
        return _people(parts)
    if name.startswith("cluttered"):
        return _existence(np.concatenate([one["believed"] for one in parts]))
    late_rows = [one["scan"] >= SHARE * one["scans"] for one in parts]

    def mean(column: str) -> float | None:
        values = np.concatenate(
            [one[column][rows] for one, rows in zip(parts, late_rows, strict=True)]
        )
        values = values[np.isfinite(values)]
        return float(values.mean()) if len(values) else None

    square = mean("square")
    found = np.concatenate([one["id"][rows] for one, rows in zip(parts, late_rows, strict=True)])
    measures: list[tuple[str, str, float | None]] = [
        ("share found", "1", float(np.isfinite(found).mean()) if len(found) else None),
        ("centre, rms", "m", None if square is None else float(np.sqrt(square))),
        ("changes of number", "1", float(sum(_changes(one) for one in parts))),
    ]
    if "square" not in name and "1 to 2.5" not in name:
        measures.append(("NEES (3)", "1", mean("nees")))
    if "late" in name:
        known = [float(one["offset"]) for one in parts if np.isfinite(one["offset"])]
        measures.append(("offset found", "s", float(np.mean(known)) if known else None))
    return measures


def _people(parts: list[Part]) -> list[tuple[str, str, float | None]]:
    numbers = minutes = 0.0
    near, slips, likely = [], [], []
    for one in parts:
        seconds = 60 * float(one["minutes"])
        rows = (one["person"] > 0) & (one["scan"] * seconds / one["scans"] >= START)
        for target in np.unique(one["object"][rows]):
            own = rows & (one["object"] == target)
            ids = one["id"][own]
            numbers += len(np.unique(ids[np.isfinite(ids)]))
            minutes += (seconds - START) / 60
        near.append(one["near"][rows])
        slips.append(one["slip"][rows])
        likely.append(one["likely"][rows])
    count, slip, person = (np.concatenate(some) for some in (near, slips, likely))
    known = np.isfinite(slip)
    return [
        ("numbers per person and minute", "1/min", numbers / minutes if minutes else None),
        ("elements per person", "1", float(count[count > 0].mean()) if (count > 0).any() else None),
        ("share found", "1", float(known.mean()) if len(known) else None),
        ("velocity, rms", "m/s", float(np.sqrt(slip[known].mean())) if known.any() else None),
        ("reported as persons", "1", float((person[known] > 0.5).mean()) if known.any() else None),
    ]


def _existence(believed: NDArray[np.float64]) -> list[tuple[str, str, float | None]]:
    """Measures that compare the existence of reported elements with the share of true objects."""
    if not len(believed):
        return []
    existence, is_object = believed[:, 0], believed[:, 1] > 0
    everything = Hypotheses(existence, is_object, 0)
    middle = everything.middle
    some = len(middle.existence) > 0
    return [
        ("share of objects", "1", float(is_object.mean())),
        ("existence, calibration error", "1", everything.calibration_error()),
        ("existence up to 0.9, rows", "1", float(len(middle.existence))),
        (
            "existence up to 0.9, calibration error",
            "1",
            middle.calibration_error() if some else None,
        ),
        ("existence up to 0.9, mean", "1", float(middle.existence.mean()) if some else None),
        (
            "existence up to 0.9, share of objects",
            "1",
            float(middle.is_true.mean()) if some else None,
        ),
    ]


def _changes(one: Part) -> int:
    changes = 0
    for target in np.unique(one["object"]):
        ids = one["id"][one["object"] == target]
        changes += int(np.count_nonzero(np.diff(ids[np.isfinite(ids)])))
    return changes


def _draw(figure: Any, made: dict[str, list[Part]]) -> None:
    """Draw the errors of centres per situation."""
    rows = {row.name: row.best_mode for row in _rows(made)}
    names = [name for name in made if rows.get(f"{name}/centre, rms") is not None]
    axes = figure.subplots()
    axes.barh(names, [1e3 * (rows[f"{name}/centre, rms"] or 0.0) for name in names], color=BLUE)
    axes.set(xlabel="centre, rms [mm]")


ITEM = Item(
    name="circles-situations",
    title="what rooms do to a map, each alone: noise, late poses, odometry, shapes, people",
    scans=600 * RUNS * len(SITUATIONS),
    minutes=4,
    measure=_measure,
    rows=_rows,
    draw=_draw,
)
