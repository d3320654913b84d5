"""Ways that filters find in noisy draws of the first recording, for Figs. 7 to 9 of the paper."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_core.config import Config
from lidar_core.reproduce.common import BLUE, GREY, RED
from lidar_core.reproduce.fusion.contenders import BEST, EKF, corrected, ours, printed
from lidar_core.reproduce.fusion.laser_radar import (
    SAMPLE_1,
    Contender,
    course,
    draws_of,
    estimates,
    places,
    power_std,
)
from lidar_core.reproduce.types import Request, Row

PRINTED = "equations as printed"
MEASURED = "measured"
Ways = dict[str, NDArray[np.float64]]
"""Positions by who says them, (N, K, 2), one per draw and row [m]."""
STYLES: dict[str, dict[str, Any]] = {
    MEASURED: {"color": GREY, "ls": "none", "marker": ".", "ms": 3},
    "truth": {"color": "black", "lw": 1.2},
    PRINTED: {"color": RED, "lw": 0.8, "ls": ":"},
    EKF: {"color": RED, "lw": 1.0},
    BEST: {"color": BLUE, "lw": 1.2},
}
"""How each is drawn."""


def contenders() -> dict[str, Contender]:
    """The paper's equations as printed, the same corrected, and ours."""
    return {PRINTED: printed()[EKF], EKF: corrected()[EKF], BEST: ours()[BEST]}


def configs() -> dict[str, Config]:
    """Configurations of the filters, by name."""
    return {name: one.config for name, one in contenders().items()}


def truth() -> NDArray[np.float64]:
    """True positions (K, 2)."""
    return course(SAMPLE_1).truth.position


def ways(level: float, request: Request) -> Ways:
    """What was measured and what every filter makes of it, at a power of noise."""
    of = course(SAMPLE_1)
    draws = draws_of(of, level, request.scans, seed=request.seed)
    found = {MEASURED: np.array([places(values, of.is_lidar) for values in draws])}
    for name, one in contenders().items():
        runs = one.follow(of, draws, power_std(level), threads=request.threads)
        found[name] = np.array([estimates(run, of, one.form) for run in runs])
    return found


def rows(what: str, errors: dict[str, float]) -> list[Row]:
    """Errors of one kind: the filter in all modes, and no filter."""
    return [
        Row(f"{what}, filter", "m", None, errors[PRINTED], errors[BEST], errors[EKF]),
        Row(f"{what}, {MEASURED}", "m", None, errors[MEASURED], errors[MEASURED]),
    ]


def each(found: Ways, error: Any) -> dict[str, float]:
    """`error` of the differences (N, K, 2) to the truth, for everybody."""
    return {name: float(error(way - truth())) for name, way in found.items()}


def plane(differences: NDArray[np.float64]) -> float:
    """Mean over draws of the error in the plane [m]."""
    return float(np.sqrt(np.square(differences).sum(axis=2).mean(axis=1)).mean())


def draw_way(panel: Any, found: Ways, names: Sequence[str]) -> None:
    """Draw the first draw in the plane."""
    for name in names:
        panel.plot(*found[name][0].T, label=name, **STYLES[name])
    panel.plot(*truth().T, label="truth", **STYLES["truth"])
    panel.grid(visible=True)
