"""Scenes of LiDAR and radar whose results are kept: filters, smoothers, many targets, noise."""

from collections.abc import Callable
from functools import partial

import numpy as np

from golden.digest import Record
from lidar_core import estimation
from lidar_core.fusion import (
    FusionConfig,
    Measurement,
    Measurements,
    MultiTargetConfig,
    MultiTargetTracker,
    PublishedModel,
    TargetFilter,
    fit_noise,
    run,
    run_batch,
    smooth,
)

SEED = 18
STEP_NS = 50_000_000
FILTERS = {
    "kf": ("cv", "ca"),
    "ekf": ("cv", "ca", "ct", "ctrv", "ctra", "ctrv-drone", "paper"),
    "ukf": ("cv", "ca", "ct", "ctrv", "ctra", "ctrv-drone"),
    "ckf": ("cv", "ca", "ct", "ctrv", "ctra", "ctrv-drone"),
    "imm": ("cv",),
}
"""Models by method."""
BY_NUMPY = frozenset({"velocity"})
"""Fields that sines and cosines of numpy go into, whose last bits differ among CPUs."""


def way(rows, rate=0.3, speed=1.5):
    """Places, velocities of a target on a curve, rounded since sines differ among CPUs."""
    t = np.arange(rows) * STEP_NS * 1e-9
    heading = 0.3 + rate * t
    place = np.stack([4 + speed / rate * np.sin(heading), 3 - speed / rate * np.cos(heading)], 1)
    velocity = speed * np.stack([np.cos(heading), np.sin(heading)], axis=1)
    return np.round(place, 9), np.round(velocity, 9)


def measured(rows=80, *, gyro=False, poses=False, seed=SEED, rate=0.3):
    """LiDAR and radar in turn, some measurements far off, some doubled, some without a value."""
    rng = np.random.default_rng(seed)
    place, velocity = way(rows, rate)
    found = []
    for k in range(rows):
        stamp = k * STEP_NS
        if poses and k % 4 == 0:
            pose = [0.01 * k, 0.002 * k, 0.003 * k]
            found.append(Measurement(stamp, "pose", np.round(pose, 9), np.diag([1e-4, 1e-4, 1e-6])))
        if gyro:
            found.append(Measurement(stamp, "gyro", np.round([0.05 + rng.normal(0, 0.01)], 9)))
        if k % 2:
            distance = np.hypot(*place[k])
            bearing = np.arctan2(*place[k][::-1])
            polar = np.array([distance, bearing, place[k] @ velocity[k] / distance])
            polar = np.round(polar + rng.normal(size=3) * [0.3, 0.03, 0.3], 9)
            found.append(Measurement(stamp, "radar", polar))
        else:
            at = np.round(place[k] + rng.normal(size=2) * (3.0 if k in (30, 44) else 0.15), 9)
            noise = np.array([[0.02, 0.005], [0.005, 0.03]]) if k % 3 == 0 else None
            found.append(Measurement(stamp, "lidar", at, noise))
    found.append(Measurement(rows * STEP_NS, "lidar", [np.nan, 1.0]))
    return [*found, *found[-12:-10]]


def _add_inputs(record, measurements):
    for one in measurements:
        noise = one.covariance
        record.add("inputs", {"stamp": one.stamp_ns, "sensor": one.sensor, "values": one.values})
        record.add("inputs/covariance", noise)


# One target


def _filtered(record, threads, method, model):
    """A filter over a recording, step by step with late measurements, looking back, in batches."""
    config = FusionConfig(model=model, method=method)
    if model == "paper":
        config = FusionConfig.paper()
    measurements = measured(gyro=model in ("ctrv-drone", "paper"))
    _add_inputs(record, measurements)
    record.add("run", run(measurements, config))
    one = TargetFilter(config)
    order = list(range(len(measurements)))
    order[20:26] = [24, 21, 23, 20, 25, 22]
    for k in order:
        record.add("step", _step(one.step(measurements[k])))
        found = one.state_at(measurements[k].stamp_ns + 70_000_000) or (None, None)
        record.add("state", dict(zip(("mean", "covariance"), found, strict=True)))
    batch = [Measurements(measured(40, gyro=True, seed=SEED + k)) for k in range(3)]
    for each in run_batch(batch, config, threads=threads):
        record.add("batch", each)
    if model != "paper" and method != "imm":
        record.add("smooth", smooth(measurements, config))
        record.add("smooth/lagged", smooth(measurements, config, lag=0.3))


def _step(step):
    names = ("stamp_ns", "outcome", "accepted", "state", "covariance", "innovation", "nis")
    return {name: getattr(step, name) for name in names}


OPTIONS = {
    "imm of three": {"method": "imm", "imm_models": ("cv", "ctrv", "ca"), "imm_sojourn": 1.0},
    "imm of all": {"method": "imm", "imm_models": ("cv", "ca", "ct", "ctrv", "ctra")},
    "discrete noise": {"process": "discrete", "start_rows": 1, "start_speed": "zero"},
    "carried points": {"method": "ukf", "sigma_points": "carried", "sigma_spread": 3.0},
    "gyro measured": {"model": "ctrv-drone", "gyro": "measurement", "lever_arm": (0.3, -0.1)},
    "no gyro": {"model": "ctrv-drone", "gyro": "none", "method": "ukf"},
    "uncertain platform": {"pose_std": (0.05, 0.05, 0.02), "lever_arm": (0.2, 0.1)},
    "tight gate": {"gate_probability": 0.6, "loss_ratio": 1.5},
}


def _with_options(record, _threads, name):
    """Choices of the configuration, with poses of a platform that moves."""
    config = FusionConfig(**OPTIONS[name])
    measurements = measured(gyro=True, poses=True)
    _add_inputs(record, measurements)
    record.add("run", run(measurements, config))


def _published(record, _threads):
    """The model of the paper, in all readings of it."""
    measurements = [
        Measurement(one.stamp_ns, "radar", [*one.values, 1.5, 0.4])
        if one.sensor == "radar"
        else one
        for one in measured(gyro=True)
    ]
    _add_inputs(record, measurements)
    for reading in "abcd":
        for alpha in ("literal", "fixed"):
            for prediction in ("motion", "matrix"):
                chosen = PublishedModel(
                    reading=reading,
                    alpha=alpha,
                    prediction=prediction,
                    straight_y=alpha,
                    platform_column="literal" if reading in "ab" else "zero",
                    speed=0.5,
                    elevation=0.1,
                )
                config = FusionConfig.paper().model_copy(update={"published": chosen})
                record.add(f"run/{reading}", run(measurements, config))


def _noise(record, _threads):
    """Noise by maximum likelihood."""
    measurements = measured(240)
    _add_inputs(record, measurements)
    for model in ("cv", "ctrv"):
        found = fit_noise([Measurements(measurements)], FusionConfig(model=model))
        record.add(f"noise/{model}", found.model_dump(include=NOISE))
    record.add("chi2", [estimation.chi2_quantile(0.99, degrees=k) for k in range(1, 7)])


NOISE = {"acceleration_noise", "jerk_noise", "turn_noise", "lidar_std", "radar_std"}


# Many targets


def _many(record, _threads, association, model, method):
    """Targets that come and go, clutter, two scanners, some scans late."""
    target = FusionConfig(model=model, method=method, buffer_time=0.6)
    config = MultiTargetConfig(target=target, association=association, clutter=(0.01, 0.01))
    tracker = MultiTargetTracker(config)
    rng = np.random.default_rng(SEED)
    start, velocity = rng.uniform(-8, 8, (5, 2)), rng.uniform(-2, 2, (5, 2))
    for k in range(50):
        stamp = (k - 3 * (k % 7 == 5)) * 100_000_000 + k
        alive = (np.arange(5) < 3) | ((k > 10) & (k < 35))
        places = (start + velocity * stamp * 1e-9)[alive & (rng.random(5) < 0.9)]
        places = np.vstack([places, rng.uniform(-12, 12, (int(rng.integers(0, 3)), 2))])
        places = np.round(places + rng.normal(0, 0.15, places.shape), 9)
        if k % 2:
            polar = np.column_stack(
                [np.hypot(*places.T), np.arctan2(*places.T[::-1]), rng.normal(0, 1, len(places))]
            )
            scan = [Measurement(stamp, "radar", row) for row in np.round(polar, 9)]
        else:
            scan = [Measurement(stamp, "lidar", row) for row in places]
        _add_inputs(record, scan)
        record.add("scan", tracker.process(stamp, scan, source="left" if k % 2 else "right"))
        after = stamp + 40_000_000
        record.add("tracks", tracker.tracks_at(after), skip=BY_NUMPY)
        record.add("all", tracker.tracks_at(after, confirmed=False), skip=BY_NUMPY)


SCENES: dict[str, Callable[[Record, int], None]] = {
    f"{method}, {model}": partial(_filtered, method=method, model=model)
    for method, models in FILTERS.items()
    for model in models
}
SCENES |= {f"options, {name}": partial(_with_options, name=name) for name in OPTIONS}
SCENES |= {
    f"many, {association}, {method}, {model}": partial(
        _many, association=association, method=method, model=model
    )
    for association in ("integrated", "nearest", "joint")
    for method, model in (("ekf", "cv"), ("ukf", "ctrv"), ("imm", "cv"))
}
SCENES |= {"published model": _published, "noise": _noise}
