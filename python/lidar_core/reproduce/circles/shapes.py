"""`circles-shapes`: classification of single circles, ellipses, rectangles and lines.

The paper lists shapes other than circles as future work: there is no number of its own.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_core import circles
from lidar_core.reproduce.common import BLUE, scene_rng, simulator_seed
from lidar_core.reproduce.jobs import Job, Part, run
from lidar_core.reproduce.types import Item, Measured, Request, Row
from lidar_core.sim import (
    Body,
    Box,
    Cylinder,
    EllipticCylinder,
    Hover,
    Scene,
    circle_scenes,
    sweeps,
)
from lidar_core.sim.solids.shapes import Shape

NAMES = ("circle", "ellipse", "rectangle", "line")
"""In the order of `lidar_core.circles.ShapeKind`."""
LEAST_HITS = 10
FACE_HITS = 3
"""On each of two faces of a rectangle: of one face alone nothing tells that it belongs to a box."""
WALL = 0.002
"""Thickness of what counts as a line [m]."""
GOAL = 0.95
PER_JOB = 250


def shapes(*, seed: int, number: int, count: int) -> Part:
    """Simulate `count` shapes, one per scan, and estimate the kind of each.

    Returns
    -------
    part : dict
        `true` and `taken`, shape (K,): true and estimated shape, -1 unless there is exactly one
        segment.
    """
    rng = scene_rng(seed, number)
    true: list[int] = []
    taken: list[int] = []
    while len(true) < count:
        kind = len(true) % len(NAMES)
        shown = _taken_for(kind, rng, simulator_seed(seed, int(rng.integers(2**31))))
        if shown is not None:
            true.append(kind)
            taken.append(shown)
    return {"true": np.array(true), "taken": np.array(taken)}


def _taken_for(kind: int, rng: np.random.Generator, seed: int) -> int | None:
    """Scan a random shape; return the estimated kind.

    It is -1 unless there is exactly one segment, and None if the scan shows too little.
    """
    body = _draw_shape(kind, rng)
    heading = rng.uniform(0, np.pi)
    distance, bearing = rng.uniform(1, 8), rng.uniform(-2.2, 2.2)
    place = (distance * np.cos(bearing), distance * np.sin(bearing), 0.0)
    turn = (0.0, 0.0, float(np.sin(heading / 2)), float(np.cos(heading / 2)))
    scene = Scene(
        bodies=(Body(shape=body, position=place, rotation=turn),),
        lidar=circle_scenes.scanner(),
        sensor=Hover(position=(0, 0, 0)),
        scans=1,
    )
    (sweep,) = sweeps(scene, seed=seed)
    scan = sweep.scan
    bearings = scan.angle_min + scan.angle_increment * np.arange(len(scan.ranges))
    hits = np.flatnonzero(np.isfinite(scan.ranges))
    if len(hits) < LEAST_HITS or (np.diff(hits) > 1).any() or scan.ranges[hits].min() < 0.3:
        return None
    ends = scan.ranges[hits] * np.array([np.cos(bearings[hits]), np.sin(bearings[hits])])
    if kind == NAMES.index("rectangle") and not _shows_two_faces(ends.T, body, place, heading):
        return None
    segments = circles.segment(scan.ranges, bearings, config=circles.SegmentConfig())
    found = circles.fit_shapes(scan.ranges, bearings, segments)
    return int(found.kind[0]) if len(found) == 1 else -1


def _draw_shape(kind: int, rng: np.random.Generator) -> Shape:
    if NAMES[kind] == "circle":
        return Cylinder(radius=rng.uniform(0.05, 0.6))
    if NAMES[kind] == "ellipse":
        longer = rng.uniform(0.15, 0.6)
        return EllipticCylinder(half_axes=(longer, longer / rng.uniform(1.5, 3)))
    if NAMES[kind] == "rectangle":
        width, length = np.sort(rng.uniform(0.2, 1.5, 2)).tolist()
        return Box(size=(length, width, 10))
    return Box(size=(rng.uniform(0.5, 5), WALL, 10))


def _shows_two_faces(
    ends: NDArray[np.float64], body: Any, place: tuple[float, float, float], heading: float
) -> bool:
    """Return whether enough rays ended on each of two faces of a box."""
    along = np.array([np.cos(heading), np.sin(heading)])
    away = ends - np.array(place[:2])
    inside = (
        np.array([away @ along, away @ (-along[1], along[0])]) / np.array(body.size[:2])[:, None]
    )
    on_long = np.abs(inside[1]) > np.abs(inside[0])
    return bool(min(np.sum(on_long), np.sum(~on_long)) >= FACE_HITS)


def _measure(request: Request) -> Measured:
    count = min(PER_JOB, request.scans)
    jobs = [
        Job(
            name=f"circles-shapes-{request.seed}-{number}-{count}",
            function=shapes,
            arguments={"seed": request.seed, "number": number, "count": count},
            scans=count,
        )
        for number in range(max(1, request.scans // count))
    ]
    parts = run(jobs, request)
    true = np.concatenate([part["true"] for part in parts])
    taken = np.concatenate([part["taken"] for part in parts])
    table = np.array([[np.sum((true == a) & (taken == b)) for b in (0, 1, 2, 3)] for a in range(4)])
    return Measured(
        (table, true, taken),
        drawn=(table,),
        scans=len(true),
        note=f"Goal: {GOAL:.0%} right. 1 to 8 m away, at least {LEAST_HITS} hits side by side;"
        " circles of 0.05-0.6 m, semi-axes of 0.15-0.6 m with ratios of 1.5-3, sides of 0.2-1.5 m"
        f" with {FACE_HITS} hits on each of two faces, lines of 0.5-5 m; noise of 0.01 m.",
    )


def _rows(table: NDArray[np.int64], true: NDArray[np.int64], taken: NDArray[np.int64]) -> list[Row]:
    rows = [Row("right", "1", None, None, float(np.mean(true == taken)))]
    for kind, name in enumerate(NAMES):
        of_kind = max(1, int(np.sum(true == kind)))
        rows.append(Row(f"{name}: right", "1", None, None, float(table[kind, kind] / of_kind)))
        for other, wrong in enumerate(NAMES):
            if other != kind:
                share = float(table[kind, other] / of_kind)
                rows.append(Row(f"{name} taken for {wrong}", "1", None, None, share))
    rows.append(Row("not one segment", "count", None, None, int(np.sum(taken < 0))))
    return rows


def _draw(figure: Any, table: NDArray[np.int64]) -> None:
    """Draw the confusion matrix of true and estimated shapes."""
    axes = figure.subplots()
    axes.set_title("What single shapes are taken for", loc="left", fontweight="bold")
    axes.imshow(table / np.maximum(1, table.sum(axis=1, keepdims=True)), cmap="Blues", vmin=0)
    half = table.max() / 2
    for row, column in np.ndindex(table.shape):
        colour = "white" if table[row, column] > half else BLUE
        axes.text(column, row, str(table[row, column]), ha="center", va="center", color=colour)
    axes.set(xlabel="taken for", ylabel="true")
    axes.set_xticks(range(4), NAMES)
    axes.set_yticks(range(4), NAMES)


ITEM = Item(
    name="circles-shapes",
    title="circle, ellipse, rectangle or line: which shape a single object is taken for",
    scans=4000,
    minutes=1,
    measure=_measure,
    rows=_rows,
    draw=_draw,
    grid="",
    counts="shapes",
)
