"""`flying-real`: real sequences in which nothing flies, as they are and with inserted targets."""

from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_core.evaluation import assign
from lidar_core.flying import FlyingConfig
from lidar_core.reproduce.common import BLUE
from lidar_core.reproduce.jobs import Job, Part, run
from lidar_core.reproduce.real_runs import false_tracks, reported
from lidar_core.reproduce.real_sequences import SEQUENCES, sequence_named, sequence_scans
from lidar_core.reproduce.real_targets import (
    FEWEST,
    SHAPES,
    RealScan,
    drawn_flights,
    real_scans,
    with_targets,
)
from lidar_core.reproduce.recordings import recording
from lidar_core.reproduce.types import Item, Request, Result, Row

FLIGHTS = 20
"""Runs with targets per sequence, one target of every shape in each."""
SHORTEST = 14
START_S = 1.1
"""Targets have to be found from here on, counted from the first scan [s]."""
GATE, GATE_SDS = 0.5, 3.0
"""A track this far from a target is its own: the larger of both [m], [standard deviations]."""
LENGTHS = {
    "radiate_tiny_foggy": 60, "street_128_labelled": 30, "livox_hap_outdoor": 30,
    "livox_horizon_sway": 24, "rs16_office": 56,
}  # fmt: skip
"""Scans of the sequences, for the progress."""
BARE = -1
"""Number of the run without targets."""


def _run(request: Request) -> Result:
    for name in ITEM.data:
        recording(name)  # refuses before the first long run
    todo = jobs(request)
    parts = run(todo, request)
    of = {one.name: [part for job, part in zip(todo, parts, strict=True)
                     if job.arguments["name"] == one.name] for one in SEQUENCES}  # fmt: skip
    return Result(
        rows=tuple(_rows(of)),
        draw=lambda figure: _draw(figure, of),
        scans=sum(job.scans for job in todo),
        note=f"false_tracks: distinct numbers in the sequence as it is. With a sphere, a"
        f" hexacopter and a quadcopter that go along with the sensor: recall of tracks from"
        f" {START_S} s on, where a target has {FEWEST} returns; errors from the target's centre"
        " [m]. own_body: share of rays. None of the numbers of radiate_tiny_foggy may be printed.",
        config={"best": FlyingConfig()},
    )


def jobs(request: Request) -> list[Job]:
    """Every sequence as it is, and `FLIGHTS` runs with targets, or as many as `scans` allow."""
    whole = sum(LENGTHS.values())
    flights = min(FLIGHTS, max(1, round(request.scans / whole) - 1))
    share = min(1.0, request.scans / (2 * whole))
    found = []
    for name, length in LENGTHS.items():
        scans = min(length, max(SHORTEST, round(share * length)))
        for number in range(BARE, flights):
            arguments = {"seed": request.seed, "name": name, "number": number, "scans": scans}
            place = f"flying-real-{name}-{request.seed}-{number}-{scans}"
            found.append(Job(place, flight, arguments, scans))
    return found


def flight(*, seed: int, name: str, number: int, scans: int) -> Part:
    """Run the detector over one sequence; with targets unless `number` is `BARE`.

    Returns
    -------
    part : dict
        The columns of `reported`, and of the targets: place and hits, (S, T, 3) and (S, T),
        and the time of each scan [s].
    """
    sequence = sequence_named(name)
    prepared = _prepared(name)[:scans]
    items = [scan.item for scan in prepared]
    places, hits = np.empty((len(items), 0, 3)), np.empty((len(items), 0), np.int64)
    if number != BARE:
        of_sequence = list(LENGTHS).index(name)
        rng = np.random.default_rng([20240607, seed, of_sequence, number])
        flights = drawn_flights(prepared, sequence, rng)
        items, places, hits = with_targets(prepared, flights, sequence, rng)
    part = reported(items, FlyingConfig())
    stamps = np.array([item.scan.stamp_ns for item in items])
    return part | {
        "place": places, "hits": hits, "seconds": (stamps - stamps[0]) * 1e-9,
        "number": np.array(number),
    }  # fmt: skip


@lru_cache(maxsize=1)
def _prepared(name: str) -> list[RealScan]:
    """Scans of a sequence, kept for the next run in this process."""
    sequence = sequence_named(name)
    return real_scans(list(sequence_scans(sequence)), sequence)


def matches(part: Part) -> NDArray[np.int64]:
    """Row of the track of every target in every scan, (S, T); -1 for none."""
    found = np.full(part["hits"].shape, -1, np.int64)
    for scan in range(len(found)):
        rows = np.flatnonzero(part["scan"] == scan)
        away = np.linalg.norm(part["position"][rows, None] - part["place"][scan], axis=2)
        gate = np.maximum(GATE, GATE_SDS * part["std"][rows])[:, None]
        of_rows, of_targets = assign(np.where(away <= gate, away, np.inf), gate=1e6)
        found[scan, of_targets] = rows[of_rows]
    return found


def _rows(of: dict[str, list[Part]]) -> list[Row]:
    rows = []
    for name, parts in of.items():
        bare = next(part for part in parts if part["number"] == BARE)
        false = false_tracks(bare)
        own = float(bare["own_body"][-1])
        values: list[tuple[str, str, float | None]] = [
            ("scans", "1", float(len(bare["sensor"]))),
            ("false_tracks", "1", float(len(false))),
            ("false_tracks, own body", "1", float(sum(one.is_own_body for one in false))),
            ("own_body", "1", own if np.isfinite(own) else None),
            *_of_targets([part for part in parts if part["number"] != BARE]),
        ]
        rows += [Row(f"{name}/{what}", unit, None, None, value) for what, unit, value in values]
    return rows


def _of_targets(parts: Sequence[Part]) -> list[tuple[str, str, float | None]]:
    """Recall of every shape, errors of their tracks, and tracks of nothing beside them."""
    names = list(SHAPES)
    is_due, is_found, is_open, along, across, false = [], [], [], [], [], 0
    for part in parts:
        partner = matches(part)
        due = (part["hits"] >= FEWEST) & (part["seconds"][:, None] >= START_S)
        is_due.append(due)
        is_found.append(due & (partner >= 0))
        is_open.append(np.broadcast_to(part["gate_open"][:, None], due.shape))
        false += len(false_tracks(part, part["id"][partner[partner >= 0]].tolist()))
        scan, target = np.nonzero(is_found[-1])
        sight = part["place"][scan, target] - part["sensor"][scan]
        sight /= np.linalg.norm(sight, axis=1)[:, None]
        error = part["position"][partner[scan, target]] - part["place"][scan, target]
        ahead = np.sum(error * sight, axis=1)
        along.append(ahead)
        across.append(np.linalg.norm(error - ahead[:, None] * sight, axis=1))
    due, found = np.concatenate(is_due).sum(axis=0), np.concatenate(is_found).sum(axis=0)
    ready = np.concatenate(is_open) & np.concatenate(is_due)
    after = (np.concatenate(is_found) & ready).sum()
    ahead, aside = np.concatenate(along), np.concatenate(across)
    shapes = [
        (f"recall, {name}", "1", _share(found[column], due[column]))
        for column, name in enumerate(names)
    ]
    count = sum((part["hits"] > 0).any(axis=0).sum() for part in parts)
    return [
        ("targets", "1", float(count)),
        ("target scans", "1", float(due.sum())),
        ("recall", "1", _share(found.sum(), due.sum())),
        *shapes,
        ("recall, after the burn-in", "1", _share(after, ready.sum())),
        ("error", "m", _rms(np.hypot(ahead, aside))),
        ("error, along the line of sight", "m", _rms(ahead)),
        ("error, across it", "m", _rms(aside)),
        ("false_tracks, with targets", "1", float(false)),
    ]


def _share(part: float, whole: float) -> float | None:
    return float(part / whole) if whole else None


def _rms(values: NDArray[np.float64]) -> float | None:
    return float(np.sqrt(np.mean(values**2))) if len(values) else None


def _draw(figure: Any, of: dict[str, list[Part]]) -> None:
    """Recall per sequence and shape, and the false tracks of the sequence as it is."""
    rows = {row.name: row.best_mode for row in _rows(of)}
    recall, false = figure.subplots(2, 1, sharex=True)
    for offset, shape in zip((-0.25, 0.0, 0.25), SHAPES, strict=True):
        values = [rows[f"{name}/recall, {shape}"] or 0.0 for name in of]
        recall.bar(np.arange(len(of)) + offset, values, 0.23, label=shape)
    recall.set(ylabel="recall of tracks", ylim=(0, 1))
    recall.legend()
    counts = [rows[f"{name}/false_tracks"] or 0.0 for name in of]
    bars = false.bar(np.arange(len(of)), counts, 0.5, color=BLUE)
    false.bar_label(bars)
    false.set(ylabel="false tracks")
    false.set_xticks(range(len(of)), list(of), rotation=15)


ITEM = Item(
    name="flying-real",
    title="real sequences of five sensors, as they are and with inserted targets",
    scans=4200,
    minutes=25,
    run=_run,
    data=tuple(file for one in SEQUENCES for file in one.files),
)
