"""A sensor that moves and is said to stand is recognised in sparse scenes; one at rest is not."""

import numpy as np
import pytest
from archives import unpack
from commands import json_of

import lidar_core as lc
from lidar_core.messages import Scan
from lidar_core.runs.scans.standing import StandingCheck

SCANS = 30
AZIMUTH, ELEVATION = np.meshgrid(np.radians(np.arange(0, 360, 1.0)), np.radians(range(-22, 22, 2)))
RAYS = np.column_stack(
    [
        (np.cos(ELEVATION) * np.cos(AZIMUTH)).ravel(),
        (np.cos(ELEVATION) * np.sin(AZIMUTH)).ravel(),
        np.sin(ELEVATION).ravel(),
    ]
)


def cast(place, yaw, boxes, rng):
    """Points of a scan (N, 3) of boxes and the ground at height 0, in the frame of the sensor."""
    turn = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
    rays = RAYS @ turn.T
    with np.errstate(divide="ignore", invalid="ignore"):
        ranges = np.where(rays[:, 2] < 0, -place[2] / rays[:, 2], np.inf)
        for low, high in boxes:
            near, far = (low - place) / rays, (high - place) / rays
            enter = np.minimum(near, far).max(axis=1)
            is_hit = (enter > 0) & (enter < np.maximum(near, far).min(axis=1))
            ranges = np.where(is_hit & (enter < ranges), enter, ranges)
    ranges[ranges > 60] = np.nan
    noisy = ranges + rng.normal(0, 0.01, len(ranges))
    return (RAYS * noisy[:, None]).astype(np.float32)


WALL = (np.array([12.0, -10, 0]), np.array([12.3, 10, 6]))
TRUNK = (np.array([-6.0, 5, 0]), np.array([-5.6, 5.4, 5]))


def scans(*, speed=0.0, rate=0.0, movers=False, sway=0.0):
    rng = np.random.default_rng(4)
    for number in range(SCANS):
        t = 0.1 * number
        boxes = [WALL, TRUNK]
        if movers:  # people on all sides, and a van that passes in front of the wall
            walks = np.array([1.4 * t, 0, 0])
            for at in ((4, 3), (-3, -6), (5, -4), (-8, 2), (2, 7)):
                low = np.array([*at, 0.0]) + walks * (-1) ** at[0]
                boxes.append((low, low + np.array([0.5, 0.5, 1.8])))
            low = np.array([7.0, -12 + 8 * t, 0])
            boxes.append((low, low + np.array([2, 5, 2.5])))
        yaw = rate * t + sway * np.sin(5 * t)
        yield Scan(number * 10**8, cast(np.array([speed * t, 0, 1.5]), yaw, boxes, rng))


def has_moved(items, poses=None):
    check = StandingCheck()
    for number, scan in enumerate(items):
        pose = np.eye(4) if poses is None else poses[number]
        check.add(scan.points, pose[None])
    return check.has_moved


@pytest.mark.parametrize(("speed", "rate"), [(0.5, 0.25), (0.0, 0.3), (2.0, 0.0), (1.0, -0.1)])
def test_a_sensor_that_moves_is_recognised(speed, rate):
    assert has_moved(scans(speed=speed, rate=rate))


@pytest.mark.parametrize("values", [{}, {"movers": True}, {"sway": 0.02}])
def test_a_sensor_at_rest_is_not(values):
    assert not has_moved(scans(**values))


def test_a_sensor_whose_poses_say_that_it_moves_is_not_looked_at():
    poses = np.tile(np.eye(4), (SCANS, 1, 1))
    poses[:, 0, 3] = 0.05 * np.arange(SCANS)
    assert not has_moved(scans(speed=0.5, rate=0.25), poses)


def test_few_or_no_points_say_nothing():
    empty = Scan(0, np.empty((0, 3), np.float32))
    lost = Scan(0, np.full((100, 3), np.nan, np.float32))
    assert not has_moved([empty, lost] * SCANS)


def test_a_restored_check_goes_on():
    one, items = StandingCheck(), list(scans(speed=0.5, rate=0.25))
    for number, scan in enumerate(items):
        other = StandingCheck()
        other.restore(one.state())
        one = other
        one.add(scan.points, np.eye(4)[None])
        assert number > 5 or not one.has_moved
    assert one.has_moved


@pytest.mark.parametrize("name", ["livox_hap_outdoor", "rs16_office", "livox_horizon_sway"])
def test_real_sensors_at_rest_are_not_named(recordings, tmp_path, name):
    packed = recordings / f"3d/sequences/{name}/scans.tar.xz"
    found = []
    for one in unpack(packed, tmp_path, suffix=".pcd", most=24):
        try:
            found.append(Scan(0, lc.io.read_cloud(tmp_path / one).points))
        except lc.FormatError:  # one file of an office is cut
            continue
    assert len(found) > 20
    assert not has_moved(found)


def test_detect_names_a_sensor_that_moves_in_a_sparse_scene(tmp_path):
    for name, speed, rate, expected in (("drives", 0.5, 0.25, 1), ("stands", 0.0, 0.0, 0)):
        lc.io.write_npz(tmp_path / f"{name}.npz", scans(speed=speed, rate=rate))
        folder = tmp_path / name
        path = tmp_path / f"{name}.npz"
        few = ("--pose", "static", "--no-picture", "--no-mcap")
        result = json_of("detect", path, "-o", folder, *few)
        named = [one for one in result["notes"] if "it has one place: if the sensor moved" in one]
        assert len(named) == expected
