"""Scans that cannot be used, put between good ones: the state stays as it was, to the bit."""

import numpy as np
import pytest

from lidar_core import InputError, LimitError
from lidar_core.flying import FlyingConfig, FlyingObjectDetector

STEP_NS = 10**8
ROOM = np.array([8.0, 6.0, 3.0])


def scan(noise, rows=400):
    """Returns of a LiDAR in a room."""
    sight = noise.normal(size=(rows, 3))
    ranges = np.min(ROOM / np.maximum(np.abs(sight), 1e-9), 1)
    return (sight * ranges[:, None] * noise.normal(1.0, 0.001, (rows, 1))).astype(np.float32)


def pose(noise):
    turn = noise.uniform(-0.1, 0.1)
    made = np.eye(4)
    made[:2, :2] = [[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]
    made[:3, 3] = noise.normal(0, 0.1, 3)
    return made


def with_value(noise, value):
    broken = pose(noise)
    broken[noise.integers(3), noise.integers(4)] = value
    return broken


def scaled(noise):
    broken = pose(noise)
    broken[:3, :3] *= noise.choice([0.5, 0.99, 1.01, 2.0, 0.0])
    return broken


def mirrored(noise):
    broken = pose(noise)
    broken[:, noise.integers(3)] *= -1.0
    return broken


def last_row(noise):
    broken = pose(noise)
    broken[3, noise.integers(4)] += noise.choice([-1.0, 0.5, np.nan])
    return broken


def far_point(noise):
    points = scan(noise)
    points[noise.integers(len(points)), noise.integers(3)] = noise.choice([3e38, -1e30])
    return points


FAULTS = {
    "nan pose": lambda noise, now: (scan(noise), with_value(noise, np.nan), now),
    "inf pose": lambda noise, now: (scan(noise), with_value(noise, np.inf), now),
    "far pose": lambda noise, now: (scan(noise), with_value(noise, 1e30), now),
    "scaled pose": lambda noise, now: (scan(noise), scaled(noise), now),
    "mirrored pose": lambda noise, now: (scan(noise), mirrored(noise), now),
    "last row": lambda noise, now: (scan(noise), last_row(noise), now),
    "far point": lambda noise, now: (far_point(noise), pose(noise), now),
    "backwards": lambda noise, now: (scan(noise), pose(noise), now - STEP_NS * 2),
    "same time": lambda noise, now: (scan(noise), pose(noise), now - STEP_NS),
    "shape": lambda noise, now: (scan(noise)[:, :2], pose(noise), now),
}


def quarantined(fault, count, seed):
    """Put `count` scans with a fault between good ones; the detector and its twin without them."""
    noise, faults = np.random.default_rng(seed), np.random.default_rng([seed, 1])
    fouled, twin = (FlyingObjectDetector(FlyingConfig()) for _ in range(2))
    now = 0
    for number in range(count):
        if number % 10 == 0:
            now += STEP_NS
            good = (scan(noise), pose(noise), now)
            one, other = fouled.process(*good), twin.process(*good)
            np.testing.assert_array_equal(one.point_class, other.point_class)
        with pytest.raises((InputError, LimitError)):
            fouled.process(*FAULTS[fault](faults, now + STEP_NS))
        if number % 10 == 9:
            assert core_of(fouled) == core_of(twin)
    assert core_of(fouled) == core_of(twin)
    return fouled, twin


def core_of(detector):
    """The state without the counters of scans."""
    return detector._state()[0]


@pytest.mark.parametrize("fault", FAULTS)
def test_a_scan_that_is_refused_leaves_no_trace(fault):
    fouled, twin = quarantined(fault, 30, seed=3)
    assert fouled.health().rejected == 30
    assert twin.health().rejected == 0
    assert fouled.health().processed == twin.health().processed


@pytest.mark.nightly
@pytest.mark.parametrize("fault", FAULTS)
def test_a_thousand_of_them_leave_none(fault):
    quarantined(fault, 1000, seed=4)


def test_a_good_scan_leaves_one():
    """The opposite: what is compared does change with a scan that is used."""
    noise = np.random.default_rng(5)
    detector = FlyingObjectDetector(FlyingConfig())
    detector.process(scan(noise), pose(noise), 0)
    before = core_of(detector)
    detector.process(scan(noise), pose(noise), STEP_NS)
    assert core_of(detector) != before


def test_points_without_coordinates_change_no_voxel():
    noise = np.random.default_rng(6)
    whole, without = (FlyingObjectDetector(FlyingConfig()) for _ in range(2))
    for number in range(20):
        points, place = scan(noise), pose(noise)
        broken = points.copy()
        rows = noise.permutation(len(points))[:40]
        broken[rows, noise.integers(0, 3, 40)] = noise.choice([np.nan, np.inf, -np.inf], 40)
        whole.process(broken, place, number * STEP_NS)
        broken[rows] = np.nan
        without.process(broken, place, number * STEP_NS)
    assert core_of(whole) == core_of(without)
