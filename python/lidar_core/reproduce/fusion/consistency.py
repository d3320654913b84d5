"""`fusion-consistency`: errors against covariances, for filters with the true models."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_core.evaluation import consistency, nees
from lidar_core.fusion import FusionConfig, run_batch
from lidar_core.reproduce.common import BLUE, GREY, PALE, RED
from lidar_core.reproduce.fusion.ensembles import (
    SECONDS,
    SOJOURN,
    STEPS,
    SWITCHING,
    TRUE,
    Ensemble,
    draw_ensemble,
)
from lidar_core.reproduce.types import Item, Measured, Request, Row

SIGMA = ("ekf", "ukf", "ckf")
METHODS = {
    "cv": ("kf", *SIGMA),
    "ca": ("kf", *SIGMA),
    "ct": SIGMA,
    "ctrv": SIGMA,
    "ctra": SIGMA,
    "ctrv-drone": SIGMA,
}
RIGHT = "right"
WRONG: Mapping[str, Mapping[str, float]] = {
    "half the process noise": {"process": 0.5},
    "twice the process noise": {"process": 2.0},
    "sensors taken for 20 % better": {"sensors": 0.8},
    "sensors taken for 20 % worse": {"sensors": 1.2},
}
"""Factors of standard deviations that a filter is told."""
PROCESS = ("acceleration_noise", "jerk_noise", "turn_noise")
SENSORS = ("lidar_std", "radar_std")
Array = NDArray[np.float64]


def config(model: str, method: str, factors: Mapping[str, float] | None = None) -> FusionConfig:
    """Return a filter with the true motion and noise, apart from `factors`."""
    told: dict[str, Any] = TRUE | {"model": model, "method": method, "gyro": "exact"}
    factors = factors or {}
    told |= {name: factors.get("process", 1.0) * told[name] for name in PROCESS}
    told |= {name: tuple(factors.get("sensors", 1.0) * np.array(told[name])) for name in SENSORS}
    return FusionConfig.load(told)


MIXTURE = config("ctrv", "imm").model_copy(
    update={"imm_models": ("cv", "ct"), "imm_sojourn": SOJOURN}
)
"""A filter of targets that start and end turns."""


def ensemble(model: str, runs: int, seed: int) -> Ensemble:
    """Draw targets that move by `model`; all filters of the model get the same ones."""
    number = [*METHODS, SWITCHING].index(model)
    return draw_ensemble(model, runs, np.random.default_rng([20231121, seed, number]))


def values(some: Ensemble, filters: FusionConfig, *, threads: int) -> Array:
    """NEES of the states, (runs, steps); for `imm` only of position and velocity."""
    count = 4 if filters.method == "imm" else some.states.shape[2]
    found = []
    for run, truth in zip(
        run_batch(some.targets, filters, threads=threads), some.states, strict=True
    ):
        wrong = run.states[some.rows, :count] - truth[:, :count]
        if filters.model.startswith("ctr") and filters.method != "imm":
            wrong[:, 3] = (wrong[:, 3] + np.pi) % (2 * np.pi) - np.pi
        found.append(nees(wrong, run.covariances[some.rows, :count, :count]))
    return np.array(found)


def _measure(request: Request) -> Measured:
    found: dict[tuple[str, str, str], Array] = {}
    configs: dict[str, FusionConfig] = {}

    def follow(
        some: Ensemble, key: tuple[str, str, str], one: FusionConfig, count: int = 6
    ) -> None:
        found[key] = values(some, one, threads=request.threads)
        configs[", ".join(key)] = one

    for model, methods in METHODS.items():
        some = ensemble(model, request.scans, request.seed)
        for method in methods:
            follow(some, (model, method, RIGHT), config(model, method))
        for name, factors in WRONG.items():
            follow(some, (model, "ekf", name), config(model, "ekf", factors))
    some = ensemble(SWITCHING, request.scans, request.seed)
    follow(some, (SWITCHING, "imm", RIGHT), MIXTURE)
    request.advance(request.scans)
    return Measured(
        (found,),
        scans=request.scans,
        note=f"{request.scans} targets of each model, LiDAR and radar in turn over {STEPS} steps"
        f" of {SECONDS:g} s. Goal: at least 0.85 of the steps inside, where noise is known. The"
        " mixture follows targets that start and end turns, which none of its models does.",
        config=configs,
    )


def _rows(found: Mapping[tuple[str, str, str], Array]) -> list[Row]:
    rows = []
    for (model, method, name), of in found.items():
        degrees = degrees_of(model)
        one = consistency(of, degrees=degrees)
        what = f"{model}, {method}" + ("" if name == RIGHT else f", {name}")
        if one is not None:
            share, mean = one.share_of_steps_inside, one.mean / degrees
            rows += [
                Row(f"{what}: steps inside the band", "1", None, None, share),
                Row(f"{what}: mean NEES / {degrees}", "1", None, None, mean),
            ]
    return rows


def degrees_of(model: str) -> int:
    """Number of state components whose errors `values` uses."""
    return {"cv": 4, "ca": 6, "ctra": 6, SWITCHING: 4}.get(model, 5)


def _draw(figure: Any, found: Mapping[tuple[str, str, str], Array]) -> None:
    """Draw the mean NEES of EKF-CTRV at every step, with right and wrong noise, and the band."""
    panel = figure.subplots()
    degrees, seconds = degrees_of("ctrv"), np.arange(STEPS) * SECONDS
    for name, colour in ((RIGHT, BLUE), *zip(WRONG, (RED, GREY, RED, GREY), strict=True)):
        line = "--" if "sensors" in name else "-"
        mean = found["ctrv", "ekf", name].mean(axis=0) / degrees
        panel.plot(seconds, mean, line, color=colour, lw=1, label=name)
    one = consistency(found["ctrv", "ekf", RIGHT], degrees=degrees)
    if one is not None:
        low, high = one.step_band
        panel.axhspan(low / degrees, high / degrees, color=PALE, label="95 % band")
    panel.set(xlabel="time [s]", ylabel=f"mean NEES / {degrees}", yscale="log")
    panel.legend(fontsize=8)


ITEM = Item(
    name="fusion-consistency",
    title="LiDAR and radar: errors of every filter against its covariances",
    scans=500,
    minutes=1,
    measure=_measure,
    rows=_rows,
    draw=_draw,
    grid="y",
    heading="EKF-CTRV: squared errors against what covariances say",
    counts="targets",
)
