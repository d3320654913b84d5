"""A drone above a target: what is simulated, levelled, and given its height."""

import csv

import numpy as np
import pytest

from lidar_core.errors import InputError
from lidar_core.fusion import (
    FusionConfig,
    in_space,
    level_sight,
    read_measurements,
    run,
    write_overflight,
)
from lidar_core.sim import Overflight, overfly

EXACT = {
    "lidar_std": 0.0,
    "radar_std": (0.0, 0.0, 0.0),
    "angle_std": (0.0, 0.0),
    "gyro_std": 0.0,
}
STD = np.array([0.1, 0.01, 0.1])


def polar(made):
    """Range, bearing and range rate of all rows; the LiDAR's rates from the truth."""
    x, y, _ = made.values.T
    sight = made.position - made.drone
    relative = made.velocity - made.drone_velocity
    rate = (sight * relative).sum(axis=1) / np.linalg.norm(sight, axis=1)
    lidar = np.stack([np.hypot(x, y), np.arctan2(y, x), rate], axis=1)
    return np.where(made.is_lidar[:, None], lidar, made.values)


def test_without_errors_the_level_frame_and_the_height_are_the_truth():
    made = overfly(Overflight(seconds=10.0, pitch_deg=15.0, **EXACT), seed=0)
    sight = level_sight(
        polar(made),
        made.swivel,
        made.pitch,
        std=np.tile(STD, (200, 1)),
        swivel_std=0.0,
        pitch_std=0.0,
    )
    flat = (made.position - made.drone)[:, :2]
    direction = sight.values[:, 1] + made.yaw
    rho = sight.values[:, 0]
    np.testing.assert_allclose(rho, np.hypot(*flat.T), atol=1e-9)
    np.testing.assert_allclose(rho * np.cos(direction), flat[:, 0], atol=1e-9)
    np.testing.assert_allclose(rho * np.sin(direction), flat[:, 1], atol=1e-9)
    relative = (made.velocity - made.drone_velocity)[:, :2]
    np.testing.assert_allclose(sight.values[:, 2], (flat * relative).sum(axis=1) / rho, atol=1e-9)
    track = in_space(
        made.position[:, :2],
        np.tile(np.eye(2), (200, 1, 1)),
        sight.elevation,
        sight.elevation_variance,
        made.drone,
    )
    np.testing.assert_allclose(track.position, made.position, atol=1e-9)
    np.testing.assert_allclose(track.cylindrical[:, 2], -6.0, atol=1e-9)


def test_the_target_moves_as_its_velocity_says():
    made = overfly(Overflight(seconds=10.0, **EXACT), seed=0)
    seconds = made.stamps_ns * 1e-9
    moved = np.gradient(made.position, seconds, axis=0)
    np.testing.assert_allclose(moved[1:-1], made.velocity[1:-1], atol=2e-3)
    np.testing.assert_allclose(np.gradient(made.yaw, seconds)[1:-1], made.yaw_rate[1:-1], atol=2e-3)
    np.testing.assert_allclose(np.linalg.norm(made.velocity, axis=1), 1.4)


def test_covariances_of_the_level_sight_are_those_of_many_draws():
    rng = np.random.default_rng(50)
    true, swivel, pitch = np.array([9.0, 0.7, 1.5]), -0.6, 0.1

    def level(values, up, down):
        std = np.tile(STD, (len(values), 1))
        return level_sight(values, up, down, std=std, swivel_std=0.01, pitch_std=0.005)

    n = 40_000
    drawn = level(
        true + rng.normal(size=(n, 3)) * STD,
        swivel + 0.01 * rng.normal(size=n),
        pitch + 0.005 * rng.normal(size=n),
    )
    said = level(true[None], [swivel], [pitch])
    got = np.cov(drawn.values.T)
    np.testing.assert_allclose(np.diag(said.covariances[0]), np.diag(got), rtol=0.1)
    assert said.covariances[0, 0, 2] == pytest.approx(got[0, 2], rel=0.25)
    assert said.elevation_variance[0] == pytest.approx(drawn.elevation.var(), rel=0.1)


@pytest.mark.parametrize("form", ["position", "cylindrical"])
def test_covariances_in_space_are_those_of_many_draws(form):
    rng = np.random.default_rng(51)
    P, n = np.array([[0.04, 0.01], [0.01, 0.02]]), 40_000
    place, sensor = np.array([8.0, 3.0]), np.array([1.0, 2.0, 6.0])
    drawn = in_space(
        rng.multivariate_normal(place, P, n),
        np.tile(P, (n, 1, 1)),
        -0.7 + 0.01 * rng.normal(size=n),
        np.full(n, 1e-4),
        np.tile(sensor, (n, 1)),
    )
    said = in_space(place[None], P[None], [-0.7], [1e-4], sensor[None])
    covariance = said.covariance if form == "position" else said.cylindrical_covariance
    got = np.cov(getattr(drawn, form).T)
    np.testing.assert_allclose(covariance[0], got, atol=0.05 * np.abs(got).max())


def test_filtered_heights_are_the_better_ones():
    rng = np.random.default_rng(52)
    sensor = np.tile([0.0, 0.0, 6.0], (400, 1))
    place = np.tile([8.0, 0.0], (400, 1))
    elevation = np.arctan2(-6, 8) + 0.02 * rng.normal(size=400)
    given = (place, np.tile(1e-4 * np.eye(2), (400, 1, 1)), elevation, np.full(400, 4e-4), sensor)
    each = in_space(*given)
    filtered = in_space(*given, drift=np.full(400, 1e-5))
    wrong = [np.abs(track.position[50:, 2]).mean() for track in (each, filtered)]
    assert wrong[1] < 0.3 * wrong[0]
    nees = filtered.position[50:, 2] ** 2 / filtered.covariance[50:, 2, 2]
    assert nees.mean() < 1.5


def test_the_same_seed_gives_the_same_errors_and_the_truth_is_written(tmp_path):
    scene = Overflight(seconds=2.0)
    made, again, other = (overfly(scene, seed=seed) for seed in (3, 3, 4))
    np.testing.assert_array_equal(made.values, again.values)
    assert not np.allclose(made.values, other.values)
    made.write_truth(tmp_path / "truth.csv")
    with (tmp_path / "truth.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 40
    assert int(rows[7]["t_ns"]) == made.stamps_ns[7]
    assert float(rows[7]["y"]) == made.position[7, 1]
    assert float(rows[7]["drone_pitch"]) == made.true_pitch[7]


def test_a_table_is_tracked_by_the_fusion(tmp_path):
    made = overfly(Overflight(seconds=10.0), seed=4)
    write_overflight(tmp_path / "drone.csv", made)
    log = read_measurements(tmp_path / "drone.csv")
    np.testing.assert_allclose(log.truth.position[::3], made.position[:, :2])
    sensors = [one.sensor for one in log.measurements[:6]]
    assert sensors == ["pose", "gyro", "lidar", "pose", "gyro", "radar"]
    lidar = log.measurements[2]
    c, s = np.cos(made.yaw[0]), np.sin(made.yaw[0])
    place = np.array([[c, -s], [s, c]]) @ lidar.values + made.drone[0, :2]
    np.testing.assert_allclose(place, made.position[0, :2], atol=0.5)
    found = run(log.measurements, FusionConfig())
    assert np.hypot(*(found.states[-1, :2] - made.position[-1, :2])) < 0.3


def test_wrong_shapes_are_named():
    with pytest.raises(InputError, match=r"values: expected shape \(N, 3\)"):
        level_sight([[1.0, 2.0]], [0.0], [0.0], std=[STD], swivel_std=0.01, pitch_std=0.01)
    with pytest.raises(InputError, match=r"swivel: expected shape \(1,\)"):
        level_sight([[9.0, 0.0, 0.0]], [0.0, 0.0], [0.0], std=[STD], swivel_std=0, pitch_std=0)
    with pytest.raises(InputError, match="above or below the sensor"):
        in_space([[0.0, 0.0]], [np.eye(2)], [0.1], [0.1], [[0.0, 0.0, 5.0]])
