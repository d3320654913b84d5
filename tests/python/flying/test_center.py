"""The centre of a target: oracle, balls and drones, bad input."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lidar_core import flying, sim
from lidar_core.errors import ConfigError, InputError
from lidar_core.flying import target_center
from reference import center as reference

STEP = 0.0062  # between rays, as of 128 rows over 45 degrees [rad]
ORACLE = 1e-6  # the same steps in another order: rounding grows by the conditioning of the fit [m]


def fan(rng, center):
    """Directions of a grid of rays around `center`, not aligned with it."""
    grid = (np.arange(-45, 46) + rng.uniform(-0.5, 0.5)) * STEP
    up, aside = np.meshgrid(grid, grid, indexing="ij")
    rays = np.stack([np.ones_like(up), aside, up], axis=-1).reshape(-1, 3)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    ahead = center / np.linalg.norm(center)
    across = np.array([-ahead[1], ahead[0], 0.0]) / np.hypot(*ahead[:2])
    return rays @ np.stack([ahead, across, np.cross(ahead, across)])


def ball(rng, center, radius, noise=0.0):
    """Points on the near side of a ball, and rays that pass it."""
    rays = fan(rng, center)
    along = rays @ center
    inside = radius**2 - (center @ center - along**2)
    hit = inside >= 0
    ranges = along[hit] - np.sqrt(inside[hit]) + noise * rng.normal(size=hit.sum())
    return rays[hit] * ranges[:, None], rays[~hit]


def place(rng, low=5.0, high=20.0):
    azimuth, elevation = rng.uniform(-np.pi, np.pi), rng.uniform(-0.35, 0.35)
    return rng.uniform(low, high) * np.array(
        [
            np.cos(elevation) * np.cos(azimuth),
            np.cos(elevation) * np.sin(azimuth),
            np.sin(elevation),
        ]
    )


def assert_agrees(points, origin, passing, std):
    found = target_center(points, origin, passing_directions=passing, range_std=std)
    rays = reference.Rays(origin, passing)
    position, covariance, radius, _ = reference.target_center(points, origin, rays, std)
    np.testing.assert_allclose(found.position, position, rtol=0, atol=ORACLE)
    np.testing.assert_allclose(found.covariance, covariance, rtol=1e-4, atol=ORACLE)
    assert found.radius == pytest.approx(radius, abs=ORACLE)
    assert np.linalg.eigvalsh(found.covariance).min() > 0


@given(seed=st.integers(0, 10**6), radius=st.floats(0.1, 0.8), noise=st.sampled_from([0.0, 0.03]))
def test_the_oracle_agrees_on_balls(seed, radius, noise):
    rng = np.random.default_rng(seed)
    points, passing = ball(rng, place(rng), radius, noise)
    if len(points) > 0:
        origin = rng.normal(0, 30, 3)
        assert_agrees(points + origin, origin, passing, 0.03)


@given(seed=st.integers(0, 10**6), count=st.integers(1, 30))
def test_the_oracle_agrees_on_scattered_points(seed, count):
    rng = np.random.default_rng(seed)
    center = place(rng)
    rays = fan(rng, center)
    near = np.flatnonzero(rays @ center > np.sqrt(center @ center - 0.3**2))
    rows = rng.choice(near, min(count, len(near)), replace=False)
    points = rays[rows] * (np.linalg.norm(center) + rng.uniform(-0.3, 0.3, (len(rows), 1)))
    if len(points) > 0:
        assert_agrees(points, np.zeros(3), np.delete(rays, rows, axis=0), 0.03)


def test_balls_of_any_size_are_found_within_millimetres():
    rng = np.random.default_rng(0)
    errors, centroids = [], []
    for _ in range(200):
        center, radius = place(rng), rng.uniform(0.15, 0.6)
        points, passing = ball(rng, center, radius)
        if len(points) < 3:
            continue
        found = target_center(points, np.zeros(3), passing_directions=passing, range_std=0.03)
        errors.append(np.linalg.norm(found.position - center))
        centroids.append(np.linalg.norm(points.mean(axis=0) - center))
    assert len(errors) > 190
    assert np.mean(errors) < 0.003
    assert np.mean(centroids) > 0.2  # what eq. 19 gives


def test_the_covariance_of_noisy_balls_is_honest():
    rng = np.random.default_rng(1)
    squares = []
    for _ in range(300):
        center = place(rng)
        points, passing = ball(rng, center, rng.uniform(0.15, 0.6), noise=0.03)
        if len(points) >= 3:
            found = target_center(points, np.zeros(3), passing_directions=passing, range_std=0.03)
            e = found.position - center
            squares.append(e @ np.linalg.solve(found.covariance, e))
    # 3 if exact; the centre of a ball is given a floor for imperfect balls, so that it is less
    assert 0.5 < np.mean(squares) < 3.5
    assert np.mean(np.array(squares) < 11.34) > 0.97  # chi-square, 3 degrees of freedom, 0.99


def test_drones_are_found_nearer_to_their_centre_than_the_centroid():
    lidar = sim.LidarModel.preset("os1-128", ideal=True, snapshot=True, range_std=0.0)
    errors, centroids = [], []
    for seed in range(30):
        rng = np.random.default_rng(seed)
        center = place(rng)
        shape = sim.Hexacopter(radius=rng.uniform(0.25, 0.5))
        scene = sim.Scene(
            bodies=(),
            targets=(sim.Target(shape=shape, motion=sim.Hover(position=tuple(center))),),
            lidar=lidar,
            sensor=sim.Hover(position=(0.0, 0.0, 0.0)),
            scans=1,
        )
        made = next(sim.simulate(scene, seed=seed))
        hit = made.label >= 0
        if hit.sum() < 3:
            continue
        points = made.scan.points.reshape(-1, 3)[hit].astype(float)
        passing = made.scan.directions[~hit].astype(float)
        found = target_center(points, np.zeros(3), passing_directions=passing, range_std=0.03)
        errors.append(np.linalg.norm(found.position - center))
        centroids.append(np.linalg.norm(points.mean(axis=0) - center))
    assert len(errors) >= 25
    assert np.mean(errors) < 0.75 * np.mean(centroids)


def test_the_detector_reports_centres_and_the_paper_mode_centroids():
    config = flying.FlyingConfig()
    assert (config.position, config.tracker.measurement) == ("center", "center")
    paper = flying.FlyingConfig.paper()
    assert (paper.position, paper.tracker.measurement) == ("paper", "paper")


@pytest.mark.parametrize(
    ("values", "error", "text"),
    [
        ({"points_world": np.zeros((0, 3))}, InputError, r"points_world: expected shape \(N, 3\)"),
        ({"points_world": np.zeros((2, 4))}, InputError, r"points_world: expected shape"),
        ({"points_world": [[1, np.nan, 0]]}, InputError, r"points_world\[0\]"),
        ({"sensor_origin": [0, 0]}, InputError, "sensor_origin"),
        ({"sensor_origin": [0, np.inf, 0]}, InputError, "sensor_origin"),
        ({"passing_directions": [[1, 0, 0], [0, 0, 0]]}, InputError, r"passing\w*\[1\]"),
        ({"range_std": -1.0}, ConfigError, "range_std"),
        ({"range_std": np.nan}, ConfigError, "range_std"),
    ],
)
def test_bad_input_is_named(values, error, text):
    good = {
        "points_world": [[5, 0, 0], [5, 0.1, 0], [5, 0, 0.1]],
        "sensor_origin": [0, 0, 0],
        "passing_directions": [[1, 0.1, 0]],
        "range_std": 0.03,
    }
    with pytest.raises(error, match=text):
        target_center(**(good | values))
