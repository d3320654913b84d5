"""Share that association by the truth reaches."""

import numpy as np
import pytest

from lidar_core.fusion import DetectionScan, Measurement, MultiTargetConfig
from lidar_core.reproduce.fusion.real_data.bounds import known_share

SECOND = 1_000_000_000
NOISE = [[1.0, 0.0], [0.0, 1.0]]


def scans_of(returns):
    """Boats at x = 0 and x = 10 m; `returns` has the numbers of those that each scan sees."""
    truth = {1: np.zeros(2), 2: np.array([10.0, 0.0])}
    return [
        DetectionScan(
            k * SECOND,
            "radar",
            [Measurement(k * SECOND, "lidar", truth[number], NOISE) for number in seen],
            np.array([0.0, -100.0]),
            truth,
        )
        for k, seen in enumerate(returns)
    ]


def share(returns, needed):
    config = MultiTargetConfig.boats()
    return known_share(scans_of(returns), config, needed=needed, reach=15.0, gap=3.0)


@pytest.mark.parametrize(("needed", "expected"), [(1, 0.6), (2, 0.5), (4, 0.3), (7, 0.0)])
def test_the_second_boat_has_a_track_once_enough_scans_saw_both(needed, expected):
    assert share([[1]] * 4 + [[1, 2]] * 6, needed) == pytest.approx(expected)


def test_a_boat_that_is_not_seen_any_more_is_followed_for_max_coast():
    coast = round(MultiTargetConfig.boats().max_coast)
    returns = [[1, 2]] * 3 + [[1]] * (coast + 7)
    assert share(returns, 1) == pytest.approx((3 + coast) / len(returns))


def test_without_targets_there_is_no_share():
    assert known_share([], MultiTargetConfig.boats(), needed=1, reach=15.0, gap=3.0) is None
