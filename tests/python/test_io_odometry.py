"""Poses by KISS-ICP while a recording is read: accuracy, frames, times, doubt, lost tracking."""

import json
import re
import warnings
from collections import Counter
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp
from typer.testing import CliRunner

import lidar_core as lc
import lidar_core.sim as sim
from lidar_core.cli import app
from lidar_core.errors import ConfigError, InputError, MissingExtraError, OdometryWarning
from lidar_core.extras import install_command
from lidar_core.flying import FlyingObjectDetector
from lidar_core.io.poses import odometry as module
from lidar_core.io.poses.odometry import LOST_IN_A_ROW, KissOdometry, placed_scans
from lidar_core.live.config import LiveConfig
from lidar_core.live.poses import LivePoses
from lidar_core.messages import Scan

pytest.importorskip("kiss_icp")
SCANS, SEEDS = 24, (3, 4)


def simulated(seed, scans=SCANS):
    scene = sim.scenes.demo(seed, scans=scans)
    scene = scene.model_copy(update={"lidar": sim.LidarModel.preset("os1-32")})
    return list(sim.simulate(scene, seed=seed))


def true_pose(item, stamp_ns):
    """Of the sensor at a time within a simulated scan."""
    at = np.clip(stamp_ns, item.pose_stamps_ns[0], item.pose_stamps_ns[-1])
    matrix = np.eye(4)
    turns = Rotation.from_matrix(item.poses[:, :3, :3])
    matrix[:3, :3] = Slerp(item.pose_stamps_ns, turns)(at).as_matrix()
    for axis in range(3):
        matrix[axis, 3] = np.interp(at, item.pose_stamps_ns, item.poses[:, axis, 3])
    return matrix


def without_time(scan, points=None):
    return Scan(scan.stamp_ns, scan.points if points is None else np.float32(points))


def end_of(placed):
    return placed.poses[-1] if placed.poses.ndim == 3 else placed.poses


def last_point_ns(scan):
    has_point = np.isfinite(scan.points).all(axis=-1).reshape(-1)
    return int(scan.point_time_ns.reshape(-1)[has_point].max())


@pytest.fixture(scope="module")
def flights():
    """Simulated flights and where KISS-ICP says that each scan was taken."""
    found = {}
    for seed in SEEDS:
        items = simulated(seed)
        scans = [item.scan for item in items]
        found[seed] = items, list(placed_scans(scans, Counter(), lambda text: None))
    return found


def steps(items, placed):
    """Errors (K, 6) of the motion from scan to scan, and covariances as they are given."""
    truth = [true_pose(item, last_point_ns(item.scan)) for item in items]
    errors, doubts = [], []
    for k in range(1, len(placed)):
        before, now = end_of(placed[k - 1][1]), end_of(placed[k][1])
        moved, should = np.linalg.inv(before) @ now, np.linalg.inv(truth[k - 1]) @ truth[k]
        wrong = np.linalg.inv(should) @ moved
        expected = now @ np.linalg.inv(wrong)
        angles = [
            Rotation.from_matrix(one[:3, :3]).as_euler("ZYX")[::-1] for one in (now, expected)
        ]
        errors.append(np.concatenate([(now - expected)[:3, 3], angles[0] - angles[1]]))
        doubts.append(placed[k][1].covariance)
    return np.array(errors), np.array(doubts)


@pytest.mark.parametrize("seed", SEEDS)
def test_kiss_follows_a_simulated_flight(flights, seed):
    """Within 12 % of the way and 6 degrees, with 32 rows over mostly flat ground."""
    items, placed = flights[seed]
    assert len(placed) == SCANS
    truth = [true_pose(item, last_point_ns(item.scan)) for item in items]
    way = sum(np.linalg.norm((b - a)[:3, 3]) for a, b in pairwise(truth))
    assert way > 6
    wrong = np.linalg.inv(np.linalg.inv(truth[0]) @ truth[-1]) @ end_of(placed[-1][1])
    assert np.linalg.norm(wrong[:3, 3]) < 0.12 * way
    assert np.degrees(Rotation.from_matrix(wrong[:3, :3]).magnitude()) < 6


@pytest.mark.parametrize("seed", SEEDS)
def test_the_covariance_of_kiss_poses_is_consistent_on_both_sides(flights, seed):
    """NEES of the motion from scan to scan, six numbers: neither sure of itself nor in doubt."""
    errors, doubts = steps(*flights[seed])
    for doubt in doubts:
        np.testing.assert_array_equal(doubt, doubt.T)
        assert np.linalg.eigvalsh(doubt).min() > 0
    nees = [
        error @ np.linalg.solve(doubt, error) for error, doubt in zip(errors, doubts, strict=True)
    ]
    assert 2.5 < np.mean(nees) < 12
    assert 1.5 < np.median(nees) < 9
    # Two kinds of numbers, each for itself: metres do not hide angles.
    for part in (slice(0, 3), slice(3, 6)):
        own = [
            e[part] @ np.linalg.solve(d[part, part], e[part])
            for e, d in zip(errors, doubts, strict=True)
        ]
        assert 0.7 < np.mean(own) < 9


def test_poses_cover_the_times_of_all_points(flights):
    """A pose at the first and at the last ray: what the detector deskews by; the end fits truth."""
    items, placed = flights[SEEDS[0]]
    for item, (scan, found) in zip(items, placed, strict=True):
        assert found.stamps_ns is not None
        assert found.stamps_ns[0] <= min(scan.stamp_ns, scan.point_time_ns.min())
        assert found.stamps_ns[-1] == scan.point_time_ns.max()
        should = np.linalg.inv(true_pose(item, found.stamps_ns[0])) @ true_pose(
            item, found.stamps_ns[-1]
        )
        moved = np.linalg.inv(found.poses[0]) @ found.poses[-1]
        assert np.linalg.norm((moved - should)[:3, 3]) < 0.2


def test_scans_without_times_get_one_pose(flights):
    items, _ = flights[SEEDS[0]]
    odometry = KissOdometry()
    for item in items[:3]:
        found = odometry.place(without_time(item.scan))
        assert found.stamps_ns is None
        assert found.poses.shape == (4, 4)


def test_kiss_repeats_itself(flights):
    items, placed = flights[SEEDS[0]]
    again = list(placed_scans([item.scan for item in items[:5]], Counter(), lambda text: None))
    for (_, one), (_, other) in zip(placed[:5], again, strict=True):
        np.testing.assert_array_equal(one.poses, other.poses)
        np.testing.assert_array_equal(one.covariance, other.covariance)


def test_small_turns_become_changes_of_the_three_angles():
    for seed in range(20):
        rotation = Rotation.random(random_state=seed)
        yaw, pitch, roll = rotation.as_euler("ZYX")
        if abs(pitch) > 1.3:
            continue
        turn = np.random.default_rng(seed).normal(0, 1e-6, 3)
        after = (Rotation.from_rotvec(turn) * rotation).as_euler("ZYX")[::-1]
        got = module._angles_from_rotation(rotation.as_matrix()) @ turn
        np.testing.assert_allclose(got, after - np.array([roll, pitch, yaw]), atol=1e-10)


def noise(scan, seed):
    """Points that fit no place, at the same time."""
    points = np.random.default_rng(seed).uniform(-60, 60, (4000, 3))
    points += np.array([0, 0, 90.0 + 40 * seed])
    return without_time(scan, points)


def test_lost_scans_are_left_out_told_and_the_way_is_found_again(flights):
    items, _ = flights[SEEDS[0]]
    scans = [without_time(item.scan) for item in items[:8]]
    scans[3:5] = [noise(scan, 1 + k) for k, scan in enumerate(scans[3:5])]
    left_out, notes = Counter(), []
    with pytest.warns(OdometryWarning, match=f"lost its way at {scans[3].stamp_ns} ns: .*left out"):
        placed = list(placed_scans(scans, left_out, notes.append))
    assert left_out == {"KISS-ICP lost its way": 2}
    assert [scan.stamp_ns for scan, _ in placed] == [s.stamp_ns for s in scans[:3] + scans[5:]]
    assert len(notes) == 1
    truth = [item.world_from_lidar for item in items]
    moved = np.linalg.inv(placed[2][1].poses) @ placed[3][1].poses
    should = np.linalg.inv(truth[2]) @ truth[5]
    assert np.linalg.norm((moved - should)[:3, 3]) < 0.25


def test_after_ten_lost_scans_kiss_begins_anew(flights):
    items, _ = flights[SEEDS[0]]
    first = [without_time(item.scan) for item in items[:2]]
    lost = [
        replace(noise(first[1], 1), stamp_ns=first[1].stamp_ns + (k + 1) * 10**8)
        for k in range(LOST_IN_A_ROW + 2)
    ]
    odometry = KissOdometry()
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        found = [odometry.place(scan) for scan in first + lost]
    assert [one.category for one in told] == [OdometryWarning] * 2
    assert "lost its way" in str(told[0].message)
    assert "begins anew" in str(told[1].message)
    assert "after 10 scans" in str(told[1].message)
    assert [one is not None for one in found] == [True] * 2 + [False] * 9 + [True] * 3
    assert odometry.lost == LOST_IN_A_ROW


def test_jumps_are_told(flights):
    """The sensor is carried on by 4 m within one scan: placed or lost, but not without a word."""
    items, _ = flights[SEEDS[0]]
    odometry = KissOdometry()
    for item in items[:5]:
        odometry.place(without_time(item.scan))
    shifted = items[5].scan.points.reshape(-1, 3) - np.float32([4.0, 0, 0])
    with pytest.warns(OdometryWarning, match="jumps by|lost its way"):
        odometry.place(without_time(items[5].scan, shifted))


def test_empty_and_repeated_scans(flights):
    items, _ = flights[SEEDS[0]]
    odometry = KissOdometry()
    odometry.place(items[0].scan)
    with pytest.raises(InputError, match="not later than the one before"):
        odometry.place(items[0].scan)
    empty = Scan(items[1].scan.stamp_ns + 10**8, np.full((100, 3), np.nan, np.float32))
    with pytest.warns(OdometryWarning, match="0 points within reach"):
        assert odometry.place(empty) is None


def test_detect_with_pose_kiss(tmp_path, flights, monkeypatch):
    """A recording without any pose: the detector gets poses, their times and their covariance."""
    items, _ = flights[SEEDS[0]]
    lc.io.write_npz(tmp_path / "r.npz", [item.scan for item in items[:6]])
    given = []
    process = FlyingObjectDetector.process

    def watched(self, points, pose, stamp, **options):
        given.append((np.shape(pose), options["pose_covariance"], options["pose_stamps_ns"]))
        return process(self, points, pose, stamp, **options)

    monkeypatch.setattr(FlyingObjectDetector, "process", watched)
    done = CliRunner().invoke(
        app,
        [
            "detect",
            str(tmp_path / "r.npz"),
            "-o",
            str(tmp_path / "run"),
            "--pose",
            "kiss",
            "--no-picture",
            "--no-mcap",
        ],
    )
    assert done.exit_code == 0, done.output
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert summary["poses"].startswith("KISS-ICP")
    assert summary["scans"]["processed"] == 6
    assert [shape for shape, _, _ in given] == [(2, 4, 4)] * 6
    assert all(covariance.shape == (6, 6) for _, covariance, _ in given)
    assert all(stamps.shape == (2,) for _, _, stamps in given)


def test_posed_scans_with_pose_kiss(tmp_path, flights):
    items, placed = flights[SEEDS[0]]
    lc.io.write_npz(tmp_path / "r.npz", [item.scan for item in items[:4]])
    with lc.io.open_recording(tmp_path / "r.npz") as recording:
        scans = lc.io.posed_scans(recording, pose="kiss")
        found = list(scans)
    assert scans.source.startswith("KISS-ICP")
    for item, (_, other) in zip(found, placed[:4], strict=True):
        np.testing.assert_array_equal(item.world_from_lidar, other.poses)
        np.testing.assert_array_equal(item.pose_covariance, other.covariance)


def test_kiss_is_refused_for_2d_scans_and_streams(tmp_path):
    scene = sim.Scene(lidar=sim.LidarModel.preset("utm-30lx"), scans=1)
    lc.io.write_npz(tmp_path / "r.npz", [next(sim.sweeps(scene, seed=0)).scan])
    with lc.io.open_recording(tmp_path / "r.npz") as recording:
        scans = lc.io.posed_laser_scans(recording, pose="kiss")
        with pytest.raises(ConfigError, match="kiss places clouds, not 2D scans"):
            list(scans)
    with pytest.raises(ConfigError, match="expected auto or static for a live stream, got 'kiss'"):
        LivePoses(lc.io.PoseOptions(pose="kiss"), LiveConfig())


def test_without_the_package_the_extra_is_named(monkeypatch):
    import sys

    monkeypatch.setitem(sys.modules, "kiss_icp", None)
    with pytest.raises(MissingExtraError, match=re.escape(install_command("odometry"))):
        KissOdometry()


def test_kiss_on_a_real_street(recordings, tmp_path):
    """30 scans of a car without stamps: the way agrees with poses found offline, within 6 %."""
    import tarfile

    folder = recordings / "3d/sequences/street_128_labelled"
    with tarfile.open(folder / "lidar_rounded_000000-000029.tar.xz") as archive:
        names = sorted(n for n in archive.getnames() if n.endswith(".pcd"))[:10]
        archive.extractall(tmp_path, members=names, filter="data")
    known = np.tile(np.eye(4), (30, 1, 1))
    known[:, :3] = np.loadtxt(folder / "poses_icp.txt").reshape(-1, 3, 4)
    place = (tmp_path / names[0]).parent
    with warnings.catch_warnings(), lc.io.open_recording(place) as recording:
        warnings.simplefilter("error")
        found = [item.world_from_lidar for item in lc.io.posed_scans(recording, pose="kiss")]
    assert len(found) == 10
    wrong = np.linalg.inv(np.linalg.inv(known[0]) @ known[9]) @ found[-1]
    assert np.linalg.norm(wrong[:3, 3]) < 0.06 * np.linalg.norm(known[9][:3, 3] - known[0][:3, 3])
