"""`fusion-fig7` to `fusion-fig9`: filtered paths in noisy draws of the first recording."""

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_core.config import Config
from lidar_core.reproduce.common import BLUE, GREY, RED
from lidar_core.reproduce.fusion.contenders import BEST, EKF, corrected, ours, printed
from lidar_core.reproduce.fusion.laser_radar import (
    PAPER_LEVEL,
    SAMPLE_1,
    Contender,
    course,
    draws_of,
    estimates,
    places,
    power_std,
)
from lidar_core.reproduce.types import Item, Measured, Request, Row

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


ZOOM = ((4.0, 7.0), (-13.0, -7.0))
"""Axes of Fig. 8: x and y [m]."""
LEVELS = {16: -16.0, 8: -8.0, 0: 0.0}
"""The labels of Fig. 9 [dB], and the power that its axes fit [dBW]."""


def contenders() -> dict[str, Contender]:
    """Return the filters by name: the paper's as printed, the same corrected, and ours."""
    return {PRINTED: printed()[EKF], EKF: corrected()[EKF], BEST: ours()[BEST]}


def configs() -> dict[str, Config]:
    """Configurations of the filters, by name."""
    return {name: one.config for name, one in contenders().items()}


def truth() -> NDArray[np.float64]:
    """True positions (K, 2) [m] of the first recording."""
    return course(SAMPLE_1).truth.position


def ways(level: float, request: Request) -> Ways:
    """Return the measurements and the outputs of all filters at one power of noise."""
    of = course(SAMPLE_1)
    draws = draws_of(of, level, request.scans, seed=request.seed)
    found = {MEASURED: np.array([places(values, of.is_lidar) for values in draws])}
    for name, one in contenders().items():
        runs = one.follow(of, draws, power_std(level), threads=request.threads)
        found[name] = np.array([estimates(run, of, one.form) for run in runs])
    return found


def rows(what: str, errors: dict[str, float]) -> list[Row]:
    """Rows of one kind of error: of the filter in all modes, and of the raw measurements."""
    return [
        Row(f"{what}, filter", "m", None, errors[PRINTED], errors[BEST], errors[EKF]),
        Row(f"{what}, {MEASURED}", "m", None, errors[MEASURED], errors[MEASURED]),
    ]


def plane_errors(found: Ways) -> dict[str, float]:
    """Mean position error in the plane [m] of every filter and of the measurements, by name."""
    return {name: plane(way - truth()) for name, way in found.items()}


def plane(differences: NDArray[np.float64]) -> float:
    """Mean over draws of the error in the plane [m]."""
    return float(np.sqrt(np.square(differences).sum(axis=2).mean(axis=1)).mean())


def draw_way(panel: Any, found: Ways, names: Sequence[str]) -> None:
    """Plot the named paths of the first noisy draw in the plane."""
    for name in names:
        panel.plot(*found[name][0].T, label=name, **STYLES[name])
    panel.plot(*truth().T, label="truth", **STYLES["truth"])


def _measure(request: Request, *, shows: str) -> Measured:
    found = ways(PAPER_LEVEL, request)
    request.advance(request.scans)
    return Measured(
        (found,),
        scans=request.scans,
        note=f"White noise of {PAPER_LEVEL:g} dBW; the paper does not say how much it added, and"
        f" shows {shows} without numbers.",
        config=configs(),
    )


def _measure_labels(request: Request) -> Measured:
    found = {label: ways(level, request) for label, level in LEVELS.items()}
    request.advance(request.scans)
    return Measured(
        (found,),
        scans=request.scans,
        note="The paper's labels of 16, 8 and 0 dB are read as noise of -16, -8 and 0 dBW: that"
        " fits its axes. It shows positions without numbers.",
        config=configs(),
    )


def _rows_of_axes(found: Ways) -> list[Row]:
    table = []
    for axis, name in enumerate("xy"):
        wrong = {who: way[..., axis] - truth()[:, axis] for who, way in found.items()}
        errors = {
            who: float(np.sqrt(np.square(one).mean(axis=1)).mean()) for who, one in wrong.items()
        }
        table += rows(f"RMSE of {name}", errors)
    return table


def _rows_of_turn(found: Ways) -> list[Row]:
    low, high = np.transpose(ZOOM)
    is_inside = ((truth() >= low) & (truth() <= high)).all(axis=1)
    turn = {name: way[:, is_inside] - truth()[is_inside] for name, way in found.items()}
    largest = {
        name: float(np.hypot(wrong[..., 0], wrong[..., 1]).max(axis=1).mean())
        for name, wrong in turn.items()
    }
    return [
        *rows("2-D RMSE in the figure", {name: plane(wrong) for name, wrong in turn.items()}),
        *rows("2-D RMSE of the whole way", plane_errors(found)),
        *rows("largest error in the figure", largest),
    ]


def _rows_of_labels(found: Mapping[int, Ways]) -> list[Row]:
    return [
        row
        for label, one in found.items()
        for row in rows(f"2-D RMSE, label {label} dB", plane_errors(one))
    ]


def _draw_axes(figure: Any, found: Ways) -> None:
    panels = figure.subplots(2, 1, sharex=True)
    stamps = course(SAMPLE_1).truth.stamps_ns
    seconds = (stamps - stamps[0]) * 1e-9
    for axis, (panel, name) in enumerate(zip(panels, "xy", strict=True)):
        for who, way in found.items():
            panel.plot(seconds, way[0, :, axis], label=who, **STYLES[who])
        panel.plot(seconds, truth()[:, axis], label="truth", **STYLES["truth"])
        panel.set_ylabel(f"{name} [m]")
    panels[1].set_xlabel("time [s]")
    panels[0].legend(fontsize=8, ncols=3)


def _draw_turn(figure: Any, found: Ways) -> None:
    panel = figure.subplots()
    draw_way(panel, found, [name for name in STYLES if name in found and name != MEASURED])
    panel.set(xlabel="x [m]", ylabel="y [m]", xlim=ZOOM[0], ylim=(ZOOM[1][0] - 0.7, ZOOM[1][1]))
    panel.legend()


def _draw_labels(figure: Any, found: Mapping[int, Ways]) -> None:
    panels = figure.subplots(1, len(found), sharex=True, sharey=True)
    for panel, (label, one) in zip(panels, found.items(), strict=True):
        draw_way(panel, one, (MEASURED, BEST))
        panel.set(xlabel="x [m]", title=f"label {label} dB", xlim=(2, 13), ylim=(-16, 4))
    panels[0].set_ylabel("y [m]")
    panels[0].legend(fontsize=8)


FIG7 = Item(
    name="fusion-fig7",
    title="LiDAR and radar: x and y over time, with added noise (Fig. 7)",
    scans=20,
    minutes=0.1,
    measure=partial(_measure, shows="curves"),
    rows=_rows_of_axes,
    draw=_draw_axes,
    heading="Response to noisy measurements",
    counts="draws",
    data=(SAMPLE_1,),
)
FIG8 = Item(
    name="fusion-fig8",
    title="LiDAR and radar: a change of direction (Fig. 8)",
    scans=20,
    minutes=0.1,
    measure=partial(_measure, shows="a way"),
    rows=_rows_of_turn,
    draw=_draw_turn,
    heading="A change of direction",
    counts="draws",
    data=(SAMPLE_1,),
)
FIG9 = Item(
    name="fusion-fig9",
    title="LiDAR and radar: positions with 16, 8 and 0 dB of noise (Fig. 9)",
    scans=20,
    minutes=0.2,
    measure=_measure_labels,
    rows=_rows_of_labels,
    draw=_draw_labels,
    heading="Positions with noise",
    counts="draws",
    data=(SAMPLE_1,),
)
