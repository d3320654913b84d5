"""`flying-real`: real sequences without flying objects, unchanged and with inserted targets."""

from functools import lru_cache
from typing import Any

import numpy as np

from lidar_core.flying import FlyingConfig
from lidar_core.reproduce.common import BLUE
from lidar_core.reproduce.flying.real_data.inserted_targets import (
    TARGETS,
    RealScan,
    drawn_flights,
    real_scans,
    with_targets,
)
from lidar_core.reproduce.flying.real_data.labelled_boxes import (
    MovingCounts,
    moving_scores,
    read_boxes,
    speeds,
)
from lidar_core.reproduce.flying.real_data.lost_returns import drawn_patches, with_losses
from lidar_core.reproduce.flying.real_data.reported import false_tracks, reported
from lidar_core.reproduce.flying.real_data.scores import FEWEST, START_S, scores
from lidar_core.reproduce.flying.real_data.sequences import (
    SEQUENCES,
    sequence_named,
    sequence_scans,
)
from lidar_core.reproduce.jobs import Job, Part, grouped, run
from lidar_core.reproduce.recordings import recording
from lidar_core.reproduce.types import Item, Measured, Request, Row

FLIGHTS = 20
"""Runs with targets per sequence, one target of every shape in each."""
SHORTEST = 14
LENGTHS = {
    "radiate_tiny_foggy": 60,
    "street_128_labelled": 30,
    "livox_hap_outdoor": 30,
    "livox_horizon_sway": 24,
    "rs16_office": 56,
}
"""Scans of the sequences, for the progress."""
BARE, LOSSES = -1, -2
"""Numbers of the runs without targets: as it is, and with returns lost in patches."""


def _measure(request: Request) -> Measured:
    for name in ITEM.data:
        recording(name)  # refuses before the first long run
    todo = jobs(request)
    of = grouped(todo, run(todo, request), "name", [one.name for one in SEQUENCES])
    return Measured(
        (of,),
        scans=sum(job.scans for job in todo),
        note=f"false_tracks: distinct numbers in the sequence as it is. With a sphere, a"
        f" hexacopter and a quadcopter that go along with the sensor: recall of tracks from"
        f" {START_S} s on, where a target has {FEWEST} returns; errors from the target's centre"
        " [m]. own_body: share of rays. moving: points of the class MOVING against labelled"
        " boxes that move; recall: mean share of their points, within 20 m. None of the"
        " numbers of radiate_tiny_foggy may be printed.",
        config={"best": FlyingConfig()},
    )


def jobs(request: Request) -> list[Job]:
    """Return jobs: every sequence unchanged, and `FLIGHTS` runs with targets, as `scans` allow."""
    whole = sum(LENGTHS.values())
    flights = min(FLIGHTS, max(1, round(request.scans / whole) - 2))
    share = min(1.0, request.scans / (3 * whole))
    found = []
    for name, length in LENGTHS.items():
        scans = min(length, max(SHORTEST, round(share * length)))
        for number in range(LOSSES, flights):
            arguments = {"seed": request.seed, "name": name, "number": number, "scans": scans}
            place = f"flying-real-2-{name}-{request.seed}-{number}-{scans}"
            found.append(Job(place, flight, arguments, scans))
    return found


def flight(*, seed: int, name: str, number: int, scans: int) -> Part:
    """Run the detector over one sequence; with targets if `number` is not negative.

    Returns
    -------
    part : dict
        The columns of `reported`, and of the targets: place and hits, (S, T, 3) and (S, T),
        and the time of each scan [s].
    """
    sequence = sequence_named(name)
    prepared = _load_scans(name)[:scans]
    items = [scan.item for scan in prepared]
    places, hits = np.empty((len(items), 0, 3)), np.empty((len(items), 0), np.int64)
    rng = np.random.default_rng([20240607, seed, list(LENGTHS).index(name), number + 2])
    if number == LOSSES:
        items = with_losses(prepared, drawn_patches(prepared, rng))
    if number >= 0:
        flights = drawn_flights(prepared, sequence, rng)
        items, places, hits = with_targets(prepared, flights, sequence, rng)
    stamps = np.array([item.scan.stamp_ns for item in items])
    seconds = (stamps - stamps[0]) * 1e-9
    counts = None
    if number == BARE and sequence.labels:
        boxes = read_boxes(sequence)
        poses = [scan.pose for scan in prepared]
        counts = MovingCounts(boxes, speeds(boxes, poses, seconds.tolist()))
    return reported(items, FlyingConfig(), also=counts) | {
        "place": places,
        "hits": hits,
        "seconds": seconds,
        "number": np.array(number),
    }


@lru_cache(maxsize=1)
def _load_scans(name: str) -> list[RealScan]:
    """Scans of a sequence with their rays; the result is cached for later calls in this process."""
    return real_scans(list(sequence_scans(sequence_named(name))))


def _rows(of: dict[str, list[Part]]) -> list[Row]:
    rows = []
    for name, parts in of.items():
        bare, lossy = (
            next(part for part in parts if part["number"] == number) for number in (BARE, LOSSES)
        )
        false = false_tracks(bare)
        own = float(bare["own_body"][-1])
        values: list[tuple[str, str, float | None]] = [
            ("scans", "1", float(len(bare["sensor"]))),
            ("false_tracks", "1", float(len(false))),
            ("false_tracks, own body", "1", float(sum(one.is_own_body for one in false))),
            ("false_tracks, patches deleted", "1", float(len(false_tracks(lossy)))),
            ("own_body", "1", own if np.isfinite(own) else None),
            *moving_scores(bare),
            *scores([part for part in parts if part["number"] >= 0], tuple(TARGETS)),
        ]
        rows += [Row(f"{name}/{what}", unit, None, None, value) for what, unit, value in values]
    return rows


def _draw(figure: Any, of: dict[str, list[Part]]) -> None:
    """Draw recall per sequence and shape, and the false tracks of the unchanged sequence."""
    rows = {row.name: row.best_mode for row in _rows(of)}
    recall, false = figure.subplots(2, 1, sharex=True)
    for offset, shape in zip((-0.25, 0.0, 0.25), TARGETS, strict=True):
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
    scans=4400,
    minutes=25,
    measure=_measure,
    rows=_rows,
    draw=_draw,
    grid="",
    data=tuple(file for one in SEQUENCES for file in one.files),
)
