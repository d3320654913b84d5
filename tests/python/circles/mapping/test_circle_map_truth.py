"""The semantic map against the truth: consistency, trajectories, occlusions, sudden turns."""

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.stats import chi2

from lidar_core.circles import CircleMap, CircleMapConfig
from reference import circle_map as oracle

STEP = 0.05  # 20 Hz
STEP_NS = 50_000_000
HERE = np.eye(4)
LIMITS = (0.1, 10.0)
BEARINGS = np.deg2rad(np.arange(-135, 135.1, 0.25))
RANGE_STD = 0.01


def ranges_of(circles):
    """What a scanner at the origin measures of circles (x, y, r), without noise."""
    ranges = np.full(len(BEARINGS), np.inf)
    for x, y, radius in circles:
        along = x * np.cos(BEARINGS) + y * np.sin(BEARINGS)
        inside = radius**2 - (x**2 + y**2 - along**2)
        hit = (inside > 0) & (along > 0)
        ranges[hit] = np.minimum(ranges[hit], along[hit] - np.sqrt(inside[hit]))
    return ranges


def single_scan_covariance(center, radius):
    """Of a fit to all rays that meet a circle, and to the rays beside it."""
    d, beta = np.hypot(*center), np.arctan2(center[1], center[0])
    alpha, step = np.arcsin(radius / d), np.deg2rad(0.25)
    psi = np.arange(np.ceil((beta - alpha) / step), (beta + alpha) / step) * step
    p = center[0] * np.sin(psi) - center[1] * np.cos(psi)
    q = np.sqrt(np.maximum(radius**2 - p**2, 1e-6))
    J = np.c_[np.cos(psi) + p / q * np.sin(psi), np.sin(psi) - p / q * np.cos(psi), -radius / q]
    information = J.T @ J / RANGE_STD**2
    for side in (-1, 1):
        turn = np.array([-center[1], center[0]]) / d**2
        grow = np.array([-radius * center[0], -radius * center[1], d**2]) / (d**3 * np.cos(alpha))
        edge = np.r_[turn, 0] + side * grow
        information += np.outer(edge, edge) / (step**2 / 12)
    covariance = np.linalg.inv(information)
    return (covariance + covariance.T) / 2


def measure(rng, center, radius):
    R = single_scan_covariance(center, radius)
    return np.r_[center, radius] + rng.multivariate_normal(np.zeros(3), R), R


# --- trajectories of section VI -------------------------------------------------------------------


def line(t, v):
    return np.c_[np.full_like(t, 4.0), -5 + v * t]


def circle(t, v):
    return np.c_[4 + 2 * np.cos(v / 2 * t), 2 * np.sin(v / 2 * t)]


def eight(t, v):
    w = v / 3.536
    return np.c_[4 + 1.25 * np.sin(2 * w * t), 2.5 * np.sin(w * t)]


def stop_and_go(t, v):
    u = t % 6
    way = v * np.interp(u, [0, 1, 3, 4], [0, 0.5, 2.5, 3])
    way = np.where(
        u < 1, v * u**2 / 2, np.where((u > 3) & (u < 4), v * (3 - (4 - u) ** 2 / 2), way)
    )
    return np.c_[np.full_like(t, 4.0), -3 * v + np.where(t // 6 % 2 == 0, way, 3 * v - way)]


def reflected(t, v):
    """Random accelerations between walls that turn the velocity round at once."""
    rng = np.random.default_rng(4000)
    h, low, high = 0.005, np.array([1.5, -4.0]), np.array([7.0, 4.0])
    p, u, places = np.array([4.0, 0.0]), v / np.sqrt(2) * rng.normal(size=2), []
    for _ in range(round(t[-1] / h) + 1):
        places.append(p)
        after = np.exp(-h / 2) * u + np.sqrt(1 - np.exp(-h)) * v / np.sqrt(2) * rng.normal(size=2)
        p, u = p + h * (u + after) / 2, after
        u = np.where((p < low) | (p > high), -u, u)
        p = np.clip(2 * np.clip(p, low, high) - p, low, high)
    return np.array(places)[:: round(STEP / h)]


@pytest.mark.parametrize("radius", [0.1, 0.3, 0.6])
@pytest.mark.parametrize("way", [line, circle, eight, stop_and_go, reflected])
def test_errors_on_the_trajectories_stay_small(way, radius):
    t = np.arange(0, 6.7 if way is line else 15.0, STEP)
    rng = np.random.default_rng(4100)
    circles, errors = CircleMap(), []
    for k, place in enumerate(way(t, 1.5)):
        z, R = measure(rng, place, radius)
        circles.update([z], [R], HERE, k * STEP_NS)
        now = circles.map_at(k * STEP_NS)
        if t[k] >= 2:
            assert now.id.tolist() == [0]
            errors.append(np.r_[now.center[0], now.radius] - [*place, radius])
    errors = np.array(errors)
    assert np.hypot(*errors[:, :2].T).max() <= 0.03
    assert np.abs(errors[:, 2]).max() <= 0.006
    assert (errors[:, :2] ** 2).mean(axis=0).max() <= 1e-4
    assert (errors[:, 2] ** 2).mean() <= 3e-6


# --- consistency ----------------------------------------------------------------------------------


def normalised_errors(config, runs, steps, seed):
    """NEES of runs drawn from the filter's own model, the pose's error included.

    Of position and radius, and of the velocity: two arrays. Standing targets have no error of the
    velocity, so that its NEES is below 2 on average.
    """
    rng = np.random.default_rng(seed)
    model = oracle.IndependentMap(config)
    weight, switching = model.weight, expm(model.rates * STEP)
    doubt = np.diag([1e-4, 1e-4, 1e-4, 1e-6, 1e-6, 1e-5])
    noise = [model.noise(mode, STEP) for mode in range(len(weight))]
    nees = np.full((2, runs, steps), np.nan)
    for run in range(runs):
        circles = CircleMap(config)
        speed = config.initial_speed * rng.normal(size=2)
        x = np.r_[rng.uniform(2, 6), rng.uniform(-3, 3), speed, rng.uniform(0.1, 0.5)]
        mode = rng.choice(len(weight), p=weight)
        x[2:4] *= mode > 0
        for step in range(steps):
            if step:
                before, row = mode, switching[mode]
                mode = rng.choice(len(weight), p=row / row.sum())
                if mode == 0:
                    x[2:4] = 0.0
                elif before == 0:
                    x[2:4] = config.start_speed * rng.normal(size=2)
                w = rng.multivariate_normal(np.zeros(5), noise[mode], method="eigh")
                x = oracle.transition(STEP) @ x + w
            A = rng.normal(size=(3, 3)) * 0.004
            R = A @ A.T + 2e-6 * np.eye(3)
            wrong = rng.multivariate_normal(np.zeros(6), doubt)
            z = np.r_[oracle.rotation(wrong[5]).T @ (x[:2] - wrong[:2]), x[4]]
            z += rng.multivariate_normal(np.zeros(3), R)
            circles.update([z], [R], HERE, step * STEP_NS, pose_covariance=doubt)
            now = circles.map_at(step * STEP_NS)
            if len(now):
                error = np.r_[now.center[0], now.velocity[0], now.radius[0]] - x
                for row, of in enumerate(([0, 1, 4], [2, 3])):
                    P = now.covariance[0][np.ix_(of, of)]
                    nees[row, run, step] = error[of] @ np.linalg.solve(P, error[of])
    return nees[:, :, 3:]


@pytest.mark.nightly
def test_covariances_are_honest():
    nees, speed = normalised_errors(CircleMapConfig(), runs=60, steps=50, seed=4200)
    assert not np.isnan(nees).any()
    low, high = chi2.ppf([0.025, 0.975], 3 * len(nees)) / len(nees)
    mean = nees.mean(axis=0)
    assert ((mean >= low) & (mean <= high)).mean() >= 0.85
    assert 0.5 <= speed.mean() <= 2.2


# --- occlusions -----------------------------------------------------------------------------------


def random_way(rng, steps):
    """A way with random accelerations that stays within range and field of view."""
    while True:
        angle, speed = rng.uniform(0, 2 * np.pi), rng.uniform(0, 1.2)
        start = np.array([rng.uniform(3, 7), rng.uniform(-3, 3)])
        change = np.cumsum(0.3 * np.sqrt(STEP) * rng.normal(size=(steps, 2)), axis=0)
        velocity = speed * np.array([np.cos(angle), np.sin(angle)]) + change
        way = start + STEP * np.cumsum(velocity, axis=0)
        distance = np.hypot(*way.T)
        if (distance > 2).all() and (distance < 9).all() and (way[:, 0] > 0).all():
            return way


def is_kept_through_an_occlusion(seed, hidden=(60, 100), steps=120):
    """A target of random way, hidden for 2 s by something that passes in front."""
    rng = np.random.default_rng(seed)
    radius = rng.uniform(0.15, 0.4)
    circles, ids = CircleMap(), []
    for k, center in enumerate(random_way(rng, steps)):
        is_hidden = hidden[0] <= k < hidden[1]
        screen = [(*(0.5 * center), 0.5 * radius + 0.3)] if is_hidden else []
        z, R = measure(rng, center, radius)
        scan = (ranges_of([(*center, radius), *screen]), BEARINGS)
        rows = 0 if is_hidden else 1
        circles.update(
            z[None][:rows], R[None][:rows], HERE, k * STEP_NS, scan=scan, range_limits=LIMITS
        )
        ids.append(circles.map_at(k * STEP_NS).id.tolist())
    return ids[hidden[0] - 1] == ids[-1] and len(ids[-1]) == 1


@pytest.mark.nightly
def test_identities_survive_an_occlusion_of_two_seconds():
    assert sum(is_kept_through_an_occlusion(4300 + case) for case in range(40)) >= 38


def test_what_comes_back_into_view_piece_by_piece_keeps_its_number():
    """After 4 s the place is known to 1 m at best; then rays meet it that give no circle yet."""
    circles, rng = CircleMap(), np.random.default_rng(4350)
    post, screen = (6.0, 0.5, 0.25), (3.0, 0.25, 0.4)
    none = np.empty((0, 3)), np.empty((0, 3, 3))
    for k in range(40 + 85 + 8 + 3):
        z, R = measure(rng, np.array(post[:2]), post[2])
        is_hidden, is_piece = 40 <= k < 125, 125 <= k < 133
        scan = (ranges_of([post, screen] if is_hidden else [post]), BEARINGS)
        seen = none if is_hidden or is_piece else ([z], [R])
        circles.update(*seen, HERE, k * STEP_NS, scan=scan, range_limits=LIMITS)
        if k == 124:
            assert len(circles.map_at(k * STEP_NS)) == 0  # known to less than 1 m
    assert circles.map_at(136 * STEP_NS).id.tolist() == [0]


def test_what_is_gone_goes_within_half_a_second():
    circles, rng = CircleMap(), np.random.default_rng(4400)
    for k in range(40):
        z, R = measure(rng, [4.0, 1.0], 0.3)
        circles.update([z], [R], HERE, k * STEP_NS)
    for k in range(40, 50):
        scan = (ranges_of([]), BEARINGS)
        none = np.empty((0, 3)), np.empty((0, 3, 3))
        circles.update(*none, HERE, k * STEP_NS, scan=scan, range_limits=LIMITS)
    assert len(circles.map_at(50 * STEP_NS)) == 0
