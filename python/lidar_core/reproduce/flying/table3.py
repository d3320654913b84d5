"""`flying-table3`: simulated flights, position errors and recall of detections and tracks."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from lidar_core.evaluation import score_detections, score_tracks
from lidar_core.reproduce.common import COLOURS, KINDS, MODES, evaluation_config
from lidar_core.reproduce.flying.simulated.flights import both_modes, tables
from lidar_core.reproduce.flying.simulated.sightings import Sightings
from lidar_core.reproduce.flying.simulated.street import RADII, SHAPES, WAYS, jobs, sample
from lidar_core.reproduce.jobs import Part, run
from lidar_core.reproduce.types import Item, Measured, Request, Row

IDEAL_SHARE = 2 / 3
"""Share of the scans that are ideal; the others are noisy."""
PAPER = {"detections": (0.17, 0.10), "tracks": (0.24, 0.24)}
"""Mean and standard deviation of the position error [m], Table III, simulation."""
SLOW = 4.5
"""Limit of the rows on moments of up to 4 m/s^2; what differences of speeds tell of it swings."""


def _measure(request: Request) -> Measured:
    ideal = list(jobs(request, max(1, round(IDEAL_SHARE * request.scans)), is_noisy=False))
    noisy = list(
        jobs(request, max(1, request.scans - sum(job.scans for job in ideal)), is_noisy=True)
    )
    parts = run([*ideal, *noisy], request)
    exact, rough = parts[: len(ideal)], parts[len(ideal) :]
    ways = ", ".join(f"{way.kind} {way.speed:g} m/s {way.acceleration:g} m/s2" for way in WAYS)
    return Measured(
        (exact, rough),
        drawn=(exact,),
        scans=sum(job.scans for job in (*ideal, *noisy)),
        note=f"OS1-128, 5 to 20 m; any: radius {RADII[0]:g} to {RADII[1]:g} m, unknown. Flights:"
        f" {ways}. noisy: ranges 0.03 m, poses 0.05 m / 0.5 deg per axis, white per scan.",
        config={**both_modes(), "evaluation": evaluation_config()},
    )


def _rows(exact: Sequence[Part], rough: Sequence[Part]) -> list[Row]:
    return [*_rows_of(exact, ""), *_rows_of(rough, "noisy ")]


def _rows_of(parts: Sequence[Part], prefix: str) -> list[Row]:
    rows: list[Row] = []
    for shape in SHAPES:
        for kind in KINDS:
            known = PAPER[kind] if prefix == "" and not shape.startswith("any") else ()
            names = (f"{prefix}{shape}, {kind}: {name}" for name, _ in QUANTITIES)
            columns = (_numbers(sample(parts, mode, kind, shape)) for mode in MODES)
            units = (unit for _, unit in QUANTITIES)
            published = (*known, *[None] * (len(QUANTITIES) - len(known)))
            rows += map(Row, names, units, published, *columns)
    counts = (_counts(parts, mode) for mode in MODES)
    rows += [
        Row(f"{prefix}{name}", "count", None, paper, best)
        for name, paper, best in zip(COUNTED, *counts, strict=True)
    ]
    return rows


QUANTITIES = (
    ("mean error", "m"),
    ("std of the error", "m"),
    ("mean along the line of sight", "m"),
    ("mean error up to 4 m/s2", "m"),
    ("recall", "1"),
)


def _numbers(seen: Sightings) -> list[float | None]:
    """Values of `QUANTITIES`; None where nothing was seen or found."""
    found = seen.is_found
    error, slow = seen.error[found], seen.error[found & (seen.acceleration <= SLOW)]
    samples = (error, slow, seen.along[found], found)
    mean, mean_slow, along, recall = (float(x.mean()) if len(x) else None for x in samples)
    return [mean, float(error.std()) if len(error) else None, along, mean_slow, recall]


COUNTED = ("false tracks", "changes of identity", "false detections", "duplicate detections")


def _counts(parts: Sequence[Part], mode: str) -> tuple[int, ...]:
    """Sums of `COUNTED` over all flights."""
    config = evaluation_config()
    tracks = [
        score_tracks(*tables(part, mode, "tracks", config=config), config=config) for part in parts
    ]
    found = [
        score_detections(*tables(part, mode, "detections", config=config), config=config)
        for part in parts
    ]
    return (
        sum(len(one.false_ids) for one in tracks),
        sum(one.n_switches for one in tracks),
        sum(one.n_false for one in found),
        sum(one.n_duplicate for one in found),
    )


def _draw(figure: Any, parts: Sequence[Part]) -> None:
    """Draw the distributions of the errors per shape, with the paper's mean."""
    panels = figure.subplots(1, 2, sharey=True)
    for axes, kind in zip(panels, KINDS, strict=True):
        for offset, mode in zip((-0.2, 0.2), MODES, strict=True):
            colour = COLOURS[mode]
            seen = [sample(parts, mode, kind, shape) for shape in SHAPES]
            errors = [one.error[one.is_found] for one in seen]
            drawn = axes.boxplot(
                errors,
                positions=np.arange(len(SHAPES)) + offset,
                widths=0.3,
                whis=(5, 95),
                showfliers=False,
                showmeans=True,
                manage_ticks=False,
            )
            for line in (line for lines in drawn.values() for line in lines):
                line.set(color=colour, markerfacecolor=colour, markeredgecolor=colour)
            axes.plot([], [], color=colour, label=f"{mode} mode")
        axes.axhline(PAPER[kind][0], color="#9aa5b1", ls="--", label="mean in the paper")
        axes.set(title=kind, xticks=range(len(SHAPES)), xticklabels=SHAPES)
        axes.legend()
    panels[0].set_ylabel("position error [m]; box 25-75 %, whiskers 5-95 %")
    panels[0].set_ylim(bottom=0)


ITEM = Item(
    name="flying-table3",
    title="simulated flights: position errors and recall of detections and tracks (Table III)",
    scans=4500,
    minutes=18,
    measure=_measure,
    rows=_rows,
    draw=_draw,
    grid="y",
    heading="Simulated flights, ideal: position error",
)
