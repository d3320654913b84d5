"""The description of a 2D LiDAR."""

import math

import numpy as np
import pytest

from lidar_core import ConfigError
from lidar_core.circles import Scanner


def test_the_default_is_the_papers_scanner():
    scanner = Scanner()
    bearings = scanner.bearings()
    assert bearings.shape == (1081,)
    np.testing.assert_allclose(np.degrees(bearings[[0, 540, -1]]), [-135, 0, 135], atol=1e-9)
    assert math.isclose(scanner.field_of_view, math.radians(270))


def test_values_may_be_given_by_position():
    assert Scanner(-1.0, 0.1, 11, 0.2, 5.0) == Scanner(
        angle_min=-1.0, angle_increment=0.1, n_beams=11, range_min=0.2, range_max=5.0
    )
    assert Scanner(-1.0, n_beams=100) == Scanner(angle_min=-1.0, n_beams=100)
    with pytest.raises(TypeError, match="twice"):
        Scanner(-1.0, angle_min=0.0)
    with pytest.raises(TypeError, match="5 values, got 6"):
        Scanner(1, 2, 3, 4, 5, 6)


@pytest.mark.parametrize(
    "values",
    [
        {"angle_increment": 0.0},
        {"angle_increment": math.nan},
        {"n_beams": 1},
        {"n_beams": 2000},  # more than one turn
        {"range_min": 10.0},
        {"range_max": math.inf},
        {"rays": 5},
    ],
)
def test_what_is_no_scanner_is_refused(values):
    with pytest.raises(ConfigError):
        Scanner(**values)


def test_a_scanner_may_turn_clockwise_and_all_round():
    scanner = Scanner(math.pi, -2 * math.pi / 360, 361, 0.1, 10.0)
    assert scanner.bearings()[-1] == pytest.approx(-math.pi)
