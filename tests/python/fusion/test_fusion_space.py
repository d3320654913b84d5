"""Targets in space: oracles, partial measurements, sensors that roll, pitch and climb."""

import copy

import numpy as np
import pytest

from lidar_core.errors import ConfigError, InputError
from lidar_core.fusion import FusionConfig, Measurement, TargetFilter, run, smooth
from reference import fusion_space as oracle

STEP = 0.1
LEVER = (0.2, -0.1, 0.15)
OPEN = {
    "gate_probability": None,
    "loss_ratio": None,
    "sensor_noise": "configured",
    "acceleration_noise": 1.0,
    "start_rows": 1,
    "lever_arm": LEVER,
    "lidar_std": (0.1, 0.15, 0.2),
    "radar_std": (0.3, 0.03, 0.02, 0.2),
    "pose_std": (0.02, 0.02, 0.03, 0.004, 0.005, 0.006),
}
STRENGTHS = {"a": 1.0, "j": 2.0, "t": 0.5}
SIZES = {"cv-3d": 6, "ca-3d": 9, "ctrv-3d": 7}
NAMES = ("range", "bearing", "elevation", "range_rate")
SENSORS = (None, (0, 1, 2, 3), (0, 1, 2), (1, 2), (0,), (0, 1, 3), (3,))
"""What is measured in turn: x, y, z, or some of the four polar values."""


def pose_at(t):
    """Pose of twelve numbers of a platform that turns about all axes and climbs."""
    return np.array([2 * t, 0.5 * t, 5 + t, 0.2, -0.1, 0.3, 2.0, 0.5, 1.0, 0.1, -0.05, 0.2])


def recording(rows=60):
    """Measurements with poses before each, and what the oracle needs of them."""
    rng = np.random.default_rng(9200)
    seen, told = [], []
    for k in range(rows):
        t, stamp = k * STEP, round(k * STEP * 1e9)
        state = np.array([20 + 3 * t, -5 + t, 2 - 0.5 * t, 3.0, 1.0, -0.5])
        pose, chosen = pose_at(t), SENSORS[k % len(SENSORS)]
        z = oracle.measured("cv-3d", state, pose, LEVER, chosen)
        stds = OPEN["lidar_std"] if chosen is None else np.array(OPEN["radar_std"])[list(chosen)]
        z = z + rng.normal(size=len(z)) * stds
        seen.append(Measurement(stamp, "pose-3d", pose))
        if chosen is None:
            seen.append(Measurement(stamp, "lidar", z))
        else:
            seen.append(Measurement(stamp, "radar", z, measures=[NAMES[i] for i in chosen]))
        told.append((pose, chosen, z, np.diag(np.square(stds))))
    return seen, told


def expected(model, method, states, covariances, told):
    """What each step gives, from the state before it: rounding does not add up."""
    spread = np.diag(np.square(OPEN["pose_std"]))
    for s, P, (pose, chosen, z, R) in zip(states, covariances, told[1:], strict=False):
        given = (model, s, P, STEP, z, R, STRENGTHS, pose, np.array(LEVER), chosen, spread)
        reach = 3.0 if method == "ukf" else SIZES[model]
        yield oracle.ekf_step(*given) if method == "ekf" else oracle.ukf_step(*given, reach)


@pytest.mark.ci_cases("*-c[va]-3d", "ckf-ctrv-3d")
@pytest.mark.parametrize("model", list(SIZES))
@pytest.mark.parametrize("method", ["ekf", "ukf", "ckf"])
def test_filters_agree_with_the_oracle(model, method):
    seen, told = recording()
    result = run(seen, FusionConfig(model=model, method=method, **OPEN))
    states, covariances = result.states[1::2], result.covariances[1::2]
    assert states.shape == (60, SIZES[model])
    assert result.innovations.shape == (120, 4)
    rows = expected(model, method, states, covariances, told)
    for k, (s, P, nis) in enumerate(rows, 1):
        off = states[k] - s
        if model == "ctrv-3d":
            off[4] -= 2 * np.pi * np.round(off[4] / (2 * np.pi))
        np.testing.assert_allclose(off, 0, atol=2e-6, err_msg=str(k))
        np.testing.assert_allclose(covariances[k], P, atol=2e-6)
        np.testing.assert_allclose(result.nis[2 * k + 1], nis, rtol=1e-5)


def test_one_model_with_imm_is_that_model():
    seen, _ = recording()
    for model in SIZES:
        alone = run(seen, FusionConfig(model=model, **OPEN))
        mixed = run(seen, FusionConfig(method="imm", imm_models=(model,), **OPEN))
        assert mixed.states.shape[1] == 9
        np.testing.assert_allclose(mixed.states[:, :3], alone.states[:, :3], atol=1e-9)
        np.testing.assert_allclose(
            mixed.covariances[:, :3, :3], alone.covariances[:, :3, :3], atol=1e-9
        )


def test_in_the_plane_of_the_sensor_space_is_the_plane():
    rng = np.random.default_rng(9201)
    flat, deep = [], []
    for k in range(80):
        t, stamp = k * STEP, round(k * STEP * 1e9)
        x, y = 8 + 2 * t + 0.1 * rng.normal(), 3 - t + 0.1 * rng.normal()
        if k % 2:
            polar = [np.hypot(x, y), np.arctan2(y, x), (2 * x - y) / np.hypot(x, y)]
            flat.append(Measurement(stamp, "radar", polar))
            deep.append(Measurement(stamp, "radar", [*polar[:2], 0.0, polar[2]]))
        else:
            flat.append(Measurement(stamp, "lidar", [x, y]))
            deep.append(Measurement(stamp, "lidar", [x, y, 0.0]))
    for plane, space in (("cv", "cv-3d"), ("ca", "ca-3d"), ("ctrv", "ctrv-3d")):
        config = {key: value for key, value in OPEN.items() if "std" not in key} | {
            "lever_arm": (0, 0)
        }
        expected = run(flat, FusionConfig(model=plane, **config))
        found = run(deep, FusionConfig(model=space, **config))
        np.testing.assert_allclose(found.states[:, :2], expected.states[:, :2], atol=1e-9)
        np.testing.assert_allclose(found.states[:, 2], 0, atol=1e-12)
        assert (np.sqrt(found.covariances[:, 2, 2]) > 0).all()


def climbing(seed, *, tilted=1.0):
    """A target and a platform that rolls, climbs and has its sensor off its origin; truth."""
    rng = np.random.default_rng([9202, seed])
    seen, truth = [], []
    for k in range(200):
        t, stamp = k * 0.05, round(k * 0.05 * 1e9)
        heading = 0.4 * np.sin(0.5 * t)
        truth.append([10 + 1.5 * t, 3 * np.sin(0.3 * t), 0.2 * t])
        speed = np.array([1.5, 0.9 * np.cos(0.3 * t), 0.2])
        roll, rate = 0.2 * tilted * np.sin(2 * t), 0.4 * tilted * np.cos(2 * t)
        pose = np.array([t, 0, 6 + tilted * t, roll, 0, heading, 1, 0, tilted, 0, 0, 0])
        yawing = 0.2 * np.cos(0.5 * t)
        pose[9:] = [rate, yawing * np.sin(roll), yawing * np.cos(roll)]
        state = np.concatenate([truth[-1], speed])
        z = oracle.measured("cv-3d", state, pose, np.array(LEVER), (0, 1, 2, 3))
        z += rng.normal(size=4) * (0.2, 0.02, 0.02, 0.15)
        seen += [Measurement(stamp, "pose-3d", pose), Measurement(stamp, "radar", z)]
    return seen, np.array(truth)


@pytest.mark.parametrize("model", ["cv-3d", "ctrv-3d"])
def test_a_rolling_and_climbing_sensor_is_as_good_as_a_level_one(model):
    config = FusionConfig(model=model, lever_arm=LEVER, radar_std=(0.2, 0.02, 0.02, 0.15))
    rmse, nees = {}, []
    for tilted in (0.0, 1.0):
        errors = []
        for seed in range(4):
            seen, truth = climbing(seed, tilted=tilted)
            result = run(seen, config)
            off, P = result.states[1::2, :3] - truth, result.covariances[1::2, :3, :3]
            errors.append(off[40:])
            if tilted:
                nees.append(np.einsum("ki,kij,kj->k", off, np.linalg.inv(P), off)[40:])
        rmse[tilted] = np.sqrt(np.square(errors).sum(axis=2).mean())
    assert rmse[1.0] <= 1.1 * rmse[0.0]
    assert 0.5 <= np.mean(nees) / 3 <= 1.5
    # The opposite error: without the roll the same measurements are far off.
    flat = [
        Measurement(m.stamp_ns, "pose-3d", np.where(np.arange(12) == 3, 0, m.values))
        if m.sensor == "pose-3d"
        else m
        for m in seen
    ]
    wrong = run(flat, config).states[1::2, :3] - truth
    assert np.sqrt(np.square(wrong[40:]).sum(axis=1).mean()) > 1.5 * rmse[1.0]


def test_velocities_of_poses_are_those_between_them():
    seen, truth = climbing(0)
    short = [Measurement(m.stamp_ns, m.sensor, m.values[:6]) for m in seen[::2]]
    config = FusionConfig(model="cv-3d", lever_arm=LEVER, radar_std=(0.2, 0.02, 0.02, 0.15))
    mixed = [one for pair in zip(short, seen[1::2], strict=True) for one in pair]
    off = run(mixed, config).states[1::2, :3] - run(seen, config).states[1::2, :3]
    assert np.abs(off[40:]).max() < 0.05
    assert np.abs(run(mixed, config).states[1::2, :3] - truth)[40:].max() < 1.0


def test_states_in_space_are_smoothed_saved_and_estimated():
    seen, truth = climbing(1)
    config = FusionConfig(model="ctrv-3d", lever_arm=LEVER)
    found, better = run(seen, config), smooth(seen, config)
    rms = [
        np.sqrt(np.square(one.states[1::2, :3] - truth)[40:].sum(axis=1).mean())
        for one in (found, better)
    ]
    assert rms[1] < rms[0]
    assert found.lidar_std_estimated.shape == (3,)
    assert found.radar_std_estimated.shape == (4,)
    assert found.radar_std_estimated[2] == pytest.approx(0.02, rel=0.3), "told .03"
    target = TargetFilter(config)
    for m in seen[:100]:
        target.step(m)
    assert target.health().radar_std.tolist() == [0.3, 0.03, 0.03, 0.3]
    again = copy.deepcopy(target)
    for m in seen[100:140]:
        steps = target.step(m), again.step(m)
        np.testing.assert_array_equal(steps[0].state, steps[1].state)
        np.testing.assert_array_equal(steps[0].covariance, steps[1].covariance)


def test_what_tells_no_position_starts_no_target_and_is_refused_where_it_tells_nothing():
    target = TargetFilter(FusionConfig(model="cv-3d"))
    bearing = Measurement(0, "radar", [0.3], measures=["bearing"])
    assert target.step(bearing).outcome == "invalid"
    assert target.step(Measurement(1, "radar", [9.0, 0.3, 0.1, 0.0])).outcome == "started"
    assert target.step(bearing).outcome == "late"
    after = target.step(Measurement(2, "radar", [0.3], measures=["bearing"]))
    assert after.outcome == "updated"
    assert after.innovation.shape == (1,)
    flat = TargetFilter(FusionConfig(model="cv"))
    flat.step(Measurement(0, "lidar", [3.0, 1.0]))
    before = flat.state_at(0)
    step = flat.step(Measurement(10, "radar", [0.1], measures=["elevation"]))
    assert step.outcome == "invalid"
    np.testing.assert_array_equal(flat.state_at(0)[0], before[0])


def test_a_filter_in_the_plane_levels_what_has_an_elevation():
    config = FusionConfig(model="cv", **{**OPEN, "pose_std": (0, 0, 0), "lever_arm": (0, 0)})
    up, cosine = 0.4, np.cos(0.4)
    found = run(
        [Measurement(k * 10**8, "radar", [9.0 / cosine, 0.2, up, 1.0 * cosine]) for k in range(5)],
        config,
    )
    expected = run([Measurement(k * 10**8, "radar", [9.0, 0.2, 1.0]) for k in range(5)], config)
    np.testing.assert_allclose(found.states, expected.states, atol=0.1)
    np.testing.assert_allclose(found.states[0], expected.states[0], atol=1e-12)


def test_wrong_arguments_are_named():
    with pytest.raises(InputError, match="measures: expected some of range, bearing"):
        Measurement(0, "radar", [1.0, 2.0], measures=["bearing", "range"])
    with pytest.raises(InputError, match=r"values: expected shape \(1,\), got \(2,\)"):
        Measurement(0, "radar", [1.0, 2.0], measures=["bearing"])
    with pytest.raises(InputError, match="measures: applies only to sensor 'radar'"):
        Measurement(0, "lidar", [1.0, 2.0], measures=["bearing"])
    with pytest.raises(ConfigError, match="in the plane, or models in space"):
        FusionConfig(method="imm", imm_models=("cv", "cv-3d"))
    with pytest.raises(ConfigError):
        FusionConfig(lidar_std=(0.1,))
