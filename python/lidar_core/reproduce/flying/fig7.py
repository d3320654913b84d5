"""`flying-fig7`: errors and recall over distance, speed and acceleration, simulated."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_core.evaluation import binned
from lidar_core.reproduce.common import COLOURS, KINDS, MODES, Kind, evaluation_config, middles
from lidar_core.reproduce.flying.simulated.flights import both_modes
from lidar_core.reproduce.flying.simulated.sightings import Sightings
from lidar_core.reproduce.flying.simulated.street import jobs, sample
from lidar_core.reproduce.jobs import Part, run
from lidar_core.reproduce.types import Item, Measured, Request, Row

SHAPES = ("sphere", "mesh")
"""Drones of the paper's size."""
AXES = (
    ("distance", "m", (2.5, 5.0, 7.5, 10.0, 12.5, 15.0, 17.5, 20.0)),
    ("speed", "m/s", (0.0, 0.5, 1.5, 2.5, 3.5, 4.5, 6.0, 8.0, 10.5)),
    ("acceleration", "m/s2", (0.0, 0.5, 1.5, 3.0, 5.0, 9.0)),
)
"""What the sightings are grouped by: column of `Sightings`, unit, edges."""


def _measure(request: Request) -> Measured:
    todo = list(jobs(request, request.scans, is_noisy=False))
    parts = run(todo, request)
    seen = {(mode, kind): _join(parts, mode, kind) for mode in MODES for kind in KINDS}
    return Measured(
        (seen,),
        scans=sum(job.scans for job in todo),
        note="The ideal flights of flying-table3, sphere and mesh together; a point stands for the"
        " group around it. The paper shows curves without numbers.",
        config={**both_modes(), "evaluation": evaluation_config()},
    )


def _join(parts: Sequence[Part], mode: str, kind: Kind) -> Sightings:
    both = [sample(parts, mode, kind, shape) for shape in SHAPES]
    names = Sightings.__slots__
    return Sightings(*(np.concatenate([getattr(one, name) for one in both]) for name in names))


def _rows(seen: dict[tuple[str, Kind], Sightings]) -> list[Row]:
    rows = []
    for axis, unit, edges in AXES:
        for kind in KINDS:
            curves = [_curves(seen[mode, kind], axis, edges) for mode in MODES]
            for place, (name, of) in enumerate((("error", "m"), ("recall", "1"))):
                for number, middle in enumerate(middles(edges)):
                    values = (float(curve[place][number]) for curve in curves)
                    known = (one if np.isfinite(one) else None for one in values)
                    rows.append(Row(f"{name} of {kind}@{middle:g}{unit}", of, None, *known))
    return rows


def _curves(
    seen: Sightings, axis: str, edges: Sequence[float]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Mean error of the found sightings, and recall, per group; NaN in empty groups."""
    keys, found = getattr(seen, axis), seen.is_found
    error = binned(keys[found], seen.error[found], edges=edges)
    return error.mean, binned(keys, found.astype(float), edges=edges).mean


def _draw(figure: Any, seen: dict[tuple[str, Kind], Sightings]) -> None:
    """Draw errors above and recall below, one column per quantity."""
    panels = figure.subplots(2, len(AXES), sharey="row", sharex="col")
    for column, (axis, unit, edges) in enumerate(AXES):
        for (mode, kind), one in seen.items():
            style = {"color": COLOURS[mode], "ls": "-" if kind == "detections" else "--"}
            for row, curve in enumerate(_curves(one, axis, edges)):
                panels[row, column].plot(
                    middles(edges), curve, marker=".", label=f"{mode} mode, {kind}", **style
                )
        panels[1, column].set_xlabel(f"{axis} [{unit}]")
    panels[0, 0].set(ylabel="mean position error [m]", ylim=(0, None))
    panels[1, 0].set(ylabel="recall", ylim=(0, 1.05))
    panels[0, 0].legend(fontsize=8)


ITEM = Item(
    name="flying-fig7",
    title="simulated flights: error and recall over distance, speed, acceleration (Fig. 7)",
    scans=3000,
    minutes=12,
    measure=_measure,
    rows=_rows,
    draw=_draw,
    heading="Simulated flights, ideal",
)
