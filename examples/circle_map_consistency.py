"""How honest the map of circles is: targets drawn from its own model, 500 or as many as told."""

import sys

import numpy as np

from lidar_core.circles import CircleMap, CircleMapConfig
from lidar_core.estimation import chi2_quantile

SEED, STEPS, STEP = 0, 100, 0.05  # [s]
POSE_VARIANCE = np.diag([1e-4, 1e-4, 1e-4, 1e-6, 1e-6, 1e-5])  # [m^2], [rad^2]


def switching(config: CircleMapConfig) -> np.ndarray:
    """Probabilities of the modes after a step, by the mode before; the first is standing."""
    _, weight, times = np.array(config.modes).T
    weight = weight / weight.sum()
    rates = np.zeros((len(weight) + 1, len(weight) + 1))
    rates[1:, 1:] = weight / (1 - weight)[:, None] / times[:, None]
    rates[1:, 0], rates[0, 1:] = 1 / config.moving_time, weight / config.standing_time
    np.fill_diagonal(rates, 0.0)
    np.fill_diagonal(rates, -rates.sum(axis=1))
    values, vectors = np.linalg.eig(rates * STEP)
    return np.real(vectors @ np.diag(np.exp(values)) @ np.linalg.inv(vectors))


def noise(config: CircleMapConfig, mode: int) -> np.ndarray:
    """Covariance of x, y, their velocities and the radius, gained in a step."""
    block = [[STEP**3 / 3, STEP**2 / 2], [STEP**2 / 2, STEP]]
    both = np.zeros((5, 5))
    if mode:
        both[:4, :4] = np.kron(block, np.eye(2)) * config.modes[mode - 1][0]
    else:
        both[:2, :2] = np.eye(2) * config.standing_noise * STEP
    both[4, 4] = config.radius_noise * STEP
    return both


def run(config: CircleMapConfig, rng: np.random.Generator) -> np.ndarray:
    """Normalised squared error of the element of one target, step by step."""
    modes, nees = switching(config), np.full(STEPS, np.nan)
    share, weight = config.standing_share, np.array(config.modes)[:, 1]
    weight = np.r_[share, (1 - share) * weight / weight.sum()]
    mode = rng.choice(len(weight), p=weight)
    velocity = config.initial_speed * rng.normal(size=2)
    state = np.r_[rng.uniform(2, 6), rng.uniform(-3, 3), velocity, rng.uniform(0.1, 0.5)]
    state[2:4] *= mode > 0
    circles = CircleMap(config)
    for step in range(STEPS):
        if step:
            before, row = mode, modes[mode]
            mode = rng.choice(len(weight), p=row / row.sum())
            if not (mode and before):  # what stops has no velocity, what starts has any
                speed = config.start_speed if mode else 0.0
                state[2:4] = speed * rng.normal(size=2) if mode != before else state[2:4]
            state[:2] += STEP * state[2:4]
            state += rng.multivariate_normal(np.zeros(5), noise(config, mode), method="eigh")
        root = rng.normal(size=(3, 3)) * 0.004
        covariance = root @ root.T + 2e-6 * np.eye(3)
        wrong = rng.multivariate_normal(np.zeros(6), POSE_VARIANCE)  # the pose is not the true one
        cosine, sine = np.cos(wrong[5]), np.sin(wrong[5])
        x, y = state[:2] - wrong[:2]
        circle = np.array([cosine * x + sine * y, cosine * y - sine * x, state[4]])
        circle += rng.multivariate_normal(np.zeros(3), covariance)
        stamp_ns = round(step * STEP * 1e9)
        circles.update([circle], [covariance], np.eye(4), stamp_ns, pose_covariance=POSE_VARIANCE)
        now = circles.map_at(stamp_ns)
        if len(now):
            error = np.r_[now.center[0], now.radius[0]] - state[[0, 1, 4]]
            P = now.covariance[0][np.ix_([0, 1, 4], [0, 1, 4])]
            nees[step] = error @ np.linalg.solve(P, error)
    return nees[3:]  # before, it may not be reported


def main(runs: int) -> None:
    """Print the share of steps whose mean lies in the 95 % band, and the mean, expected at 3."""
    config, rng = CircleMapConfig(), np.random.default_rng(SEED)
    mean = np.array([run(config, rng) for _ in range(runs)]).mean(axis=0)
    low, high = (chi2_quantile(share, degrees=3 * runs) / runs for share in (0.025, 0.975))
    print(f"runs: {runs}")
    print(f"steps in the 95 % band: {((mean >= low) & (mean <= high)).mean():.3f}")
    print(f"mean: {mean.mean():.2f}")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 500)
