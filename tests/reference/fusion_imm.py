"""Oracle of interacting models: constant velocity with two noises, and standing; positions only.

Blom & Bar-Shalom, "The interacting multiple model algorithm", 1988, equation by equation.
"""

import numpy as np

from reference.fusion_many import gaussian_step

LEAST = 1e-6
STANDS, STOPS, REST, OF_NEW = 300.0, 0.1, 0.02, 0.3


class SomeNoises:
    """As a filter with `method="imm"`, `imm_models`, `imm_quiet` and `start_rows=1`.

    The models are "cv", and its quiet copy, and between them "standing" if the filter has it.
    """

    def __init__(self, config, first):
        self.config = config
        loud = config.acceleration_noise
        self.densities = [loud**2, (config.imm_quiet * loud) ** 2]
        if "standing" in config.imm_models:
            self.densities.insert(1, None)
        spread = np.repeat([config.initial_position**2, config.initial_speed**2], 2)
        state = (np.array([*first, 0.0, 0.0]), np.diag(spread))
        self.states = [at_rest(*state) if q is None else state for q in self.densities]
        self.weights = np.array([OF_NEW if q is None else 1.0 for q in self.densities])
        self.weights = self.weights / self.weights.sum()

    def tendencies(self, cov):
        widest = max(cov[0, 0], cov[1, 1])
        stops = STOPS * min(1, self.config.initial_position**2 / widest)
        return np.array([stops if density is None else 1.0 for density in self.densities])

    def chain(self, dt):
        """Probabilities of changes within `dt`, from (row) and to (column)."""
        count = len(self.densities)
        chain = np.zeros((count, count))
        for row, density in enumerate(self.densities):
            stay = np.exp(-dt / (STANDS if density is None else self.config.imm_sojourn))
            others = self.tendencies(self.states[row][1]) * (np.arange(count) != row)
            chain[row] = (1 - stay) * others / others.sum()
            chain[row, row] = stay
        return chain

    def step(self, z, dt):
        """Mean and covariance after a measurement."""
        before = self.chain(dt) * self.weights[:, None]
        after = before.sum(axis=0)
        mixed = [mixture(before[:, k] / after[k], self.states) for k in range(len(after))]
        noise = np.diag(np.square(self.config.lidar_std))
        logs = np.log(after)
        for mode, state in enumerate(mixed):
            mean, cov = self.predicted(mode, *state, dt)
            y, spread = z - mean[:2], cov[:2, :2] + noise
            gain = cov[:, :2] @ np.linalg.inv(spread)
            self.states[mode] = (mean + gain @ y, cov - gain @ cov[:2])
            logs[mode] -= 0.5 * (y @ np.linalg.solve(spread, y) + np.log(np.linalg.det(spread)))
        weights = np.exp(logs - logs.max())
        weights = np.maximum(weights / weights.sum(), LEAST)
        self.weights = weights / weights.sum()
        return mixture(self.weights, self.states)

    def predicted(self, mode, mean, cov, dt):
        if self.densities[mode] is not None:
            return gaussian_step(mean, cov, dt, self.densities[mode])
        mean, cov = at_rest(mean, cov)
        shaken = dt * (REST * self.config.acceleration_noise) ** 2
        return mean, cov + np.diag([shaken, shaken, 0.0, 0.0])


def at_rest(mean, cov):
    """The same place without a velocity."""
    place = np.diag([1.0, 1.0, 0.0, 0.0])
    return place @ mean, place @ cov @ place


def mixture(weights, states):
    """Moments of Gaussians with weights."""
    mean = sum(weight * state for weight, (state, _) in zip(weights, states, strict=True))
    spread = [
        weight * (cov + np.outer(state - mean, state - mean))
        for weight, (state, cov) in zip(weights, states, strict=True)
    ]
    return mean, sum(spread)
