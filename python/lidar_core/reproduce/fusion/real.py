"""`fusion-real`: recordings of LiDAR and radar by other groups."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from lidar_core.fusion import FusionConfig, MultiTargetConfig
from lidar_core.reproduce.common import BLUE, GREY
from lidar_core.reproduce.fusion.real_data.boats import SCENARIOS, boat_rows, files_of
from lidar_core.reproduce.fusion.real_data.one_target import FILES, file_rows
from lidar_core.reproduce.fusion.real_data.radar import DELPHI, SCANS, radar_rows
from lidar_core.reproduce.recordings import recording
from lidar_core.reproduce.types import Item, Measured, Request, Row

SHORTEST = 100
"""Rows or scans of each recording at least."""


def _measure(request: Request) -> Measured:
    for name in ITEM.data:
        recording(name)  # refuses before the first run
    rows, done = [], 0
    for name, (_, length, _) in FILES.items():
        count = _part(length, request)
        rows += file_rows(name, count)
        request.advance(count)
        done += count
    boats = []
    for scenario, length in SCENARIOS.items():
        count = _part(length, request)
        boats += boat_rows(scenario, count, MultiTargetConfig.boats())
        request.advance(count)
        done += count
    count = _part(SCANS, request)
    rows += [*boats, *_over_all(boats), *radar_rows(count)]
    request.advance(count)
    done += count
    return Measured(
        (rows,),
        scans=done,
        note="L/R files: the default filter, after the first 3 s; Autoferry: what `lidar-core fuse`"
        " does without options. A track is of a target within 15 m, one to one; scans count"
        " outside detection gaps of more than 3 s. GOSPA has c = 30 m, p = 2, over all scans."
        " Goals: 1.15; shares of at least 0.92 (17: 0.65), GOSPA below the empty output and 22 m in"
        " the mean, 0.3 false tracks per scan, 2 changes of id, 95 % regions that hold in 0.90 to"
        " 0.98. Radar of a car: NIS per value of 0.8 to 1.25, what stands at most 0.3 m/s, no"
        " alarm.",
        config={"fusion": FusionConfig(), "fusion_many": MultiTargetConfig.boats()},
    )


def _part(length: int, request: Request) -> int:
    """Number of rows or scans to run of a recording; a run of full length uses `length`."""
    return min(length, max(SHORTEST, round(length * request.scans / ITEM.scans)))


def _over_all(boats: Sequence[Row]) -> list[Row]:
    """Rows of the mean GOSPA, false tracks per scan and MOTA over all boat scenarios."""
    rows = []
    for what, unit in (("GOSPA", "m"), ("false tracks per scan", "1"), ("MOTA", "1")):
        values = [row.best_mode for row in boats if row.name.endswith(f"/{what}")]
        known = [value for value in values if value is not None]
        rows.append(
            Row(f"autoferry/mean {what}", unit, best_mode=float(np.mean(known)) if known else None)
        )
    return rows


def _rows(rows: Sequence[Row]) -> list[Row]:
    return list(rows)


def _draw(figure: Any, rows: Sequence[Row]) -> None:
    """Draw GOSPA of every scenario beside that of an empty output, and shares of time tracked."""
    values = {row.name: row.best_mode or 0.0 for row in rows}
    upper, lower = figure.subplots(2, 1, sharex=True)
    places = np.arange(len(SCENARIOS))
    for offset, what, colour in ((-0.2, "GOSPA", BLUE), (0.2, "GOSPA, empty output", GREY)):
        heights = [values[f"autoferry {number}/{what}"] for number in SCENARIOS]
        upper.bar(places + offset, heights, 0.4, color=colour, label=what)
    upper.set(ylabel="GOSPA [m]")
    upper.legend()
    shares = [values[f"autoferry {number}/one-to-one share, lesser target"] for number in SCENARIOS]
    lower.bar(places, shares, 0.6, color=BLUE)
    lower.set(ylabel="share of time tracked", ylim=(0, 1))
    lower.set_xticks(places, [f"Autoferry {number}" for number in SCENARIOS])


ITEM = Item(
    name="fusion-real",
    title="LiDAR and radar: recordings of one target, of boats, and of a car's radar",
    scans=sum(length for _, length, _ in FILES.values()) + sum(SCENARIOS.values()) + SCANS,
    minutes=0.3,
    measure=_measure,
    rows=_rows,
    draw=_draw,
    grid="y",
    heading="Boats seen by LiDAR and radar",
    counts="scans",
    data=(
        *(place for place, _, _ in FILES.values()),
        DELPHI,
        *(place for number in SCENARIOS for place in files_of(number)),
    ),
)
