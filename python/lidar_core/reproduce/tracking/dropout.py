"""`tracking-dropout`: turning targets that are not measured for 5 s."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_core.fusion import FusionConfig, Measurements, run_batch
from lidar_core.fusion.recordings.reading import TargetTruth
from lidar_core.reproduce.common import BLUE, GREY
from lidar_core.reproduce.fusion.contenders import FIXED, REFERENCE
from lidar_core.reproduce.fusion.laser_radar import in_turn, measured
from lidar_core.reproduce.types import Item, Measured, Request, Row

STEP_NS, STEPS = 50_000_000, 500
UNSEEN = slice(201, 300)
"""Measurements that are lost: those of 5 s."""
BACK = 250
"""Where targets that turn back do so: in the middle of the dropout."""
PASSING = 5
"""Measurements of the quarter of a second after the first fix."""
CASES = {
    "3 m/s, goes on turning": (3.0, 0.6, False),
    "3 m/s, turns back": (3.0, 0.6, True),
    "10 m/s, goes on turning": (10.0, 0.6, False),
    "10 m/s, turns back": (10.0, 0.6, True),
    "20 m/s, turns back": (20.0, 1.0, True),
}
"""Speed [m/s], turn rate [rad/s], whether it changes sides while nobody looks."""
NAMES = ("first fix", "next 0.25 s")


def way(speed: float, rate: float, *, turns_back: bool, heading: float) -> TargetTruth:
    """Make a target on an arc, or on an S if it `turns_back`, about 20 m from the sensor."""
    rates = np.full(STEPS, rate)
    if turns_back:
        rates[BACK:] = -rate
    headings = heading + np.concatenate([[0.0], np.cumsum(rates[:-1])]) * STEP_NS * 1e-9
    velocity = speed * np.stack([np.cos(headings), np.sin(headings)], axis=1)
    steps = velocity[:-1] * STEP_NS * 1e-9
    place = np.array([20.0, 5.0]) + np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
    return TargetTruth(np.arange(STEPS) * STEP_NS, place, velocity, None, None)


def _measure(request: Request) -> Measured:
    found = {}
    kept = np.ones(STEPS, np.bool_)
    kept[UNSEEN] = False
    for number, (name, (speed, rate, turns_back)) in enumerate(CASES.items()):
        rng = np.random.default_rng([20260603, request.seed, number])
        truths, targets = [], []
        for _ in range(request.scans):
            turn = rate * rng.uniform(0.7, 1.3) * rng.choice([-1.0, 1.0])
            truth = way(speed, turn, turns_back=turns_back, heading=rng.uniform(-np.pi, np.pi))
            values, sensors = (
                measured(truth, FIXED, rng),
                np.where(in_turn(STEPS), "lidar", "radar"),
            )
            usable = kept & (in_turn(STEPS) | (values[:, 0] > 0))
            targets.append(
                Measurements.from_arrays(truth.stamps_ns[usable], sensors[usable], values[usable])
            )
            truths.append((truth.position[usable], int(usable[: UNSEEN.start].sum())))
        errors = []
        for config in (FusionConfig.load(REFERENCE), FusionConfig()):
            runs = run_batch(targets, config, threads=request.threads)
            far = [
                np.hypot(
                    *(one.states[first : first + PASSING, :2] - place[first : first + PASSING]).T
                )
                for one, (place, first) in zip(runs, truths, strict=True)
            ]
            errors.append(np.sqrt([np.square(far)[:, 0].mean(), np.square(far).mean()]))
        found[name] = np.array(errors)
    request.advance(request.scans)
    return Measured(
        (found,),
        scans=request.scans,
        note="RMS distance from the truth after 5 s without a measurement: of the default filter,"
        " over that of the same filter that believes its noise and every measurement. Goal for"
        " the first fix: at most 2.",
    )


def _rows(found: Mapping[str, NDArray[np.float64]]) -> list[Row]:
    rows = []
    for name, (possible, ours) in found.items():
        for what, least, got in zip(NAMES, possible, ours, strict=True):
            rows += [
                Row(f"{name}: {what}", "m", None, None, float(got)),
                Row(f"{name}: {what}, over that without gate", "1", None, None, float(got / least)),
            ]
    return rows


def _draw(figure: Any, found: Mapping[str, NDArray[np.float64]]) -> None:
    """Draw the RMS errors of the first fix after the gap, one bar per case and filter."""
    panel, spots = figure.subplots(), np.arange(len(found))
    for offset, (name, colour) in enumerate({"without gate": GREY, "default": BLUE}.items()):
        heights = [errors[offset, 0] for errors in found.values()]
        panel.barh(spots + 0.4 * offset, heights, height=0.4, color=colour, label=name)
    panel.set_yticks(spots + 0.2, list(found), fontsize=8)
    panel.invert_yaxis()
    panel.set(xlabel="RMS error of the first fix [m]")
    panel.legend()


ITEM = Item(
    name="tracking-dropout",
    title="LiDAR and radar: turning targets that nobody sees for 5 s",
    scans=200,
    minutes=0.3,
    measure=_measure,
    rows=_rows,
    draw=_draw,
    grid="x",
    heading="First fix after 5 s without a measurement",
    counts="targets",
)
