"""Gyros as they are delivered: biased, late, and read at single times."""

import numpy as np
import pytest

from lidar_core.errors import ConfigError
from lidar_core.fusion import FusionConfig, Measurement, TargetFilter, run
from lidar_core.fusion.states import state_names

SECONDS, STD = 0.05, np.array([0.3, 0.03, 0.3])


def yaw_and_rate(t):
    """A platform that turns to and fro at up to 1 rad/s."""
    return np.sin(np.pi / 4 * t) * 4 / np.pi, np.cos(np.pi / 4 * t)


def seen(place, velocity, t):
    """Position and velocity in the axes of the platform, which stays where it is."""
    yaw, _ = yaw_and_rate(t)
    back = np.array([[np.cos(yaw), np.sin(yaw)], [-np.sin(yaw), np.cos(yaw)]])
    return back @ place, back @ velocity


def recording(rng, *, bias, delay, speed=3.0, rows=500):
    """A target that drives past, LiDAR and radar in turn, each after a reading of the gyro."""
    told, truth = [], []
    for k in range(rows):
        t, stamp = k * SECONDS, round(k * SECONDS * 1e9)
        along = speed * (t - 8)
        place, velocity = seen(np.array([along, 8.0]), np.array([speed, 0.0]), t)
        rate = yaw_and_rate(t - delay)[1] + bias + 0.01 * rng.normal()
        told.append(Measurement(stamp, "gyro", [rate]))
        truth.append(place)
        if k % 2 == 0:
            told.append(Measurement(stamp, "lidar", place + 0.15 * rng.normal(size=2)))
        else:
            far = np.hypot(*place)
            values = [far, np.arctan2(place[1], place[0]), place @ velocity / far]
            told.append(Measurement(stamp, "radar", values + STD * rng.normal(size=3)))
    return told, np.array(truth)


def config(**options):
    return FusionConfig(
        model="ctrv-drone",
        acceleration_noise=0.3,
        turn_noise=0.2,
        sensor_noise="configured",
        **options,
    )


def errors(told, truth, chosen):
    """2-D errors after 10 s, and NEES/2 of the position."""
    found = run(told, chosen)
    wrong = (found.states[1::2, :2] - truth)[200:]
    spread = found.covariances[1::2, :2, :2][200:]
    nees = np.einsum("ti,tij,tj->t", wrong, np.linalg.inv(spread), wrong)
    return np.sqrt(np.square(wrong).sum(axis=1).mean()), nees.mean() / 2, found


def test_states_of_a_sensor_that_turns_are_named_by_what_is_known_of_its_gyro():
    assert state_names(config())[5:] == ("gyro_bias", "gyro_delay")
    assert state_names(config(gyro="exact"))[5:] == ()
    assert state_names(config(gyro="none"))[5:] == ("w_d",)
    with pytest.raises(ConfigError, match="gyro"):
        FusionConfig.load({"gyro": "late"})


@pytest.mark.parametrize(("bias", "delay"), [(0.1, 0.05), (-0.1, 0.05)])
def test_a_gyro_that_is_wrong_and_late_is_as_good_as_an_exact_one(bias, delay):
    told, truth = recording(np.random.default_rng(5), bias=bias, delay=delay)
    exact, same_truth = recording(np.random.default_rng(5), bias=0.0, delay=0.0)
    np.testing.assert_array_equal(truth, same_truth)
    least, right_nees, _ = errors(exact, truth, config(gyro="exact"))
    error, nees, found = errors(told, truth, config())
    believed, wrong_nees, _ = errors(told, truth, config(gyro="exact"))
    assert error < 1.3 * least
    assert 0.7 < nees / right_nees < 1.4
    assert believed > 1.08 * error, "the fault must matter"
    assert wrong_nees > 1.2 * nees
    assert abs(found.states[-1, 5] - bias) < 0.05
    assert abs(found.states[-1, 6] - delay) < 0.03


def test_a_right_gyro_is_not_made_wrong():
    told, truth = recording(np.random.default_rng(6), bias=0.0, delay=0.0)
    least, right_nees, _ = errors(told, truth, config(gyro="exact"))
    error, nees, found = errors(told, truth, config())
    assert error < 1.15 * least
    assert 0.7 < nees / right_nees < 1.4
    assert abs(found.states[-1, 5]) < 0.05


def test_bias_and_delay_stay_within_reason_where_nothing_shows_them():
    """A platform at rest: the rate does not change, so that no delay can be seen."""
    flt = TargetFilter(config())
    for k in range(200):
        flt.step(Measurement(50_000_000 * k, "gyro", [0.0]))
        step = flt.step(Measurement(50_000_000 * k, "lidar", [5.0, 1.0 + 0.05 * k]))
    assert step.state[6] == pytest.approx(0.0, abs=1e-3)
    assert np.sqrt(step.covariance[6, 6]) == pytest.approx(0.05, rel=0.05)


def test_readings_tell_how_the_platform_turned_since_the_last_one():
    """Readings 0.2 s apart of a rate that changes: their mean is right, the last one is not."""
    flt = TargetFilter(config(gyro="exact"))
    rng, wrong = np.random.default_rng(7), []
    for k in range(100):
        t, stamp = 0.2 * k, 200_000_000 * k
        yaw, rate = yaw_and_rate(t)
        flt.step(Measurement(stamp, "gyro", [rate]))
        place = 10 * np.array([np.cos(-yaw), np.sin(-yaw)])
        before = flt.state_at(stamp)
        if before is not None and k > 50:
            wrong.append(np.hypot(*(before[0][:2] - place)))
        flt.step(Measurement(stamp, "lidar", place + 0.01 * rng.normal(size=2), np.eye(2) * 1e-4))
    # A rate that is held for 0.2 s is 0.08 rad/s wrong in the mean: 0.1 m at 10 m.
    assert np.mean(wrong) < 0.06
