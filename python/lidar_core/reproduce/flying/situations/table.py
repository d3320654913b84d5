"""`flying-situations`: sizes, speeds, walls, edges, swarms, and moving things that do not fly."""

from collections.abc import Callable, Sequence
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from lidar_core.flying import FlyingConfig
from lidar_core.reproduce.common import BLUE, RED
from lidar_core.reproduce.flying.real_data.scores import FEWEST, START_S
from lidar_core.reproduce.flying.situations.flown import NOBODY, counts, flight, is_due, passes
from lidar_core.reproduce.flying.situations.scenes import (
    DRONE,
    FALSE,
    FEW,
    GAPS,
    HEAD_ON,
    HEIGHT,
    HOVERS,
    PASS_SPEEDS,
    SWARM,
    WALL,
)
from lidar_core.reproduce.flying.situations.shapes import SIZES
from lidar_core.reproduce.jobs import Job, Part, grouped, run
from lidar_core.reproduce.types import Item, Measured, Request, Row

Goal: TypeAlias = tuple[str, float]
"""Comparison and limit."""
Line: TypeAlias = tuple[str, str, float | None, Goal | None]
"""Name, unit, value and goal of a row."""
PASSES = tuple(f"pass {speed:g} m/s" for speed in PASS_SPEEDS)
AHEAD = f"head-on {HEAD_ON:g} m/s"
WALLS = tuple(f"wall {gap:g} m" for gap in GAPS)
FAR = tuple(f"few {distance:g} m" for distance in FEW)
SITUATIONS = (*PASSES, AHEAD, *WALLS, "edge", "hovering", "swarm", *FAR, *SIZES, *FALSE)
SHORT, LONG = 100, 200
"""Scans of a flight."""
MOVED, UNKNOWN_S, FLYING_S = 0.1, 2.0, 0.3
"""What hovers has moved from this way on [m]; when it must be known, and as flying after it [s]."""
FEW_FROM_S, FEW_SCANS = 2.1, 5
"""Targets of few returns count a second after the burn-in [s], if one of so many scans met them."""
EDGE_DEG = 21.0
"""Elevation from which on a target is at the edge of the field of view [deg]."""


def _measure(request: Request) -> Measured:
    todo = jobs(request)
    of = grouped(todo, run(todo, request), "name", SITUATIONS)
    return Measured(
        (of,),
        scans=sum(job.scans for job in todo),
        note="OS1-128 at rest in a street, scans as its driver gives them, default configuration."
        f" Recall of flying tracks from {START_S} s on where a target has {FEWEST} returns; of"
        " passes after the third detection. Hexacopters of 0.65 m, if nothing else is said. Each"
        " row names its goal; `met` is 1 where it is reached.",
        config={"best": FlyingConfig()},
    )


def jobs(request: Request) -> list[Job]:
    """Return at least one flight per situation; more for swarms and for other movers."""
    each = request.scans / len(SITUATIONS)
    found = []
    for name in SITUATIONS:
        scans = LONG if name in ("swarm", *FALSE) else SHORT
        for number in range(max(1, round(each / scans))):
            arguments = {"seed": request.seed, "number": number, "scans": scans, "name": name}
            place = f"flying-situations-{name.replace('/', '-')}-{request.seed}-{number}-{scans}"
            found.append(Job(place, flight, arguments, scans))
    return found


def _rows(of: dict[str, list[Part]]) -> list[Row]:
    rows, reached = [], []
    for name, parts in of.items():
        for what, unit, value, goal in _lines(name, parts):
            if goal is None:
                rows.append(Row(f"{name}: {what}", unit, best_mode=value))
                continue
            rows.append(Row(f"{name}: {what}, goal {goal[0]} {goal[1]:g}", unit, best_mode=value))
            reached.append(_is_met(value, goal))
            rows.append(Row(f"{name}: {what}, met", "1", best_mode=float(reached[-1])))
    rows.append(Row("goals", "1", best_mode=float(len(reached))))
    rows.append(Row("goals met", "1", best_mode=float(sum(reached))))
    return rows


def _is_met(value: float | None, goal: Goal) -> bool:
    comparison, limit = goal
    if value is None:
        return False
    return value >= limit if comparison == ">=" else value <= limit


def _lines(name: str, parts: Sequence[Part]) -> list[Line]:
    """Rows of one situation."""
    special: dict[str, Callable[[Sequence[Part]], list[Line]]] = {
        "pass": _of_passes,
        "head-on": _of_passes,
        "hovering": _of_hovering,
        "swarm": _of_swarm,
        "few": lambda parts: _of_few(name, parts),
        "edge": lambda parts: _of_some(parts, _at_edge, 0.9),
        "wall": lambda parts: _of_some(parts, _at_wall, 0.95 if name == WALLS[0] else 0.8),
    }
    kind = name.partition(" ")[0]
    if kind in special:
        return special[kind](parts)
    return _of_size(name, parts) if name in SIZES else _of_nothing(name, parts)


def _of_passes(parts: Sequence[Part]) -> list[Line]:
    in_time, due = [], []
    for part in parts:
        of_part, mask = passes(part)
        in_time += of_part
        due.append(mask)
    share = float(np.mean(in_time)) if in_time else None
    return [
        ("passes", "1", float(len(in_time)), None),
        ("track by the third detection", "1", share, (">=", 1.0)),
        ("recall after it", "1", counts(parts, due).recall, (">=", 0.95)),
    ]


def _of_some(
    parts: Sequence[Part], chosen: Callable[[Part], NDArray[np.bool_]], goal: float
) -> list[Line]:
    """Rows of the scores over the `chosen` target scans, in which targets are hard to see."""
    found = counts(parts, [is_due(part) & chosen(part) for part in parts])
    return [
        ("target scans", "1", float(found.due), None),
        ("recall", "1", found.recall, (">=", goal)),
        ("number changes", "1", float(found.changes), None),
        ("false tracks", "1", float(found.false), ("<=", 0.0)),
    ]


def _at_wall(part: Part) -> NDArray[np.bool_]:
    """Return when a target that was tracked before is close to the wall, (S, T)."""
    level = np.linalg.norm(part["place"][..., :2], axis=2)
    known = np.maximum.accumulate(part["track"] != NOBODY, axis=0)
    # The nearest place is straight ahead of the wall; aside of it the way is longer.
    ahead = level >= min(WALL - gap - DRONE for gap in GAPS) - 0.3
    return np.asarray(ahead & known, np.bool_)


def _at_edge(part: Part) -> NDArray[np.bool_]:
    level = np.linalg.norm(part["place"][..., :2], axis=2)
    elevation = np.rad2deg(np.arctan2(part["place"][..., 2] - HEIGHT, level))
    return np.asarray(elevation >= EDGE_DEG, np.bool_)


def _of_hovering(parts: Sequence[Part]) -> list[Line]:
    known, flying = [], []
    for part in parts:
        seconds, moved = part["seconds"], np.linalg.norm(part["place"] - part["place"][0], axis=2)
        is_known = (part["any_track"] != NOBODY).all(axis=1)
        known.append(bool(is_known[(seconds >= UNKNOWN_S) & (seconds < HOVERS)].all()))
        start = seconds[np.argmax(moved[:, 0] > MOVED)]
        flies = (part["track"] != NOBODY).all(axis=1)
        late = seconds[flies & (seconds >= start)]
        flying.append(float(late[0] - start) if len(late) else np.inf)
    hovering = [(part["track"][part["seconds"] < HOVERS] != NOBODY).any() for part in parts]
    return [
        ("known within 2 s", "1", float(np.mean(known)), (">=", 1.0)),
        ("flying after it has moved, the latest", "s", max(flying), ("<=", FLYING_S)),
        ("called flying before it moves", "1", float(np.mean(hovering)), None),
    ]


def _of_swarm(parts: Sequence[Part]) -> list[Line]:
    found = counts(parts, [is_due(part) for part in parts])
    changes = found.changes * LONG / max(1, found.scans)
    return [
        ("targets", "1", float(SWARM), None),
        ("recall", "1", found.recall, None),
        (f"number changes in {LONG} scans", "1", changes, ("<=", 2.0)),
        ("false tracks", "1", float(found.false), ("<=", 0.0)),
    ]


def _of_few(name: str, parts: Sequence[Part]) -> list[Line]:
    """Rows for targets with about one return per scan; precision counts tracks in all scans."""
    due = [_was_met(part) & (part["seconds"][:, None] >= FEW_FROM_S) for part in parts]
    found = counts(parts, due)
    tracked = sum(int((part["track"] != NOBODY).sum()) for part in parts)
    reported = sum(int(part["n_flying"].sum()) for part in parts)
    span = FEW[float(name.split()[1])]
    hits = float(np.mean([part["hits"].mean() for part in parts]))
    return [
        ("returns per scan", "1", hits, None),
        ("recall", "1", found.recall, (">=", 0.9)),
        ("precision", "1", tracked / reported if reported else None, (">=", 0.95)),
        ("error", "m", found.error, ("<=", max(0.15, span / 2))),
    ]


def _was_met(part: Part) -> NDArray[np.bool_]:
    """Return whether each target had a hit in one of the last `FEW_SCANS` scans, (S, T)."""
    met = np.cumsum(part["hits"] > 0, axis=0)
    before = np.concatenate([np.zeros((FEW_SCANS, met.shape[1])), met[:-FEW_SCANS]])
    return np.asarray(met[: len(before)] > before[: len(met)], np.bool_)


def _of_size(name: str, parts: Sequence[Part]) -> list[Line]:
    found = counts(parts, [is_due(part) for part in parts])
    span = SIZES[name][1]
    nees = float(found.nees.mean() / 3) if len(found.nees) else None
    return [
        ("recall", "1", found.recall, (">=", 0.98)),
        ("error", "m", found.error, ("<=", max(0.15, 0.04 * span))),
        ("NEES / 3, at least", "1", nees, (">=", 0.5)),
        ("NEES / 3, at most", "1", nees, ("<=", 2.0)),
        ("number changes in 400 scans", "1", found.changes * 400 / found.scans, ("<=", 1.0)),
        ("false tracks", "1", float(found.false), ("<=", 0.0)),
    ]


def _of_nothing(name: str, parts: Sequence[Part]) -> list[Line]:
    found = counts(parts, [is_due(part) for part in parts])
    goal = {"insects": 2.0, "dust": 1.0}.get(name, 0.0)
    return [
        ("scans", "1", float(found.scans), None),
        ("false tracks in 1000 scans", "1", found.false * 1000 / found.scans, ("<=", goal)),
    ]


def _draw(figure: Any, of: dict[str, list[Part]]) -> None:
    """Draw which goals are reached."""
    met = [row for row in _rows(of) if row.name.endswith(", met")]
    values = [row.best_mode or 0.0 for row in met]
    figure.set_size_inches(7, 0.16 * len(met) + 1)
    axes = figure.subplots()
    axes.barh(
        np.arange(len(met)), np.ones(len(met)), color=[BLUE if value else RED for value in values]
    )
    axes.set_yticks(np.arange(len(met)), [row.name.removesuffix(", met") for row in met], size=5)
    axes.set_xticks([])
    axes.set(title="goals: met blue, missed red")
    axes.invert_yaxis()
    figure.tight_layout()


ITEM = Item(
    name="flying-situations",
    title="sizes, speeds, walls, edges, swarms, and what moves but does not fly",
    scans=10000,
    minutes=25,
    measure=_measure,
    rows=_rows,
    draw=_draw,
    grid="",
)
