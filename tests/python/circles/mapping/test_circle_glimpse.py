"""What a ray or two still end on: too few to measure it, but it has not moved."""

import numpy as np
import pytest

from lidar_core.circles import CircleMap, CircleMapConfig
from reference import circle_map as oracle

STEP_NS = 100_000_000  # 10 Hz
LIMITS = (0.1, 10.0)
BEARINGS = np.deg2rad(np.arange(-90.0, 90.0, 1.0))
RADIUS = 0.05
R = np.diag([4e-5, 4e-5, 1e-5])


def pose_at(x, y):
    pose = np.eye(4)
    pose[:2, 3] = x, y
    return pose


def ranges_from(place, posts):
    """Ranges of a scanner at `place` that looks along x among round posts."""
    ranges = np.full(len(BEARINGS), np.inf)
    for post in posts:
        x, y = np.asarray(post) - place
        aside = np.hypot(x, y) * np.sin(BEARINGS - np.arctan2(y, x))
        along = np.hypot(x, y) * np.cos(BEARINGS - np.arctan2(y, x))
        depth = np.sqrt(np.maximum(RADIUS**2 - aside**2, 0.0))
        meets = (np.abs(aside) < RADIUS) & (along > 0)
        ranges = np.where(meets, np.minimum(ranges, along - depth), ranges)
    return ranges


class Drive:
    """A scanner that measures what four rays meet, and gives its scans to a map."""

    def __init__(self, seed, **config):
        self.rng, self.step = np.random.default_rng(seed), 0
        self.config = CircleMapConfig(**config)
        self.map = CircleMap(self.config)

    def scan(self, place, posts):
        ranges = ranges_from(place, posts) + self.rng.normal(0, 0.005, len(BEARINGS))
        measured = [
            [*(np.asarray(post) - place + self.rng.normal(0, 0.005, 2)), RADIUS]
            for post in posts
            if (ranges_from(place, [post]) < np.inf).sum() >= 4
        ]
        rows = np.reshape(measured, (-1, 3))
        given = (
            rows,
            np.broadcast_to(R, (len(rows), 3, 3)),
            pose_at(*place),
            self.step * STEP_NS,
        )
        self.step += 1
        return given, ranges

    def see(self, place, posts):
        given, ranges = self.scan(np.asarray(place), posts)
        return self.map.update(*given, scan=(ranges, BEARINGS), range_limits=LIMITS)

    def now(self):
        return self.map.map_at((self.step - 1) * STEP_NS)


@pytest.mark.ci_cases("1001")
@pytest.mark.parametrize("seed", [1000, 1001, 1002])
def test_glimpses_equal_the_oracle(seed):
    drive = Drive(seed)
    reference = oracle.IndependentMap(drive.config)
    posts = [np.array([1.0, y]) + drive.rng.uniform(-0.1, 0.1, 2) for y in (-0.4, 0.1, 0.6)]
    for step in range(70):
        if step == 45:
            posts.pop()  # taken away while only a ray or two end on it
        place = np.array([-max(0.0, 0.12 * (step - 20)), 0.02 * step])
        (z, noise, pose, stamp), ranges = drive.scan(place, posts)
        events = drive.map.update(
            z, noise, pose, stamp, scan=(ranges, BEARINGS), range_limits=LIMITS
        )
        look = oracle.looker(ranges, BEARINGS, LIMITS, drive.config, pose)
        area = oracle.area_of(ranges, BEARINGS, LIMITS)
        spacing = np.diff(BEARINGS).mean()
        assert events.elements.tolist() == reference.update(
            z, noise, pose, stamp, None, look, area, spacing
        )
        got, expected = drive.map.map_at(stamp), reference.at(stamp)
        assert got.id.tolist() == [number for number, _, _ in expected]
        for row, (_, x, P) in enumerate(expected):
            np.testing.assert_allclose(got.center[row], x[:2], rtol=0, atol=1e-7)
            np.testing.assert_allclose(got.covariance[row], P, rtol=1e-5, atol=1e-8)


@pytest.mark.parametrize("seed", [1000, 1001])
def test_a_far_post_keeps_its_number_and_its_place(seed):
    drive, post = Drive(seed), (1.0, 0.1)
    for _ in range(30):
        drive.see((0.0, 0.0), [post])
    assert drive.now().id.tolist() == [0]
    for _ in range(80):  # 8 s; hidden for so long it would be forgotten
        drive.see((-2.0, 0.0), [post])
        found = drive.now()
        assert found.id.tolist() == [0]
        assert not found.visible[0]
        assert np.sqrt(np.linalg.eigvalsh(found.covariance[0, :2, :2]).max()) < 0.1
    for _ in range(10):
        drive.see((0.0, 0.0), [post])
    found = drive.now()
    assert found.id.tolist() == [0]
    assert np.linalg.norm(found.center[0] - post) < 0.02


@pytest.mark.parametrize("seed", [1000, 1001])
def test_a_far_post_that_is_taken_away_is_forgotten(seed):
    """The opposite: rays that pass its place, or end 0.5 m before it, keep nothing."""
    for others in ([], [(0.5, 0.1)]):
        drive, post = Drive(seed), (1.0, 0.1)
        for _ in range(30):
            drive.see((0.0, 0.0), [post])
        for _ in range(20):
            drive.see((-2.0, 0.0), [post])
        for _ in range(60):
            drive.see((-2.0, 0.0), others)
        assert 0 not in drive.now().id.tolist()
        for _ in range(5):
            drive.see((0.0, 0.0), [(1.0, 0.1)])
        assert 0 not in drive.now().id.tolist()


def test_what_moves_is_not_held_by_the_rays_that_end_where_it_was():
    """The opposite: a glimpse speaks for what stands only."""
    drive = Drive(1000)
    for step in range(30):
        drive.see((0.0, 0.0), [(1.0, -0.6 + 0.08 * step / 2)])
    before = drive.now()
    assert np.linalg.norm(before.velocity[0]) > 0.3
    for _ in range(60):
        drive.see((-2.0, 0.0), [(1.0, 0.6)])  # something else, far away
    assert before.id[0] not in drive.now().id.tolist()
