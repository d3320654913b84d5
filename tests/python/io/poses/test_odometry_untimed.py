"""Poses by KISS-ICP of clouds of a spinning sensor without the times of points."""

from collections import Counter
from functools import lru_cache
from itertools import pairwise

import numpy as np
import pytest
from untimed_clouds import FURNISHED, PERIOD_NS, drive

from lidar_core.errors import InputError
from lidar_core.flying import FlyingObjectDetector
from lidar_core.io.poses.odometry import KissOdometry, placed_scans
from lidar_core.messages import Scan

pytest.importorskip("kiss_icp")


def scans_of(clouds):
    return [Scan(number * PERIOD_NS, points) for number, points in enumerate(clouds)]


def placed(clouds):
    found = list(placed_scans(scans_of(clouds), Counter(), lambda text: None))
    assert len(found) == len(clouds)
    assert all(one.poses.shape == (4, 4) and one.stamps_ns is None for _, one in found)
    return [one.poses for _, one in found]


@lru_cache
def furnished(**values):
    """Scans of 40 rows; from the sixth motion on, the odometry has found its pace."""
    return drive(**{"scans": 10, "rows": 40, "columns": 500, "boxes": FURNISHED} | values)


def errors(found, truth):
    """Errors of the motions [m], [deg]."""
    apart = [
        np.linalg.inv(np.linalg.inv(before) @ after) @ np.linalg.inv(one) @ other
        for (one, other), (before, after) in zip(pairwise(found), pairwise(truth), strict=True)
    ]
    traces = np.array([np.trace(one[:3, :3]) for one in apart])
    angle = np.degrees(np.arccos(np.clip((traces - 1) / 2, -1, 1)))
    return np.array([np.linalg.norm(one[:3, 3]) for one in apart]), angle


@pytest.mark.ci_cases("1.09")
@pytest.mark.parametrize("turn", [1.09, 1.03])
def test_the_way_is_right_though_the_clouds_have_no_times(turn):
    clouds, truth = furnished(turn=turn, speed=7.0)
    error, _ = errors(placed(clouds), truth)
    assert error[5:].max() < 0.05  # up to 0.15 m without their times


def test_a_turning_sensor_is_followed():
    clouds, truth = furnished(scans=13, speed=5.0, yaw_rate=0.5)
    _, angle = errors(placed(clouds), truth)
    assert angle[5:].max() < 0.1  # 0.3 deg without their times


def test_points_that_a_driver_has_moved_are_not_moved_again():
    clouds, truth = furnished(speed=7.0, is_moved=True)
    error, angle = errors(placed(clouds), truth)
    assert error[5:].max() < 0.05
    assert angle[5:].max() < 0.1


def test_the_detector_moves_the_points_with_these_poses():
    clouds, _ = furnished(turn=1.09, speed=7.0)
    detector = FlyingObjectDetector()
    for scan, one in placed_scans(scans_of(clouds), Counter(), lambda text: None):
        frame = detector.process(scan.points, one.poses, scan.stamp_ns)
    assert frame.status.point_times == "estimated"


def test_a_stream_learns_it_on_the_way_and_survives_clouds_in_another_order():
    clouds, truth = furnished(scans=13, speed=7.0)
    rng, odometry = np.random.default_rng(0), KissOdometry()
    scans = scans_of(clouds)
    scans[9] = Scan(9 * PERIOD_NS, rng.permutation(clouds[9]))  # this one shows no order
    found = [odometry.place(scan) for scan in scans]
    assert all(one is not None for one in found)
    assert odometry.lost == 0
    error, _ = errors([one.poses for one in found], truth)
    assert error[[6, 7]].max() < 0.05
    assert error[[10, 11]].max() < 0.1
    with pytest.raises(InputError, match="not later"):
        odometry.place(scans[-1])
