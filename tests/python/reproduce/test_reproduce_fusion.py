"""Parts of the fusion items: noise that is added, forms of measurements, bound, recordings."""

import numpy as np
import pytest

from lidar_core.errors import ConfigError
from lidar_core.fusion import FusionConfig, run
from lidar_core.fusion.recordings.reading import TargetTruth
from lidar_core.reproduce import Request, item_named
from lidar_core.reproduce.fusion.bounds import position_bound
from lidar_core.reproduce.fusion.contenders import (
    BEST,
    EKF,
    FIXED,
    LINEAR,
    OURS,
    corrected,
    ours,
    printed,
)
from lidar_core.reproduce.fusion.drone_yaw import Ride
from lidar_core.reproduce.fusion.laser_radar import (
    OBJ_POSE,
    SAMPLE_1,
    Contender,
    Course,
    add_noise,
    course,
    draws_of,
    estimates,
    in_turn,
    measured,
    measurements,
    places,
    plane,
)
from lidar_core.reproduce.recordings import FOLDER, is_missing, recording


def circle(rows=400):
    """A target that goes round, measured by LiDAR and radar in turn."""
    t = np.arange(rows) * 0.05
    way = np.stack([8 + 3 * np.cos(0.5 * t), 2 + 3 * np.sin(0.5 * t)], axis=1)
    velocity = 1.5 * np.stack([-np.sin(0.5 * t), np.cos(0.5 * t)], axis=1)
    truth = TargetTruth(np.arange(rows) * 50_000_000, way, velocity, None, None)
    values = measured(truth, OURS, np.random.default_rng(40))
    return Course(in_turn(rows), values, truth)


def test_noise_has_its_power_in_the_plane_and_leaves_range_rates():
    of = circle(4000)
    values = add_noise(of, 0.2, np.random.default_rng(41))
    added = places(values, of.is_lidar) - places(of.values, of.is_lidar)
    np.testing.assert_allclose(added.std(axis=0), 0.2, rtol=0.05)
    np.testing.assert_array_equal(values[~of.is_lidar, 2], of.values[~of.is_lidar, 2])


def test_draws_hang_on_their_seed_number_and_level_alone():
    of = circle(20)
    draws = draws_of(of, -13, 3, seed=5)
    np.testing.assert_array_equal(draws[2], draws_of(of, -13, 1, seed=5, first=2)[0])
    assert not np.allclose(draws[0], draws[1])
    assert not np.allclose(draws[0], draws_of(of, -13, 1, seed=6)[0])


def test_a_position_and_a_range_rate_are_what_the_radar_said():
    of, std = circle(), 0.2
    values = add_noise(of, std, np.random.default_rng(42))
    config = FusionConfig(acceleration_noise=0.3, turn_noise=0.3)
    found = [
        estimates(run(measurements(of, values, form, OURS, std), config), of, form)
        for form in ("polar", "position")
    ]
    assert np.abs(found[0] - found[1])[100:].max() < 0.1
    assert np.hypot(*(found[1] - of.truth.position)[100:].T).mean() < 0.1


def test_those_of_the_lidar_alone_leave_the_other_rows_open():
    of = circle()
    way = estimates(
        run(measurements(of, of.values, "lidar", OURS, 0.0), FusionConfig(model="cv")), of, "lidar"
    )
    assert np.isnan(way[~of.is_lidar]).all()
    assert np.abs(way - of.truth.position)[50:][of.is_lidar[50:]].max() < 0.1


def test_the_bound_of_a_linear_filter_is_its_covariance():
    of = circle(100)
    noise = [0.15**2 * np.eye(2)] * 100
    bound = position_bound(
        of.truth.position,
        of.truth.velocity,
        of.truth.stamps_ns * 1e-9,
        noise,
        acceleration_noise=2.0,
    )
    config = FusionConfig(
        model="cv",
        method="kf",
        process="discrete",
        acceleration_noise=2.0,
        start_rows=1,
        gate_probability=None,
        loss_ratio=None,
        sensor_noise="configured",
        initial_position=0.5**0.5,
    )
    lidar = Course(np.ones(100, bool), places(of.values, of.is_lidar), of.truth)
    result = run(measurements(lidar, lidar.values, "fixed", FIXED, 0.0), config)
    variances = result.covariances[20:, [0, 1], [0, 1]].mean(axis=0)
    np.testing.assert_allclose(bound, np.sqrt(variances), rtol=1e-3)  # the start differs


def test_the_bound_of_a_radar_takes_in_its_range_rate():
    of = circle(200)
    seconds = of.truth.stamps_ns * 1e-9

    def bound(rate):
        noise = [np.diag(np.square([*FIXED.radar[:2], rate]))] * 200
        return position_bound(
            of.truth.position, of.truth.velocity, seconds, noise, acceleration_noise=2.0
        )

    assert (bound(0.1) < 0.9 * bound(100.0)).all()


def test_the_numbers_of_the_audit(recordings, monkeypatch):
    monkeypatch.setenv(FOLDER, str(recordings))
    of = course(SAMPLE_1)
    draws = draws_of(of, -13, 6, seed=1000)
    std = 10 ** (-13 / 20)

    def error(one: Contender) -> float:
        return plane(one.rmse(of, draws, std, threads=1))

    assert error(printed()[LINEAR]) == pytest.approx(0.209, abs=0.01)
    assert error(corrected()[EKF]) == pytest.approx(0.162, abs=0.01)
    assert error(printed()[EKF]) > 1.0
    assert error(ours()[BEST]) < 0.13


def test_the_audit_s_variances_of_the_lidar(recordings, monkeypatch):
    """Eq. 27 has 0.0222 m^2, which is that of another file than the one of the paper's figures."""
    monkeypatch.setenv(FOLDER, str(recordings))
    for name, variance in ((SAMPLE_1, 1e-4), (OBJ_POSE, 0.0222)):
        of = course(name)
        wrong = (of.values[:, :2] - of.truth.position)[of.is_lidar]
        assert np.square(wrong).mean() == pytest.approx(variance, rel=0.1)


def test_a_recording_that_is_not_there_is_named_with_the_cure(monkeypatch, tmp_path):
    monkeypatch.delenv(FOLDER, raising=False)
    with pytest.raises(ConfigError, match=r"LIDAR_CORE_DATA: expected .* got nothing; docs/"):
        recording(SAMPLE_1)
    monkeypatch.setenv(FOLDER, str(tmp_path))
    assert is_missing((SAMPLE_1,))
    assert not is_missing(())
    (tmp_path / "fusion").mkdir()
    (tmp_path / SAMPLE_1).touch()
    assert recording(SAMPLE_1) == tmp_path / SAMPLE_1


@pytest.mark.parametrize(("rate", "speed"), [(0.0, 2.0), (1.0, 0.0), (1.0, 3.0)])
def test_what_a_moving_sensor_sees_moves_as_its_rates_say(rate, speed):
    of = circle()
    ride = Ride.of(of.truth.stamps_ns * 1e-9, rate, speed)
    seen = ride.relative(of.truth)
    read = ride.gyro(of.truth.stamps_ns * 1e-9)
    np.testing.assert_allclose(np.diff(ride.yaw) / 0.05, (read[1:] + read[:-1]) / 2, atol=1e-3)
    late = ride.gyro(of.truth.stamps_ns * 1e-9, 0.1, 0.05)
    np.testing.assert_allclose(late[1:], read[:-1] + 0.1, atol=1e-12)
    steps = np.linalg.norm(np.diff(ride.position, axis=0), axis=1)
    np.testing.assert_allclose(steps, speed * 0.05, rtol=1e-3)
    middle = (seen.position[2:] - seen.position[:-2]) / 0.1
    turn = read[1:-1]
    x, y = seen.position[1:-1].T
    apparent = seen.velocity[1:-1] - np.stack([-turn * y, turn * x], axis=1)
    np.testing.assert_allclose(middle, apparent, atol=0.02, rtol=2e-3)


MODES_OF = {
    "fusion-rmse": "2-D RMSE, EKF-CTRV",
    "fusion-fig7": "RMSE of x, filter",
    "fusion-fig8": "2-D RMSE of the whole way, filter",
    "fusion-fig9": "2-D RMSE, label 16 dB, filter",
    "fusion-fig10": "EKF-CTRV@-15dBW",
}


@pytest.mark.parametrize("name", MODES_OF)
def test_paper_mode_is_the_printed_algorithm_and_the_corrected_one_has_its_own_column(
    name, recordings, monkeypatch
):
    """The corrected filter is ten times better, so that no number can stand in the wrong column."""
    monkeypatch.setenv(FOLDER, str(recordings))
    result = item_named(name).run(Request(seed=1000, scans=2, threads=1))
    rows = {row.name: row for row in result.rows}
    row = rows[MODES_OF[name]]
    assert row.paper_mode > 5 * row.equations_corrected
    assert row.best_mode < 1.2 * row.equations_corrected
    assert not any("corrected" in one or one.startswith("equations as printed") for one in rows)
    printed_alone = {
        name: one.model
        for name, one in result.config.items()
        if name.startswith("paper ") and "linear" not in name
    }
    assert set(printed_alone.values()) <= {"paper"}


def test_what_the_paper_does_not_print_has_no_number_in_its_mode(recordings, monkeypatch):
    monkeypatch.setenv(FOLDER, str(recordings))
    result = item_named("fusion-fig10").run(Request(seed=1000, scans=1, threads=1))
    rows = {row.name: row for row in result.rows}
    for name in ("EKF-CV", "UKF-CTRV", "CKF-CTRV"):
        row = rows[f"{name}@-15dBW"]
        assert row.paper_mode is None
        assert None not in (row.equations_corrected, row.best_mode)
    assert rows["linear KF@-15dBW"].equations_corrected is None  # nothing to correct
