"""Interacting models with a quiet copy: oracle, consistency where targets change their noise."""

import numpy as np
import pytest

from lidar_core.errors import ConfigError
from lidar_core.estimation import chi2_quantile
from lidar_core.fusion import FusionConfig, Measurement, Measurements, run, run_batch
from reference.fusion_imm import SomeNoises

STEP = 0.1
ORACLE = 1e-9
"""Inverses instead of factors, over a hundred steps."""
OPEN = {"gate_probability": None, "loss_ratio": None, "sensor_noise": "configured"}
CONFIG = FusionConfig.load(
    {
        "method": "imm",
        "imm_models": ("cv",),
        "imm_quiet": 0.1,
        "imm_sojourn": 3.0,
        "start_rows": 1,
        "acceleration_noise": 2.0,
        "lidar_std": (0.15, 0.1),
        **OPEN,
    }
)
TARGETS, ROWS, SETTLED = 60, 200, 20


def switching(rng):
    """States (ROWS, 4) of a target whose noise changes by the matrix of the filter."""
    state, mode, states = np.array([5.0, 2.0, 1.0, 0.5]), int(rng.integers(2)), []
    stay = np.exp(-STEP / CONFIG.imm_sojourn)
    power = np.array([[STEP**3 / 3, STEP**2 / 2], [STEP**2 / 2, STEP]])
    for _ in range(ROWS):
        states.append(state)
        mode = mode if rng.random() < stay else 1 - mode
        density = CONFIG.acceleration_noise * (CONFIG.imm_quiet if mode else 1.0)
        push = density * np.linalg.cholesky(power) @ rng.normal(size=(2, 2))
        state = np.concatenate([state[:2] + STEP * state[2:] + push[0], state[2:] + push[1]])
    return np.array(states)


@pytest.mark.parametrize("models", [("cv",), ("cv", "standing")])
def test_two_noises_agree_with_the_oracle(models):
    config = CONFIG.model_copy(update={"imm_models": models})
    rng = np.random.default_rng(9100)
    truth = switching(rng)
    seen = truth[:, :2] + rng.normal(0, CONFIG.lidar_std, (ROWS, 2))
    stamps = (np.arange(ROWS) * STEP * 1e9).round().astype(np.int64)
    result = run(
        [Measurement(int(stamp), "lidar", z) for stamp, z in zip(stamps, seen, strict=True)], config
    )
    oracle = SomeNoises(config, seen[0])
    for k in range(1, ROWS):
        mean, covariance = oracle.step(seen[k], (stamps[k] - stamps[k - 1]) * 1e-9)
        np.testing.assert_allclose(result.states[k, :4], mean, atol=ORACLE)
        np.testing.assert_allclose(result.covariances[k, :4, :4], covariance, atol=ORACLE)


@pytest.fixture(scope="module")
def crowd():
    """Truth (TARGETS, ROWS, 4) and measurements."""
    rng = np.random.default_rng(9101)
    truth = np.array([switching(rng) for _ in range(TARGETS)])
    seen = truth[..., :2] + rng.normal(0, CONFIG.lidar_std, (TARGETS, ROWS, 2))
    stamps = (np.arange(ROWS) * STEP * 1e9).round().astype(np.int64)
    sensors = np.full(ROWS, "lidar")
    return truth, [Measurements.from_arrays(stamps, sensors, values) for values in seen]


def consistency(crowd, config):
    """Mean NEES per state, and the share of truth within the regions of 95 %."""
    truth, measured = crowd
    runs = run_batch(measured, config)
    wrong = np.array([one.states[SETTLED:, :4] for one in runs]) - truth[:, SETTLED:]
    covariances = np.array([one.covariances[SETTLED:, :4, :4] for one in runs])
    nees = np.einsum("...i,...ij,...j", wrong, np.linalg.inv(covariances), wrong)
    return nees.mean() / 4, (nees <= chi2_quantile(0.95, degrees=4)).mean()


def test_the_filter_is_consistent_where_targets_change_their_noise(crowd):
    """Goals: NEES of 0.9 to 1.1 per state, 92 to 98 % within the regions."""
    ratio, share = consistency(crowd, CONFIG)
    assert 0.9 < ratio < 1.1
    assert 0.92 < share < 0.98


@pytest.mark.parametrize("share", [1.0, 0.1])
def test_a_filter_with_one_of_the_noises_is_not(crowd, share):
    """The test above has the power to see it."""
    noise = share * CONFIG.acceleration_noise
    one = FusionConfig.load(
        {"model": "cv", "start_rows": 1, "acceleration_noise": noise, "lidar_std": (0.15, 0.1)}
        | OPEN
    )
    ratio, _ = consistency(crowd, one)
    assert not 0.9 < ratio < 1.1


@pytest.mark.parametrize("share", [0.0, 1.0, -0.1])
def test_a_share_of_the_noise_is_between_none_and_all(share):
    with pytest.raises(ConfigError, match="imm_quiet"):
        FusionConfig(imm_quiet=share)
