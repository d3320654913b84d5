"""The semantic map: against the oracle, against the truth, and against bad input."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lidar_core.circles import CircleMap, CircleMapConfig
from lidar_core.errors import ConfigError, InputError
from reference import circle_map as oracle

STEP_NS = 50_000_000  # 20 Hz
HERE = np.eye(4)
R = np.diag([4e-5, 4e-5, 1e-5])
BEST = CircleMapConfig()
PAPER = CircleMapConfig.paper()
ORACLE_TOLERANCE = 1e-8  # relative
LIMITS = (0.1, 10.0)


def feed(circles, step, *rows, **more):
    covariance = np.broadcast_to(R, (len(rows), 3, 3))
    rows = np.reshape(rows, (-1, 3))
    return circles.update(rows, covariance, HERE, step * STEP_NS, **more)


# --- against the oracle ---------------------------------------------------------------------------


def pose_at(x, y, alpha, beta, gamma):
    pose = np.eye(4)
    pose[:3, :3] = oracle.turn(alpha, beta, gamma)
    pose[:3, 3] = x, y, 1.0
    return pose


def random_scans(seed, count):
    """Circles that move, turn, vanish and come twice, seen by a sensor that moves and tilts."""
    rng = np.random.default_rng(seed)
    n = rng.integers(1, 5)
    center, velocity = rng.uniform(-4, 4, (n, 2)), rng.uniform(-1.5, 1.5, (n, 2))
    radius = rng.uniform(0.1, 0.5, n)
    stamp = 0
    for step in range(count):
        dt = float(rng.choice([0.05, 0.05, 0.1, 0.37]))
        stamp += round(dt * 1e9)
        velocity = np.where(rng.random((n, 1)) < 0.05, -velocity, velocity)
        center = center + dt * velocity
        pose = pose_at(0.1 * step, -0.05 * step, *rng.uniform(-0.3, 0.3, 3))
        found = rng.random(n) < 0.8
        level = (center[found] - pose[:2, 3]) @ oracle.rotation(oracle.level_pose(pose)[1])
        z = np.c_[level, radius[found]]
        twice = z[rng.random(len(z)) < 0.1] + [0.1, 0.1, 0.0]
        false = np.c_[rng.uniform(-5, 5, (1, 2)), 0.2][: rng.integers(0, 2)]
        z = np.concatenate([z, twice, false])
        A = rng.normal(size=(len(z), 3, 3)) * 0.004
        R = A @ A.transpose(0, 2, 1) + 1e-5 * np.eye(3)
        z = z + np.einsum("nij,nj->ni", np.linalg.cholesky(R), rng.normal(size=z.shape))
        z[:, 2] = np.maximum(z[:, 2], 0.02)
        doubt = np.diag([1e-4, 1e-4, 1e-4, 1e-5, 1e-5, 1e-5]) if rng.random() < 0.5 else None
        bearings = np.linspace(-2.4, 2.4, 400)
        ranges = np.where(rng.random(400) < 0.05, np.nan, rng.choice([0.8, 3.0, np.inf], 400))
        ranges[100:300] = rng.choice([1.0, 4.0, np.inf])
        yield z, R, pose, stamp, doubt, ranges, bearings


def assert_same_map(circles, reference, stamp):
    got, expected = circles.map_at(stamp), reference.at(stamp)
    assert got.id.tolist() == [number for number, _, _ in expected]
    for row, (_, x, P) in enumerate(expected):
        mean = np.r_[got.center[row], got.velocity[row], got.radius[row]]
        np.testing.assert_allclose(mean, x, rtol=0, atol=ORACLE_TOLERANCE * np.abs(x).max())
        np.testing.assert_allclose(
            got.covariance[row], P, rtol=0, atol=ORACLE_TOLERANCE * np.abs(P).max()
        )


@pytest.mark.parametrize("seed", range(4))
def test_the_joint_filter_equals_the_oracle(seed):
    config = CircleMapConfig.paper(velocity_step=0.3)
    circles, reference = CircleMap(config), oracle.JointMap(config)
    for z, R, pose, stamp, doubt, _, _ in random_scans(2000 + seed, 30):
        events = circles.update(z, R, pose, stamp, pose_covariance=doubt)
        assert events.elements.tolist() == reference.update(z, R, pose, stamp, doubt)
        assert_same_map(circles, reference, stamp)
        assert_same_map(circles, reference, stamp + 30_000_000)


@pytest.mark.ci_cases("1")
@pytest.mark.parametrize(
    "seed", [1, 3, *(pytest.param(seed, marks=pytest.mark.nightly) for seed in (0, 2))]
)
def test_filters_per_element_equal_the_oracle(seed):
    config = CircleMapConfig(max_coast=1.0, max_position_std=0.5)
    circles, reference = CircleMap(config), oracle.IndependentMap(config)
    for z, R, pose, stamp, doubt, ranges, bearings in random_scans(3000 + seed, 30):
        look = oracle.looker(ranges, bearings, LIMITS, config, pose)
        events = circles.update(
            z, R, pose, stamp, pose_covariance=doubt, scan=(ranges, bearings), range_limits=LIMITS
        )
        assert events.elements.tolist() == reference.update(
            z,
            R,
            pose,
            stamp,
            doubt,
            look,
            oracle.area_of(ranges, bearings, LIMITS),
            np.diff(bearings).mean(),
        )
        assert_same_map(circles, reference, stamp)
        assert_same_map(circles, reference, stamp + 230_000_000)


# --- what it does ---------------------------------------------------------------------------------


@pytest.mark.parametrize("config", [BEST, PAPER])
def test_asking_changes_nothing(config):
    asked, quiet = CircleMap(config), CircleMap(config)
    for step in range(20):
        for circles in (asked, quiet):
            feed(circles, step, [3 + 0.05 * step, 1.0, 0.3])
        for ahead in (0, 7, 1_000_000_000):
            asked.map_at(step * STEP_NS + ahead)
    for stamp in (19 * STEP_NS, 25 * STEP_NS):
        one, other = asked.map_at(stamp), quiet.map_at(stamp)
        assert one.id.tolist() == other.id.tolist() == [0]
        assert (one.covariance == other.covariance).all()
        assert (one.center == other.center).all()


def test_two_scanners_may_share_a_stamp():
    circles = CircleMap()
    for step in range(6):
        feed(circles, step, [3.0, 1.0, 0.3])
        feed(circles, step, [3.0, 1.0, 0.3], sensor=1)
    assert circles.map_at(6 * STEP_NS).id.tolist() == [0]
    with pytest.raises(InputError, match="it was processed"):
        feed(circles, 5, sensor=1)


@pytest.mark.parametrize("config", [BEST, PAPER])
def test_an_element_without_a_radius_goes(config):
    circles, loose = CircleMap(config), 1e-2 * np.eye(3)
    bound = loose.copy()
    bound[0, 2] = bound[2, 0] = 9e-3  # what is nearer looks smaller
    circles.update([[3.0, 0.0, 0.01]], [loose], HERE, 0)
    events = circles.update([[3.2, 0.0, 0.01]], [bound], HERE, STEP_NS)
    assert (events.elements.tolist(), events.removed.tolist()) == ([0], [0])


def test_modes_at_the_ends_of_their_ranges_keep_the_map_sound():
    for weights, times in [((1e6, 1e-6), (1e-3, 1e6)), ((1e-6, 1e6), (1e-3, 1e-3))]:
        modes = tuple(zip((0.0, 10.0), weights, times, strict=True))
        config = CircleMapConfig(modes=modes)
        circles = CircleMap(config)
        for step in range(40):
            feed(circles, step, [3.0, 0.01 * step, 0.3])
        np.testing.assert_allclose(circles.map_at(39 * STEP_NS).center, [[3.0, 0.39]], atol=0.05)


# --- scans that come late -------------------------------------------------------------------------


@settings(max_examples=25, deadline=None)
@given(st.data())
def test_the_order_of_arrival_does_not_matter(data):
    count, reach = 14, 4  # scans may be overtaken by as many as the buffer holds
    delays = [data.draw(st.integers(0, reach)) for _ in range(count)]
    order = sorted(range(count), key=lambda step: (step and step + delays[step], step))
    straight, mixed = CircleMap(), CircleMap()
    for circles, steps in ((straight, range(count)), (mixed, order)):
        for step in steps:
            rows = [[3 + 0.04 * step, 1, 0.3], [5, -0.05 * step, 0.2], [2, 3 - 0.03 * step, 0.4]]
            feed(circles, step, *rows[: 2 if step < 6 else 3])
    one, other = straight.map_at(count * STEP_NS), mixed.map_at(count * STEP_NS)
    assert one.id.tolist() == other.id.tolist() == [0, 1, 2]
    assert (one.center == other.center).all()
    assert (one.covariance == other.covariance).all()


def test_merges_that_a_late_scan_brings_are_told():
    circles = CircleMap(CircleMapConfig(merge_gap=0.1, buffer_time=1.0))
    for step in range(5):
        feed(circles, step, [3.0, 0.0, 0.3], [3.0, 0.8, 0.3])
    feed(circles, 7)
    events = feed(circles, 5, [3.0, 0.04, 0.3], [3.0, 0.76, 0.3])  # they touch at step 7
    assert events.is_late
    assert events.elements.tolist() == [0, 1]
    assert (events.merged.tolist(), events.removed.tolist()) == ([[0, 1]], [1])
    assert feed(circles, 8).merged.tolist() == []


# --- bad input ------------------------------------------------------------------------------------


@pytest.mark.parametrize("config", [BEST, PAPER])
@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"circles": [[np.nan, 0, 0.3]]}, "circles: expected finite"),
        ({"circles": [[3, 0, -0.3]]}, "a radius > 0"),
        ({"circles": [[3, 0]]}, "expected shape"),
        ({"covariance": [-np.eye(3)]}, "symmetric positive definite"),
        ({"covariance": [np.eye(3) + np.eye(3, k=1)]}, "symmetric positive definite"),
        ({"covariance": [np.eye(2)]}, "expected shape"),
        ({"world_from_lidar": 2 * np.eye(4)}, "expected a finite rotation"),
        ({"stamp_ns": 1.5}, "expected an integer"),
        ({"stamp_ns": 0}, "scan of 0 ns"),
        ({"pose_covariance": -np.eye(6)}, "pose_covariance"),
        ({"pose_covariance": np.eye(3)}, "expected shape"),
        ({"scan": ([1.0, 2.0], [0.0])}, "bearings"),
        ({"scan": ([1.0], [np.nan])}, "bearings"),
        ({"scan": ([1.0], [0.0]), "range_limits": (2.0, 1.0)}, "range_limits"),
        ({"scan": ([1.0],)}, "scan: expected"),
        ({"scan": ([-1.0], [0.0])}, "ranges: expected no values < 0"),
        ({"scan": ([1.0], [0.0]), "range_limits": "ab"}, "range_limits: expected two numbers"),
        ({"delays": [1e300]}, "delays"),
        ({"sensor": -1}, "sensor"),
    ],
)
def test_refused_calls_change_nothing(config, change, text):
    circles = CircleMap(config)
    for step in range(8):
        feed(circles, step, [3.0, 1.0, 0.3])
    before = circles.map_at(8 * STEP_NS)
    call = {
        "circles": [[3.0, 1.0, 0.3]],
        "covariance": [R],
        "world_from_lidar": HERE,
        "stamp_ns": 8 * STEP_NS,
        **change,
    }
    with pytest.raises(InputError, match=text):
        circles.update(**call)
    after = circles.map_at(8 * STEP_NS)
    assert (before.center == after.center).all()
    assert (before.covariance == after.covariance).all()
    assert feed(circles, 8, [3.0, 1.0, 0.3]).elements.tolist() == [0]


@pytest.mark.parametrize(
    "values",
    [
        {"report_existence": 1.0},
        {"modes": ()},
        {"modes": ((0.1, 1.0, 0.0),)},
        {"modes": ((0.1, 1.0, 1e-300),)},
        {"modes": ((0.1, 1.0, 1.0), (0.1, 1e-17, 1.0))},
        {"modes": ((0.1, 1e308, 1.0), (0.1, 1.0, 1.0))},
        {"modes": ((0.1, 1.0, 1.0), (-1.0, 1.0, 1.0))},
        {"filter": "paper", "velocity_step": 1e200},
        {"filter": "joint"},
        {"gate_probability": 1.0},
    ],
)
def test_impossible_settings_are_refused(values):
    with pytest.raises(ConfigError):
        CircleMapConfig(**values)
