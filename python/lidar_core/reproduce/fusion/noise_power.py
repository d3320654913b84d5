"""`fusion-fig10`, `fusion-fig11`: error over the power of the noise, and its lower bound."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from lidar_core.fusion import FusionConfig
from lidar_core.reproduce.common import BLUE, GREY, RED, TITLES
from lidar_core.reproduce.fusion.bounds import position_bound
from lidar_core.reproduce.fusion.contenders import (
    BEST,
    EKF,
    LINEAR,
    LINEAR_LIDAR,
    SAMPLE_1_NOISE,
    corrected,
    ours,
    printed,
)
from lidar_core.reproduce.fusion.laser_radar import (
    LEVELS,
    SAMPLE_1,
    Contender,
    Course,
    course,
    draws_of,
    places,
    plane,
    polar_covariances,
    power_std,
)
from lidar_core.reproduce.types import Item, Measured, Request, Row

RAW, BOUND = "measured positions", "posterior bound"
CLEAN_NOISE = 12.0
"""Acceleration that the bound expects: the true speed jumps [m/s^2]."""
LINEAR_FILTERS = (LINEAR, LINEAR_LIDAR)
"""Those of Fig. 11."""
Curves = dict[str, list[float]]
"""Mean error in the plane per level [m]."""


def _measure(request: Request) -> Measured:
    of = course(SAMPLE_1)
    filters = {"paper": printed(), "corrected": corrected(), "best": ours()}
    modes = {mode: sweep(of, some, request, share=1 / 3) for mode, some in filters.items()}
    raw, bound = _raw(of, request), [_bound(of, level) for level in LEVELS]
    return Measured(
        (modes, raw, bound),
        scans=request.scans,
        note="Mean over draws of the error in the plane. Paper mode: equations as printed; paper"
        " mode and equations corrected: fixed noise, as the paper and the courses have it; best"
        " mode: noise known. The paper shows a curve without numbers."
        " The bound holds for speeds that jump all the time, as those of the file sometimes do:"
        " a filter that expects less may be below it.",
        config=_configs(filters),
    )


def _measure_linear(request: Request) -> Measured:
    filters = {
        mode: {name: some[name] for name in LINEAR_FILTERS}
        for mode, some in (("paper", printed()), ("best", ours()))
    }
    return Measured(
        tuple(sweep(course(SAMPLE_1), some, request) for some in filters.values()),
        scans=request.scans,
        note="Mean over draws of the error in the plane. Radar as a position, without its range"
        " rate. Paper mode: fixed noise; best mode: noise known. The paper shows a curve without"
        " numbers.",
        config=_configs(filters),
    )


def _configs(filters: Mapping[str, Mapping[str, Contender]]) -> dict[str, FusionConfig]:
    return {
        f"{mode} {name}": one.config for mode, some in filters.items() for name, one in some.items()
    }


def sweep(
    of: Course, filters: Mapping[str, Contender], request: Request, *, share: float = 0.5
) -> Curves:
    """Mean errors of several filters at all noise levels [m], by filter.

    When it is done, it reports `share` of the progress of the item.
    """
    curves: Curves = {name: [] for name in filters}
    for level in LEVELS:
        draws = draws_of(of, level, request.scans, seed=request.seed)
        for name, one in filters.items():
            rmse = one.rmse(of, draws, power_std(level), threads=request.threads)
            curves[name].append(plane(rmse))
    request.advance(int(request.scans * share))
    return curves


def _rows(modes: Mapping[str, Curves], raw: list[float], bound: list[float]) -> list[Row]:
    return [
        *(Row(f"{RAW}@{level}dBW", "m", None, *[raw[k]] * 2) for k, level in enumerate(LEVELS)),
        *rows_of(modes["paper"], modes["best"], modes["corrected"]),
        *(Row(f"{BOUND}@{level}dBW", "m", None, None, bound[k]) for k, level in enumerate(LEVELS)),
    ]


def rows_of(paper: Curves, best: Curves, right: Curves | None = None) -> list[Row]:
    """Return one row per filter and level; `right` are the values of corrected equations."""
    nothing, right = [None] * len(LEVELS), right or {}
    return [
        Row(
            f"{name}@{level}dBW",
            "m",
            None,
            paper.get(name, nothing)[k],
            best.get(name, nothing)[k],
            right.get(name, nothing)[k],
        )
        for name in best  # has all that the others have
        for k, level in enumerate(LEVELS)
    ]


def _raw(of: Course, request: Request) -> list[float]:
    """Errors of the measured positions of both sensors at every noise level [m]."""
    found = []
    for level in LEVELS:
        draws = draws_of(of, level, request.scans, seed=request.seed)
        wrong = [places(values, of.is_lidar) - of.truth.position for values in draws]
        found.append(plane(np.sqrt(np.square(wrong).mean(axis=1))))
    return found


def _bound(of: Course, level: float) -> float:
    noise = polar_covariances(of.is_lidar, of.values, SAMPLE_1_NOISE, power_std(level))
    rows = [
        one[:2, :2] if is_lidar else one
        for one, is_lidar in zip(noise, of.is_lidar.tolist(), strict=True)
    ]
    stamps = of.truth.stamps_ns
    bound = position_bound(
        of.truth.position,
        of.truth.velocity,
        (stamps - stamps[0]) * 1e-9,
        rows,
        acceleration_noise=CLEAN_NOISE,
    )
    return float(np.hypot(*bound))


def _draw(figure: Any, modes: Mapping[str, Curves], raw: list[float], bound: list[float]) -> None:
    """Draw one panel per mode, with the axes of the paper."""
    panels = figure.subplots(1, len(modes), sharey=True)
    for panel, (mode, curves) in zip(panels, modes.items(), strict=True):
        panel.plot(LEVELS, raw, color="black", ls=":", label=RAW)
        for name, curve in curves.items():
            style = {"lw": 2.4} if name in (LINEAR, EKF, BEST) else {"lw": 1.0}
            panel.plot(LEVELS, curve, marker=".", label=name, **style)
        panel.set(xlabel="power [dBW]", title=TITLES[mode], yscale="log")
    panels[-1].plot(LEVELS, bound, color="black", label=BOUND)
    panels[0].set_ylabel("RMSE in the plane [m]")
    for panel in panels:
        panel.legend(fontsize=8)


def _draw_linear(figure: Any, paper: Curves, best: Curves) -> None:
    panel = figure.subplots()
    for curves, mode, colour in ((paper, "paper mode", RED), (best, "best mode", BLUE)):
        for name, line in zip(LINEAR_FILTERS, ("-", "--"), strict=True):
            panel.plot(LEVELS, curves[name], line, color=colour, label=f"{name}, {mode}")
    panel.axhline(0.21, color=GREY, ls=":", label="0.21 m, paper")
    panel.set(xlabel="power [dBW]", ylabel="RMSE in the plane [m]", yscale="log")
    panel.legend()


FIG10 = Item(
    name="fusion-fig10",
    title="LiDAR and radar: error over added noise, all filters, posterior bound (Fig. 10)",
    scans=100,
    minutes=3,
    measure=_measure,
    rows=_rows,
    draw=_draw,
    heading="Error over the power of the noise",
    counts="draws",
    data=(SAMPLE_1,),
)
FIG11 = Item(
    name="fusion-fig11",
    title="LiDAR and radar: error of the linear filter over added noise (Fig. 11)",
    scans=100,
    minutes=1,
    measure=_measure_linear,
    rows=rows_of,
    draw=_draw_linear,
    heading="Linear Kalman filter",
    counts="draws",
    data=(SAMPLE_1,),
)
