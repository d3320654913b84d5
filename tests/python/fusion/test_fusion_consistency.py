"""Errors of filters that know everything are as large as their covariances say, others' are not."""

from functools import cache

import numpy as np
import pytest

from lidar_core.evaluation import consistency
from lidar_core.fusion import FusionConfig
from lidar_core.reproduce.fusion.consistency import (
    METHODS,
    MIXTURE,
    WRONG,
    config,
    degrees_of,
    ensemble,
    values,
)
from lidar_core.reproduce.fusion.ensembles import SECONDS, STEPS, SWITCHING, draw_ensemble

RUNS = 500
GOAL = 0.85
"""Share of the steps whose mean over all runs has to be inside the 95 % band."""
kept = cache(ensemble)


def found(model: str, filters: FusionConfig):
    some = values(kept(model, RUNS, 0), filters, threads=2)
    assert some.shape == (RUNS, STEPS)
    return consistency(some, degrees=degrees_of(model))


@pytest.mark.ci_cases("cv-kf", "cv-ukf", "ct-ekf", "ctrv-drone-ekf")
@pytest.mark.parametrize(("model", "method"), [(a, b) for a in METHODS for b in METHODS[a]])
def test_a_filter_that_knows_everything_is_consistent(model, method):
    one = found(model, config(model, method))
    assert one.share_of_steps_inside >= GOAL
    assert one.mean / one.degrees == pytest.approx(1, abs=0.03)


@pytest.mark.ci_cases("cv-*", "ctrv-drone-*")
@pytest.mark.parametrize("wrong", WRONG)
@pytest.mark.parametrize("model", METHODS)
def test_a_filter_that_is_told_wrong_noise_fails(model, wrong):
    one = found(model, config(model, "ekf", WRONG[wrong]))
    assert one.share_of_steps_inside < 0.1


def test_a_mixture_is_nearly_consistent_where_targets_start_and_end_turns():
    one = found(SWITCHING, MIXTURE)
    assert 0.9 < one.mean / one.degrees < 1.5


@pytest.mark.parametrize("model", [*METHODS, SWITCHING])
def test_targets_move_by_their_speeds(model):
    states = draw_ensemble(model, 20, np.random.default_rng(3)).states
    if model == "ctrv-drone":
        return  # in the frame of a sensor that turns
    x, y, vx, vy = np.moveaxis(states[..., :4], -1, 0)
    if model.startswith("ctr"):
        vx, vy = vx * np.cos(vy), vx * np.sin(vy)
    for place, speed in ((x, vx), (y, vy)):
        middle = (speed[:, 1:] + speed[:, :-1]) / 2
        np.testing.assert_allclose(np.diff(place) / SECONDS, middle, atol=0.15)
