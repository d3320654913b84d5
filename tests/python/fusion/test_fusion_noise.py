"""Noise of the sensors, estimated while a target is tracked; dropouts; outliers."""

import numpy as np
import pytest

from lidar_core.fusion import FusionConfig, Measurement, TargetFilter, run, smooth

STD, RADAR = (0.15, 0.15), (0.3, 0.03, 0.3)
BELIEVED = {"gate_probability": None, "loss_ratio": None, "sensor_noise": "configured"}
STEP_NS = 50_000_000


def way(rows=400, speed=3.0, rate=0.3, turns_at=None):
    """Places and velocities on an arc that changes sides at row `turns_at`."""
    rates = np.full(rows, rate)
    if turns_at is not None:
        rates[turns_at:] = -rate
    heading = np.concatenate([[0.3], 0.3 + np.cumsum(rates[:-1]) * STEP_NS * 1e-9])
    velocity = speed * np.stack([np.cos(heading), np.sin(heading)], axis=1)
    steps = velocity[:-1] * STEP_NS * 1e-9
    return np.array([15.0, 5.0]) + np.vstack([[[0, 0]], np.cumsum(steps, axis=0)]), velocity


def seen(place, velocity, rng, *, true=1.0, covariances=False):
    """LiDAR and radar in turn, with errors `true` times as large as usual."""
    found = []
    for k, (at, v) in enumerate(zip(place, velocity, strict=True)):
        if k % 2:
            distance = np.hypot(*at)
            values = np.array([distance, np.arctan2(at[1], at[0]), at @ v / distance])
            std, sensor = true * np.array(RADAR), "radar"
        else:
            values, std, sensor = at, true * np.array(STD), "lidar"
        noise = np.diag(std**2) if covariances else None
        values = values + std * rng.normal(size=len(std))
        found.append(Measurement(k * STEP_NS, sensor, values, noise))
    return found


def rmse(result, place, rows=slice(60, None)):
    return np.sqrt(np.square(result.states[rows, :2] - place[rows]).sum(axis=1).mean())


@pytest.mark.parametrize("method", ["ekf", "ukf", "imm"])
@pytest.mark.parametrize("factor", [0.2, 0.5, 2.0])
def test_noise_that_is_told_wrongly_hardly_matters(method, factor):
    place, velocity = way()
    measurements = seen(place, velocity, np.random.default_rng(3))
    right = run(measurements, FusionConfig(method=method, **BELIEVED))
    told = {"lidar_std": (factor * 0.15,) * 2, "radar_std": tuple(factor * np.array(RADAR))}
    result = run(measurements, FusionConfig(method=method, **told))
    assert rmse(result, place) < 1.15 * rmse(right, place)
    np.testing.assert_allclose(result.lidar_std_estimated, STD, rtol=0.25)
    # The default motion explains range rates of a target that keeps its speed: they tell little.
    np.testing.assert_allclose(result.radar_std_estimated[:2], RADAR[:2], rtol=0.25)


def test_noise_that_is_believed_stays_what_it_is():
    place, velocity = way()
    config = FusionConfig(lidar_std=(0.05, 0.05), sensor_noise="configured")
    result = run(seen(place, velocity, np.random.default_rng(3)), config)
    np.testing.assert_array_equal(result.lidar_std_estimated, config.lidar_std)
    np.testing.assert_array_equal(result.radar_std_estimated, config.radar_std)


def test_noise_that_measurements_bring_is_believed():
    place, velocity = way(200)
    result = run(seen(place, velocity, np.random.default_rng(4), covariances=True))
    np.testing.assert_array_equal(result.lidar_std_estimated, STD)
    believed = FusionConfig(sensor_noise="configured")
    again = run(seen(place, velocity, np.random.default_rng(4), covariances=True), believed)
    np.testing.assert_array_equal(result.states, again.states)


def test_an_outlier_is_refused_and_leaves_the_noise_alone():
    place, velocity = way(200)
    clean = seen(place, velocity, np.random.default_rng(5))
    far = Measurement(clean[150].stamp_ns, "lidar", clean[150].values + np.array([4.0, -3.0]))
    result = run([*clean[:150], far, *clean[151:]])
    assert result.outcomes[150] == "gated"
    assert np.hypot(*(result.states[150, :2] - place[150])) < 0.5
    ratio = result.lidar_std_estimated / run(clean).lidar_std_estimated
    assert (ratio < 1.15).all()


def test_the_first_fix_after_a_dropout_is_taken():
    place, velocity = way(500, speed=10.0, rate=0.6, turns_at=250)
    kept = [*range(201), *range(300, 500)]
    for seed in range(20):
        every = seen(place, velocity, np.random.default_rng(seed))
        result = run([every[k] for k in kept])
        wrong = np.hypot(*(result.states[:, :2] - place[kept]).T)
        assert result.outcomes[201] == "updated"
        assert wrong[201] < 1.0
        assert wrong[260:].max() < 1.5


def test_smoothing_goes_across_a_manoeuvre_in_a_dropout():
    place, velocity = way(500, speed=10.0, rate=0.6, turns_at=250)
    kept = [*range(201), *range(300, 500)]
    for seed in range(10):
        every = seen(place, velocity, np.random.default_rng(seed))
        result = smooth([every[k] for k in kept])
        wrong = np.hypot(*(result.states[:, :2] - place[kept]).T)
        assert wrong[20:201].max() < 0.6


def test_health_tells_both_and_survives_saving():
    place, velocity = way(200)
    measurements = seen(place, velocity, np.random.default_rng(6), true=2.0)
    target = TargetFilter()
    for one in measurements[:120]:
        target.step(one)
    health = target.health()
    np.testing.assert_array_equal(health.lidar_std, STD)
    np.testing.assert_allclose(health.lidar_std_estimated, 0.3, rtol=0.3)
    again = TargetFilter.from_bytes(target.to_bytes())
    for one in measurements[120:]:
        np.testing.assert_array_equal(target.step(one).state, again.step(one).state)
    np.testing.assert_array_equal(
        target.health().radar_std_estimated, again.health().radar_std_estimated
    )


def test_late_measurements_teach_the_same():
    place, velocity = way(200)
    measurements = seen(place, velocity, np.random.default_rng(7), true=2.0)
    late = [*measurements[:100], *measurements[101:104], measurements[100], *measurements[104:]]
    targets = []
    for order in (measurements, late):
        target = TargetFilter()
        for one in order:
            target.step(one)
        targets.append(target)
    one, other = (target.state_at(199 * STEP_NS) for target in targets)
    np.testing.assert_array_equal(one[0], other[0])
    health = [target.health() for target in targets]
    np.testing.assert_array_equal(health[0].lidar_std_estimated, health[1].lidar_std_estimated)
