"""`tracking-clutter`: eight targets among 10 and 50 false measurements a scan."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from lidar_core.evaluation import ospa
from lidar_core.fusion import FusionConfig, MultiTargetConfig
from lidar_core.reproduce.common import BLUE, GREY, RED, in_space
from lidar_core.reproduce.tracking.arena import Arena, are_matched, followed
from lidar_core.reproduce.types import Item, Measured, Request, Row

CLUTTER = (10, 50)
DETECTION = 0.7
CUTOFF = 1.0
"""OSPA's c, and the largest distance of a track that is not false [m]."""
ASSOCIATIONS = ("integrated", "joint", "nearest")


@dataclass(frozen=True, slots=True)
class Score:
    """Means over scans.

    Attributes
    ----------
    ospa : float
        OSPA distance [m].
    false, missed : float
        Reported tracks without a target, targets without a reported track.
    """

    ospa: float
    false: float
    missed: float


def scored(arena: Arena, config: MultiTargetConfig, rng: np.random.Generator) -> Score:
    """Run the tracker once and return its mean scores over the scans."""
    rows = []
    for moment, tracks in followed(arena, config, rng):
        places = tracks.position[tracks.confirmed]
        found = int(are_matched(places, np.full(len(places), CUTOFF), moment.truth).sum())
        far = ospa(in_space(places), in_space(moment.truth), cutoff=CUTOFF, order=1.0)
        rows.append((far, len(places) - found, len(moment.truth) - found))
    return Score(*np.mean(rows, axis=0).tolist())


def _measure(request: Request) -> Measured:
    found = {}
    for association in ASSOCIATIONS:
        config = (
            MultiTargetConfig()
            if association == "integrated"
            else MultiTargetConfig.load({"association": association, "target": FusionConfig()})
        )
        for clutter in CLUTTER:
            runs = [
                scored(
                    Arena(clutter, DETECTION),
                    config,
                    np.random.default_rng([20260606, request.seed, clutter, run]),
                )
                for run in range(request.scans)
            ]
            found[association, clutter] = runs
    request.advance(request.scans)
    return Measured(
        (found,),
        scans=request.scans,
        note="40 x 40 m, 5 scans a second, targets measured with probability .7, default"
        " configuration; other values of `association` with the default filter of one target."
        " OSPA with c = 1 m, p = 1, after the first 1.1 s. Goals: OSPA at most .20 m and false"
        " tracks at most .03 with 10 false measurements, .40 m and .2 with 50.",
        config={"fusion_many": MultiTargetConfig()},
    )


def _rows(found: Mapping[tuple[str, int], list[Score]]) -> list[Row]:
    rows = []
    for (association, clutter), runs in found.items():
        of = f"{association}, clutter {clutter}"
        values = {
            ("OSPA", "m"): np.mean([run.ospa for run in runs]),
            ("false tracks per scan", "1"): np.mean([run.false for run in runs]),
            ("missed targets per scan", "1"): np.mean([run.missed for run in runs]),
        }
        rows += [
            Row(f"{of}: {what}", unit, best_mode=float(v)) for (what, unit), v in values.items()
        ]
    return rows


def _draw(figure: Any, found: Mapping[tuple[str, int], list[Score]]) -> None:
    """Draw OSPA, one bar per association and clutter."""
    panel = figure.subplots()
    for offset, (name, colour) in enumerate(zip(ASSOCIATIONS, (BLUE, RED, GREY), strict=True)):
        means = [np.mean([run.ospa for run in found[name, clutter]]) for clutter in CLUTTER]
        panel.bar(np.arange(len(CLUTTER)) + 0.27 * offset, means, 0.27, color=colour, label=name)
    panel.set_xticks(np.arange(len(CLUTTER)) + 0.27, [f"clutter {n}" for n in CLUTTER])
    panel.set(ylabel="OSPA [m]")
    panel.legend()


ITEM = Item(
    name="tracking-clutter",
    title="LiDAR and radar: eight targets among false measurements",
    scans=50,
    minutes=0.3,
    measure=_measure,
    rows=_rows,
    draw=_draw,
    grid="y",
    heading="Eight targets among false measurements",
    counts="runs",
)
