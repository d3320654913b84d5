"""Scans that several circles and walls share."""

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal

from lidar_core.circles import DatasetConfig, Scanner, make_samples
from lidar_core.circles.crowds import crowds

EXACT = DatasetConfig.continuous(circles=40).model_copy(update={"range_std": (0.0, 0.0)})
SCANNER = Scanner()
FLOAT32 = 1e-5  # of ranges up to 10 m


def samples_of(count, seed):
    return make_samples(EXACT, count=count, seed=seed)


def nearest(circles, bearings):
    """Distance to the nearest of some circles along every ray, by the formula for one circle."""
    x, y, radius = circles.astype(float).T[:, :, None]
    along, aside = (
        x * np.cos(bearings) + y * np.sin(bearings),
        y * np.cos(bearings) - x * np.sin(bearings),
    )
    depth = radius**2 - aside**2
    ranges = along - np.sqrt(np.where(depth >= 0, depth, np.nan))
    is_met = (ranges >= SCANNER.range_min) & (ranges <= SCANNER.range_max)
    return np.where(is_met, ranges, np.inf).min(axis=0)


def test_the_nearest_circle_is_seen():
    samples = samples_of(40, 1070)
    made = crowds(samples, SCANNER, per_scan=8)
    assert made.scans.shape == (5, 1081)
    bearings = SCANNER.bearings()
    for number, scan in enumerate(made.scans):
        circles = samples.circles[8 * number : 8 * number + 8]
        expected = nearest(circles, bearings)
        assert (np.isfinite(scan) != np.isfinite(expected)).sum() <= 2  # rays that just touch one
        both = np.isfinite(scan) & np.isfinite(expected)
        assert_allclose(scan[both], expected[both], atol=1e-4)


def test_rays_know_their_circle():
    samples = samples_of(21, 1071)
    made = crowds(samples, SCANNER, per_scan=10)
    assert made.scans.shape == (3, 1081)
    assert_array_equal(made.owner >= 0, np.isfinite(made.scans))
    scan, ray = np.nonzero(made.owner >= 0)
    owner = made.owner[scan, ray]
    assert_array_equal(owner // 10, scan)
    x, y, radius = made.circles[owner].astype(float).T
    bearings, ranges = SCANNER.bearings()[ray], made.scans[scan, ray]
    apart = np.hypot(ranges * np.cos(bearings) - x, ranges * np.sin(bearings) - y)
    assert_allclose(apart, radius, atol=1e-4)


def test_walls_are_straight_and_hide_what_is_behind_them():
    samples = samples_of(30, 1072)
    alone = crowds(samples, SCANNER, per_scan=3)
    made = crowds(samples, SCANNER, per_scan=3, walls=1, seed=5)
    assert (made.scans <= alone.scans).all()
    is_wall = made.scans < alone.scans
    assert is_wall.any(axis=1).sum() >= 5
    assert (made.owner[is_wall] == -1).all()
    assert_array_equal(made.owner[~is_wall], alone.owner[~is_wall])
    bearings = SCANNER.bearings()
    for scan, chosen in zip(made.scans, is_wall, strict=True):
        if chosen.sum() >= 3:
            points = (
                scan[chosen, None] * np.column_stack([np.cos(bearings), np.sin(bearings)])[chosen]
            )
            assert np.linalg.svd(points - points.mean(axis=0))[1][1] < 1e-4
            assert np.linalg.norm(np.ptp(points, axis=0)) <= 6.0 + FLOAT32


def test_the_same_seed_gives_the_same_walls():
    samples = samples_of(8, 1073)
    one, same, other = (
        crowds(samples, SCANNER, per_scan=4, walls=2, seed=seed).scans for seed in (1, 1, 2)
    )
    assert_array_equal(one, same)
    assert (one != other).any()
