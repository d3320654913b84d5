"""Oracle of interacting models: constant velocity with two noises, positions only.

Blom & Bar-Shalom, "The interacting multiple model algorithm", 1988, equation by equation.
"""

import numpy as np

from reference.fusion_many import gaussian_step

LEAST = 1e-6


class TwoNoises:
    """As a filter with `method="imm"`, `imm_models=("cv",)`, `imm_quiet` and `start_rows=1`."""

    def __init__(self, config, first):
        self.config = config
        spread = np.repeat([config.initial_position**2, config.initial_speed**2], 2)
        state = (np.array([*first, 0.0, 0.0]), np.diag(spread))
        self.states, self.weights = [state, state], np.array([0.5, 0.5])
        loud = config.acceleration_noise
        self.densities = [loud**2, (config.imm_quiet * loud) ** 2]

    def step(self, z, dt):
        """Mean and covariance after a measurement."""
        stay = np.exp(-dt / self.config.imm_sojourn)
        chain = np.array([[stay, 1 - stay], [1 - stay, stay]])  # from, to
        before = chain * self.weights[:, None]
        after = before.sum(axis=0)
        mixed = [mixture(before[:, to] / after[to], self.states) for to in (0, 1)]
        noise = np.diag(np.square(self.config.lidar_std))
        logs = np.log(after)
        for mode, state in enumerate(mixed):
            mean, cov = gaussian_step(*state, dt, self.densities[mode])
            y, spread = z - mean[:2], cov[:2, :2] + noise
            gain = cov[:, :2] @ np.linalg.inv(spread)
            self.states[mode] = (mean + gain @ y, cov - gain @ cov[:2])
            logs[mode] -= 0.5 * (y @ np.linalg.solve(spread, y) + np.log(np.linalg.det(spread)))
        weights = np.exp(logs - logs.max())
        weights = np.maximum(weights / weights.sum(), LEAST)
        self.weights = weights / weights.sum()
        return mixture(self.weights, self.states)


def mixture(weights, states):
    """Moments of Gaussians with weights."""
    mean = sum(weight * state for weight, (state, _) in zip(weights, states, strict=True))
    spread = [
        weight * (cov + np.outer(state - mean, state - mean))
        for weight, (state, cov) in zip(weights, states, strict=True)
    ]
    return mean, sum(spread)
