"""Targets that drive, stop, stand and start again."""

import numpy as np
import pytest

from lidar_core.fusion import FusionConfig, Measurements, run_batch

SECONDS, RUNS, ROWS = 0.05, 24, 400
STDS = np.array([0.3, 0.03, 0.3])


def speed(t):
    """4 s of 3 m/s, 1 s of braking, 4 s at rest, 1 s of speeding up."""
    phase = t % 10
    slower, faster = np.clip(5 - phase, 0, 1), np.clip(phase - 9, 0, 1)
    return 3 * np.maximum(slower, faster)


def targets(seed):
    """Measurements of a LiDAR and a radar in turn, and true places."""
    t = np.arange(ROWS) * SECONDS
    names = np.where(np.arange(ROWS) % 2 == 0, "lidar", "radar")
    made, truths = [], []
    for number in range(RUNS):
        rng = np.random.default_rng([seed, number])
        heading = rng.uniform(0, 2 * np.pi)
        along = np.array([np.cos(heading), np.sin(heading)])
        place = rng.uniform(-10, 10, 2) + np.cumsum(speed(t) * SECONDS)[:, None] * along
        far = np.hypot(*place.T)
        rate = speed(t) * (place @ along) / far
        values = np.stack([far, np.arctan2(place[:, 1], place[:, 0]), rate], axis=1)
        values += STDS * rng.normal(size=values.shape)
        lidar = place + 0.15 * rng.normal(size=place.shape)
        values[::2, :2] = lidar[::2]
        stamps = np.round(t * 1e9).astype(np.int64)
        made.append(Measurements.from_arrays(stamps, names, values))
        truths.append(place)
    return made, np.array(truths)


def scores(**options):
    """2-D error [m] and NEES/2 of the position, after the first second."""
    seen, truth = targets(1700)
    runs = run_batch(seen, FusionConfig(**options), threads=1)
    wrong = (np.array([one.states[:, :2] for one in runs]) - truth)[:, 20:]
    spread = np.array([one.covariances[:, :2, :2] for one in runs])[:, 20:]
    nees = np.einsum("rti,rtij,rtj->rt", wrong, np.linalg.inv(spread), wrong)
    return np.sqrt(np.square(wrong).sum(axis=2).mean()), nees.mean() / 2


@pytest.mark.parametrize("method", ["ekf", "ukf"])
def test_errors_of_targets_that_stop_are_what_covariances_say(method):
    error, nees = scores(method=method)
    assert error < 0.13
    assert 0.8 < nees < 1.25


def test_a_heading_says_too_much_about_targets_that_stop():
    """Why the default has a velocity: the same measurements with speed and heading."""
    assert scores(method="ukf", model="ctrv")[1] > 1.1 * scores(method="ukf")[1]


def test_sigma_points_far_away_do_not_follow_targets_that_stop():
    """What `sigma_spread` avoids: points all around the circle of headings."""
    error, nees = scores(method="ukf", model="ctrv", sigma_spread=None)
    assert error > 1.15 * scores(method="ukf", model="ctrv")[0]
    assert nees > 2


def test_a_mixture_is_at_least_as_good():
    error, _ = scores(method="imm", imm_models=("cv", "ct"), imm_quiet=0.1)
    assert error < scores()[0]
