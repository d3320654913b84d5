"""`flying-consistency`: errors of tracks compared with their covariances.

Tracker only, one target and one measurement per step of 0.1 s, confirmed at once. The truth is
drawn from the filter's own model, or flies circles of constant speed and acceleration.
"""

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from lidar_core.evaluation import Consistency, consistency, nees
from lidar_core.flying import PointCloudTracker, TrackerConfig
from lidar_core.reproduce.common import BLUE, PALE
from lidar_core.reproduce.types import Item, Measured, Request, Row

Array: TypeAlias = NDArray[np.float64]

STEPS, STEP_NS, SECONDS = 60, 100_000_000, 0.1
AHEAD_NS = 100_000_000
"""Latency over which positions are predicted [ns]."""
CENTRE_STD = 0.02
"""Noise of a centre of the target, per axis [m]: what best mode measures."""
CIRCLES = ((1.0, 2.0), (2.0, 4.0), (4.0, 6.0), (8.0, 10.0))
"""Acceleration [m/s^2] and speed [m/s]."""
SUBSTEPS = 100
ALIVE = 0.9
"""Share of the runs that need a track for a step to count: survivors alone tell little."""
SETTLED = 15
"""Steps after which the errors on circles count."""
EMPTY = np.empty((0, 3))


def _measure(request: Request) -> Measured:
    configs = {"paper": TrackerConfig.paper(), "best": TrackerConfig()}
    runs, stated = request.scans, [stated_std(config) for config in configs.values()]
    own = [_own_model(config, request.seed, runs) for config in configs.values()]
    found = [consistency(values[:, counts(values)], degrees=9) for values in own]
    circles = [
        [_circle(config, request.seed, max(1, runs // 10), *circle) for circle in CIRCLES]
        for config in configs.values()
    ]
    request.advance(runs)
    return Measured(
        (found, own, circles),
        drawn=(found, own),
        scans=runs,
        note=f"{runs} runs of {STEPS} steps. Noise as each mode states it, {stated[0]:g} and"
        f" {stated[1]:.2g} m; on circles {CENTRE_STD} m. A step counts while {100 * ALIVE:g} % of"
        f" the runs have a track; steps inside the band: only where all {STEPS} count.",
        config=configs,
    )


def _own_model(config: TrackerConfig, seed: int, runs: int) -> Array:
    """NEES of all nine values of the state, (runs, steps); NaN where there is no track."""
    rng = np.random.default_rng([3, seed])
    noise = stated_std(config)
    truth = _draw_states(config, rng, runs)
    measured = truth[:, :, :3] + rng.normal(size=(runs, STEPS, 3)) * noise
    first = config.initial_std[0] if config.measurement == "paper" else noise
    measured[:, 0] = truth[:, 0, :3] + rng.normal(size=(runs, 3)) * first
    values = np.full((runs, STEPS), np.nan)
    for run in range(runs):
        mean, covariance, _ = _run_tracker(config, measured[run])
        known = np.isfinite(mean[:, 0])
        values[run, known] = nees(mean[known] - truth[run, known], covariance[known])
    return values


def counts(values: Array) -> NDArray[np.bool_]:
    """Return in which steps nearly all runs have a track, (steps,)."""
    return np.asarray((~np.isnan(values)).mean(axis=0) >= ALIVE, np.bool_)


def stated_std(config: TrackerConfig) -> float:
    """Standard deviation of a measurement per axis that the filter assumes [m]."""
    if config.measurement == "paper":
        return config.measurement_std
    is_centroid = config.measurement == "cluster"  # its own covariance comes on top
    return float(np.hypot(CENTRE_STD, config.measurement_std if is_centroid else 0.0))


def _draw_states(config: TrackerConfig, rng: np.random.Generator, runs: int) -> Array:
    """Draw states (runs, steps, 9) that follow the motion model of `config`."""
    spread = (0.0, *config.initial_std[1:])
    per_step = config.process_noise == "paper"
    count = 1 if per_step else SUBSTEPS
    dt = SECONDS / count
    time = config.acceleration_time
    keep = 1.0 if time is None else np.exp(-dt / time)
    scale = np.array(config.process_std) * (1.0 if per_step else np.sqrt(dt))
    r, v, a = (rng.normal(size=(runs, 3)) * one for one in spread)
    states = [np.concatenate([r, v, a], axis=1)]
    for step in range((STEPS - 1) * count):
        pushes = rng.normal(size=(3, runs, 3)) * scale[:, None, None]
        r = r + v * dt + a * dt**2 / 2 + pushes[0]
        v = v + a * dt + pushes[1]
        a = a * keep + pushes[2]
        if (step + 1) % count == 0:
            states.append(np.concatenate([r, v, a], axis=1))
    return np.stack(states, axis=1)


def _run_tracker(config: TrackerConfig, measured: Array) -> tuple[Array, Array, Array]:
    """State (steps, 9), covariance, and position predicted by `AHEAD_NS`; NaN without a track."""
    at_once = config.model_copy(
        update={"report_existence": None, "confirm_hits": 1, "confirm_window": 1}
    )
    tracker = PointCloudTracker(at_once)
    covariance = np.eye(3)[None] * CENTRE_STD**2
    mean = np.full((len(measured), 9), np.nan)
    spread = np.full((len(measured), 9, 9), np.nan)
    ahead = np.full((len(measured), 3), np.nan)
    for step, place in enumerate(measured):
        stamp = step * STEP_NS
        if config.measurement != "paper":
            tracker.new_detections(place[None], stamp, covariance=covariance)
        elif step == 0:
            tracker.new_detections(place[None], stamp)
        else:
            tracker.new_point_cloud(place[None], EMPTY, stamp)
        tracks = tracker.tracks_at(stamp)
        if 0 in tracks.id:
            mean[step] = np.concatenate(
                [tracks.position[0], tracks.velocity[0], tracks.acceleration[0]]
            )
            spread[step] = tracks.covariance[0]
            ahead[step] = tracker.tracks_at(stamp + AHEAD_NS).position[0]
    return mean, spread, ahead


def _circle(
    config: TrackerConfig, seed: int, runs: int, acceleration: float, speed: float
) -> list[float | None]:
    """Track targets on circles of given speed [m/s] and acceleration [m/s^2].

    Returns the mean errors of position [m], velocity [m/s] and predicted position [m], and the
    mean NEES / 6; None for each without a track.
    """
    rng = np.random.default_rng([4, seed])
    kept = []
    for _ in range(runs):
        angle = speed / (speed**2 / acceleration) * SECONDS * np.arange(STEPS + 1)
        turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        out = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1) @ turn.T
        along = np.stack([-np.sin(angle), np.cos(angle), 0 * angle], axis=1) @ turn.T
        truth = np.concatenate([out * speed**2 / acceleration, along * speed], axis=1)
        noisy = truth[:-1, :3] + rng.normal(size=(STEPS, 3)) * CENTRE_STD
        mean, covariance, ahead = _run_tracker(config, noisy)
        error, later = mean[:, :6] - truth[:-1], ahead - truth[1:, :3]
        values = np.stack(
            [
                np.linalg.norm(error[:, :3], axis=1),
                np.linalg.norm(error[:, 3:], axis=1),
                np.linalg.norm(later, axis=1),
                nees(error, covariance[:, :6, :6]) / 6,
            ]
        )
        kept.append(values[:, SETTLED:])
    table = np.concatenate(kept, axis=1)
    table = table[:, np.isfinite(table[0])]
    return table.mean(axis=1).tolist() if table.size else [None] * 4


def _rows(
    found: list[Consistency | None],
    own: list[Array],
    circles: list[list[list[float | None]]],
) -> list[Row]:
    steps = [int(counts(values).sum()) for values in own]
    lost = [float(np.isnan(values[:, -1]).mean()) for values in own]

    def of(name: str) -> list[float | None]:
        return [None if one is None else getattr(one, name) for one in found]

    mean = [None if one is None else one.mean / one.degrees for one in found]
    inside = [
        one if n == STEPS else None
        for one, n in zip(of("share_of_steps_inside"), steps, strict=True)
    ]
    return [
        Row("own model: steps that count", "1", None, *steps),
        Row("own model: steps inside the 95 % band", "1", None, *inside),
        Row("own model: single values inside their band", "1", None, *of("share_inside")),
        Row("own model: mean NEES / 9", "1", None, *mean),
        Row("own model: tracks lost", "1", None, *lost),
        *_circle_rows(circles),
    ]


def _circle_rows(circles: list[list[list[float | None]]]) -> list[Row]:
    names = (
        ("position error", "m"),
        ("velocity error", "m/s"),
        ("position error 100 ms ahead", "m"),
        ("NEES / 6", "1"),
    )
    return [
        Row(f"circles: {name}@{acceleration:g}m/s^2", unit, None, paper[place], best[place])
        for place, (name, unit) in enumerate(names)
        for (acceleration, _), paper, best in zip(CIRCLES, *circles, strict=True)
    ]


def _draw(figure: Any, found: list[Consistency | None], own: list[Array]) -> None:
    """Draw the mean NEES over the runs at every step, with its confidence band."""
    panels = figure.subplots(1, 2)
    for axes, values, one, name in zip(
        panels, own, found, ("paper mode", "best mode"), strict=True
    ):
        known = ~np.isnan(values)
        count = known.sum(axis=0)
        means = np.where(known, values, 0).sum(axis=0)[count > 0] / count[count > 0]
        axes.plot(SECONDS * np.flatnonzero(count), means, color=BLUE)
        if one is not None:
            axes.axhspan(*one.step_band, color=PALE, label="95 % band of the mean")
            axes.legend(loc="upper right")
        axes.set(title=name, xlabel="time [s]", ylim=(0, None))
    panels[0].set_ylabel("mean NEES of 9 numbers")


ITEM = Item(
    name="flying-consistency",
    title="errors of tracks against their covariances (NEES)",
    scans=500,
    minutes=1,
    measure=_measure,
    rows=_rows,
    draw=_draw,
    heading="NEES, truth from the filter's own model",
    counts="runs",
)
