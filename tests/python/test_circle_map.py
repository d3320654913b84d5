"""The semantic map: against the oracle, against the truth, and against bad input."""

import numpy as np
import pytest

from lidar_core.circles import CircleMap, CircleMapConfig
from lidar_core.errors import ConfigError, InputError

STEP_NS = 50_000_000  # 20 Hz
HERE = np.eye(4)
R = np.diag([4e-5, 4e-5, 1e-5])
BEST = CircleMapConfig()
PAPER = CircleMapConfig.paper()
AT_ONCE = {"confirm_hits": 1, "confirm_window": 1}


def feed(circles, step, *rows, **more):
    covariance = np.broadcast_to(R, (len(rows), 3, 3))
    rows = np.reshape(rows, (-1, 3))
    return circles.update(rows, covariance, HERE, step * STEP_NS, **more)


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
        ({"sensor": -1}, "sensor"),
    ],
)  # fmt: skip
def test_refused_calls_change_nothing(config, change, text):
    circles = CircleMap(config)
    for step in range(8):
        feed(circles, step, [3.0, 1.0, 0.3])
    before = circles.map_at(8 * STEP_NS)
    call = {
        "circles": [[3.0, 1.0, 0.3]], "covariance": [R], "world_from_lidar": HERE,
        "stamp_ns": 8 * STEP_NS, **change,
    }  # fmt: skip
    with pytest.raises(InputError, match=text):
        circles.update(**call)
    after = circles.map_at(8 * STEP_NS)
    assert (before.center == after.center).all()
    assert (before.covariance == after.covariance).all()
    assert feed(circles, 8, [3.0, 1.0, 0.3]).elements.tolist() == [0]


@pytest.mark.parametrize(
    "values",
    [
        {"confirm_hits": 6},
        {"process_noise": (1.0,)},
        {"mode_time": (0.0, 1.0, 1.0)},
        {"filter": "joint"},
        {"gate_probability": 1.0},
    ],
)
def test_impossible_settings_are_refused(values):
    with pytest.raises(ConfigError):
        CircleMapConfig(**values)
