"""`circles-real`: recordings of 2D scanners: static objects, track IDs, vehicles, people."""

from typing import Any

import numpy as np

from lidar_core.circles import CircleElements, CirclePipeline, CirclesConfig
from lidar_core.errors import InputError
from lidar_core.reproduce.circles.real_data.rooms import (
    CORRIDOR,
    PERSONS,
    ROOMS,
    Room,
    room_config,
    room_scans,
    vehicle_at,
)
from lidar_core.reproduce.circles.real_data.scores import (
    Measure,
    Seen,
    identity_measures,
    people_measures,
    standing_measures,
    vehicle_measures,
)
from lidar_core.reproduce.circles.real_data.standing import returns_world, standing, things
from lidar_core.reproduce.common import BLUE, RED
from lidar_core.reproduce.jobs import Job, Part, run
from lidar_core.reproduce.recordings import recording
from lidar_core.reproduce.types import Item, Measured, Request, Row

LENGTHS = {
    "intersection": 85,
    "overtake_ego": 135,
    "overtake_red": 129,
    "parallel": 219,
    "aces": 400,
    "fr079": 400,
    "intel": 400,
    "mit-csail": 400,
    "example1": 71,
    "example3": 104,
    "example4": 91,
    "example5": 146,
    "example7": 233,
    "example8": 205,
}
"""Scans of the recordings in a full run, for the progress."""
SHORTEST = 60


def room(*, name: str, scans: int) -> Part:
    """Give the first `scans` scans of a recording to a pipeline; return its measures."""
    found = measures(next(one for one in (*ROOMS, *CORRIDOR) if one.name == name), scans)
    return {
        "name": np.array([what for what, _, _ in found], np.str_),
        "unit": np.array([unit for _, unit, _ in found], np.str_),
        "value": np.array([np.nan if value is None else value for _, _, value in found]),
    }


def measures(one: Room, scans: int, config: CirclesConfig | None = None) -> list[Measure]:
    """Measure one recording; `config` None is the default one."""
    items = room_scans(one)[:scans]
    config = room_config(items, config or CirclesConfig())
    stamps = np.array([item.scan.stamp_ns for item in items])
    seconds = (stamps - stamps[0]) * 1e-9
    (scanner,) = config.scanners.values()
    points = [returns_world(item, scanner.range_max) for item in items]
    pipeline = CirclePipeline(config)
    maps: list[CircleElements | None] = []
    for item in items:
        try:
            maps.append(pipeline.process(item).map)
        except InputError:
            maps.append(None)  # a stamp twice
    seen = Seen(seconds, points, things(points, standing(points, seconds)), maps)
    found = [*standing_measures(seen), *identity_measures(seen)]
    if one.vehicle is not None:
        found += vehicle_measures(seen, *vehicle_at(recording(one.path), one.vehicle, stamps))
    if one.name in PERSONS:
        found += people_measures(seen, PERSONS[one.name])
    return [("scans", "1", float(len(items))), *found]


def _measure(request: Request) -> Measured:
    for name in ITEM.data:
        recording(name)  # refuses before the first long run
    share = min(1.0, request.scans / ITEM.scans)
    jobs = [
        Job(
            name=f"circles-real-{name}-{scans}",
            function=room,
            arguments={"name": name, "scans": scans},
            scans=scans,
        )
        for name, length in LENGTHS.items()
        for scans in [min(length, max(SHORTEST, round(share * length)))]
    ]
    made = dict(zip(LENGTHS, run(jobs, request), strict=True))
    return Measured(
        (made,),
        scans=sum(job.scans for job in jobs),
        note="Standing: 0.9 of the scans of some 3 s have a return within 0.15 m, found without the"
        " pipeline. A jump: a number moves more than 1 m, faster than 5 m/s. The origin of a"
        " vehicle's motion capture need not be the middle of what is seen.",
        config={"best": CirclesConfig()},
    )


def _rows(made: dict[str, Part]) -> list[Row]:
    return [
        Row(f"{name}/{what}", str(unit), None, None, None if np.isnan(value) else float(value))
        for name, part in made.items()
        for what, unit, value in zip(part["name"], part["unit"], part["value"], strict=True)
    ]


def _draw(figure: Any, made: dict[str, Part]) -> None:
    """Draw, per recording, the share of static elements with speed and the number of jumps."""
    rows = {row.name: row.best_mode for row in _rows(made)}
    fast, jumps = figure.subplots(2, 1, sharex=True)
    for axes, what, color in (
        (fast, "standing, reported faster than 0.3 m/s", RED),
        (jumps, "jumps per minute", BLUE),
    ):
        axes.bar(
            range(len(made)), [rows[f"{name}/{what}"] or 0.0 for name in made], 0.6, color=color
        )
        axes.set(ylabel=what)
    jumps.set_xticks(range(len(made)), list(made), rotation=30)


ITEM = Item(
    name="circles-real",
    title="rooms with motion capture, offices and a corridor: what stands, numbers, people",
    scans=sum(LENGTHS.values()),
    minutes=8,
    measure=_measure,
    rows=_rows,
    draw=_draw,
    data=tuple(one.path for one in (*ROOMS, *CORRIDOR)),
)
