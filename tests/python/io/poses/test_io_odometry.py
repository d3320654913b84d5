"""Poses by KISS-ICP while a recording is read: accuracy, frames, times, doubt, lost tracking."""

import json
import re
import warnings
from collections import Counter
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from archives import unpack
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation, Slerp
from typer.testing import CliRunner

import lidar_core as lc
import lidar_core.sim as sim
from lidar_core.cli import app
from lidar_core.errors import ConfigError, InputError, MissingExtraError, OdometryWarning
from lidar_core.extras import install_command
from lidar_core.flying import FlyingObjectDetector
from lidar_core.io import NoTransformError
from lidar_core.io.poses import odometry as module
from lidar_core.io.poses.odometry import LOST_IN_A_ROW, KissOdometry, placed_scans
from lidar_core.live.config import LiveConfig
from lidar_core.live.poses import LivePoses
from lidar_core.messages import Scan
from reference import untimed

pytest.importorskip("kiss_icp")
SCANS, SEED = 12, 3
LONG_SCANS, LONG_SEEDS = 24, (3, 4)


def simulated(seed, scans, columns):
    scene = sim.scenes.demo(seed, scans=scans)
    lidar = sim.LidarModel.preset("os1-32")
    pattern = lidar.pattern.model_copy(update={"columns": columns})
    lidar = lidar.model_copy(update={"pattern": pattern})
    return list(sim.simulate(scene.model_copy(update={"lidar": lidar}), seed=seed))


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


def placed_flight(seed, scans, columns):
    """A simulated flight and where KISS-ICP says that each scan was taken."""
    items = simulated(seed, scans, columns)
    return items, list(placed_scans([item.scan for item in items], Counter(), lambda text: None))


@pytest.fixture(scope="module")
def flight():
    """A short one, of a sparse sensor."""
    return placed_flight(SEED, SCANS, 512)


@pytest.fixture(scope="module", params=LONG_SEEDS)
def long_flight(request):
    return placed_flight(request.param, LONG_SCANS, 1024)


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


def test_kiss_follows_a_simulated_flight(flight):
    check_way(*flight, SCANS)


@pytest.mark.nightly
def test_kiss_follows_long_flights(long_flight):
    check_way(*long_flight, LONG_SCANS)


def check_way(items, placed, scans):
    """Within 12 % of the way and 6 degrees, with 32 rows over mostly flat ground."""
    assert len(placed) == scans
    truth = [true_pose(item, last_point_ns(item.scan)) for item in items]
    way = sum(np.linalg.norm((b - a)[:3, 3]) for a, b in pairwise(truth))
    assert way > 0.25 * scans
    wrong = np.linalg.inv(np.linalg.inv(truth[0]) @ truth[-1]) @ end_of(placed[-1][1])
    assert np.linalg.norm(wrong[:3, 3]) < 0.12 * way
    assert np.degrees(Rotation.from_matrix(wrong[:3, :3]).magnitude()) < 6


def test_the_covariance_of_kiss_poses_is_consistent_on_both_sides(flight):
    check_covariance(*flight, low=1.5)  # a mean of eleven steps only


@pytest.mark.nightly
def test_the_covariance_of_long_flights_is_consistent_on_both_sides(long_flight):
    check_covariance(*long_flight, low=2.5)


def check_covariance(items, placed, *, low):
    """NEES of the motion from scan to scan, six numbers: neither sure of itself nor in doubt."""
    errors, doubts = steps(items, placed)
    for doubt in doubts:
        np.testing.assert_array_equal(doubt, doubt.T)
        assert np.linalg.eigvalsh(doubt).min() > 0
    nees = [
        error @ np.linalg.solve(doubt, error) for error, doubt in zip(errors, doubts, strict=True)
    ]
    assert low < np.mean(nees) < 12
    assert low - 1 < np.median(nees) < 9
    # Two kinds of numbers, each for itself: metres do not hide angles.
    for part in (slice(0, 3), slice(3, 6)):
        own = [
            e[part] @ np.linalg.solve(d[part, part], e[part])
            for e, d in zip(errors, doubts, strict=True)
        ]
        assert low / 4 < np.mean(own) < 9


def test_poses_cover_the_times_of_all_points(flight):
    """A pose at the first and at the last ray: what the detector deskews by; the end fits truth."""
    items, placed = flight
    for item, (scan, found) in zip(items, placed, strict=True):
        assert found.stamps_ns is not None
        assert found.stamps_ns[0] <= min(scan.stamp_ns, scan.point_time_ns.min())
        assert found.stamps_ns[-1] == scan.point_time_ns.max()
        should = np.linalg.inv(true_pose(item, found.stamps_ns[0])) @ true_pose(
            item, found.stamps_ns[-1]
        )
        moved = np.linalg.inv(found.poses[0]) @ found.poses[-1]
        assert np.linalg.norm((moved - should)[:3, 3]) < 0.2


def test_scans_without_times_get_one_pose(flight):
    items, _ = flight
    odometry = KissOdometry()
    for item in items[:3]:
        found = odometry.place(without_time(item.scan))
        assert found.stamps_ns is None
        assert found.poses.shape == (4, 4)


def test_kiss_repeats_itself(flight):
    items, placed = flight
    again = list(placed_scans([item.scan for item in items[:3]], Counter(), lambda text: None))
    for (_, one), (_, other) in zip(placed[:3], again, strict=True):
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


def test_lost_scans_are_left_out_told_and_the_way_is_found_again(flight):
    items, _ = flight
    scans = [without_time(item.scan) for item in items[:8]]
    scans[3:5] = [noise(scan, 1 + k) for k, scan in enumerate(scans[3:5])]
    left_out, notes = Counter(), []
    with pytest.warns(OdometryWarning, match=f"lost track at {scans[3].stamp_ns} ns: .*left out"):
        placed = list(placed_scans(scans, left_out, notes.append))
    assert left_out == {"KISS-ICP lost track": 2}
    assert [scan.stamp_ns for scan, _ in placed] == [s.stamp_ns for s in scans[:3] + scans[5:]]
    assert len(notes) == 1
    truth = [item.world_from_lidar for item in items]
    moved = np.linalg.inv(placed[2][1].poses) @ placed[3][1].poses
    should = np.linalg.inv(truth[2]) @ truth[5]
    assert np.linalg.norm((moved - should)[:3, 3]) < 0.25


def test_after_ten_lost_scans_kiss_begins_anew(flight):
    items, _ = flight
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
    assert "lost track" in str(told[0].message)
    assert "restarts at" in str(told[1].message)
    assert "after 10 scans" in str(told[1].message)
    assert [one is not None for one in found] == [True] * 2 + [False] * 9 + [True] * 3
    assert odometry.lost == LOST_IN_A_ROW


def test_jumps_are_told(flight):
    """The sensor is carried on by 4 m within one scan: placed or lost, but not without a word."""
    items, _ = flight
    odometry = KissOdometry()
    for item in items[:5]:
        odometry.place(without_time(item.scan))
    shifted = items[5].scan.points.reshape(-1, 3) - np.float32([4.0, 0, 0])
    with pytest.warns(OdometryWarning, match="jumps by|lost track"):
        odometry.place(without_time(items[5].scan, shifted))


def test_the_first_step_of_a_fast_car_is_found():
    """1.2 m from scan to scan: further than neighbours are looked for with the voxels of the map.

    The ground looks the same from everywhere, and pulls towards standing still.
    """
    rng = np.random.default_rng(0)
    houses = [
        sim.Body(
            shape=sim.Box(size=(6.0, 3.0, 8.0)),
            position=(11 * k + rng.uniform(-2, 2), side + rng.uniform(-2, 2), 2.0),
        )
        for side in (-9, 9)
        for k in range(-6, 7)
    ]
    ground = sim.Body(shape=sim.Plane(size=(200.0, 200.0)), position=(0, 0, -1.8))
    scene = sim.Scene(
        bodies=(ground, *houses),
        lidar=sim.LidarModel.preset("vlp-16"),
        sensor=sim.Waypoints(times=(0, 1.0), positions=((-8.0, 0, 0), (4.0, 0, 0))),
        scans=3,
    )
    scans = [without_time(made.scan) for made in sim.simulate(scene, seed=0)]
    placed = [one.poses for _, one in placed_scans(scans, Counter(), lambda text: None)]
    for before, now in pairwise(placed):
        np.testing.assert_allclose((np.linalg.inv(before) @ now)[:3, 3], [1.2, 0, 0], atol=0.15)


def test_empty_and_repeated_scans(flight):
    items, _ = flight
    odometry = KissOdometry()
    odometry.place(items[0].scan)
    with pytest.raises(InputError, match="not later than the one before"):
        odometry.place(items[0].scan)
    empty = Scan(items[1].scan.stamp_ns + 10**8, np.full((100, 3), np.nan, np.float32))
    with pytest.warns(OdometryWarning, match="0 points within reach"):
        assert odometry.place(empty) is None


def test_detect_with_pose_kiss(tmp_path, flight, monkeypatch):
    """A recording without any pose: the detector gets poses, their times and their covariance."""
    items, _ = flight
    lc.io.write_npz(tmp_path / "r.npz", [item.scan for item in items[:4]])
    given = []
    process = FlyingObjectDetector.process

    def watched(self, posed, **options):
        stamps = posed.pose_stamps_ns
        given.append((np.shape(posed.world_from_lidar), posed.pose_covariance, stamps))
        return process(self, posed, **options)

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
    assert summary["scans"]["processed"] == 4
    assert [shape for shape, _, _ in given] == [(2, 4, 4)] * 4
    assert all(covariance.shape == (6, 6) for _, covariance, _ in given)
    assert all(stamps.shape == (2,) for _, _, stamps in given)


def test_posed_scans_with_pose_kiss(tmp_path, flight):
    items, placed = flight
    lc.io.write_npz(tmp_path / "r.npz", [item.scan for item in items[:4]])
    with lc.io.open_recording(tmp_path / "r.npz") as recording:
        scans = lc.io.posed_scans(recording, pose="kiss")
        found = list(scans)
    assert scans.source.startswith("KISS-ICP")
    for item, (_, other) in zip(found, placed[:4], strict=True):
        np.testing.assert_array_equal(item.world_from_lidar, other.poses)
        np.testing.assert_array_equal(item.pose_covariance, other.covariance)


def sweep():
    scene = sim.Scene(lidar=sim.LidarModel.preset("utm-30lx"), scans=1)
    return next(sim.sweeps(scene, seed=0)).scan


def test_kiss_is_refused_for_2d_scans(tmp_path):
    lc.io.write_npz(tmp_path / "r.npz", [sweep()])
    with lc.io.open_recording(tmp_path / "r.npz") as recording:
        scans = lc.io.posed_laser_scans(recording, pose="kiss")
        with pytest.raises(ConfigError, match="kiss works for clouds, not for 2D scans"):
            list(scans)
    with pytest.raises(ConfigError, match="kiss works for clouds, not for 2D scans"):
        LivePoses(lc.io.PoseOptions(pose="kiss"), LiveConfig()).posed(sweep())


def test_a_stream_is_placed_as_its_scans_come(flight):
    """Without the look ahead of recordings, the first scan has one pose; all fit the truth."""
    items, _ = flight
    poses, notes = LivePoses(lc.io.PoseOptions(pose="kiss"), LiveConfig()), []
    found = []
    for item in items[:5]:
        assert poses.is_complete(item.scan)
        found.append(poses.posed(item.scan))
    assert [one.world_from_lidar.shape for one in found] == [(4, 4)] + [(2, 4, 4)] * 4
    assert all(one.pose_covariance.shape == (6, 6) for one in found)
    truth = [true_pose(item, last_point_ns(item.scan)) for item in items[:5]]
    moved = np.linalg.inv(found[0].world_from_lidar) @ found[4].world_from_lidar[-1]
    wrong = np.linalg.inv(np.linalg.inv(truth[0]) @ truth[4]) @ moved
    assert np.linalg.norm(wrong[:3, 3]) < 0.25
    with pytest.raises(NoTransformError, match="not later than the one before"):
        poses.posed(items[4].scan)
    other = replace(items[5].scan, frame_id="second")
    with pytest.raises(ConfigError, match=r"one LiDAR, got scans of .*choose one with clouds="):
        poses.posed(other)
    empty = Scan(items[6].scan.stamp_ns, np.full((100, 3), np.nan, np.float32))
    empty = replace(empty, frame_id=items[0].scan.frame_id, topic=items[0].scan.topic)
    told = LivePoses(lc.io.PoseOptions(pose="kiss"), LiveConfig())
    told.on_note = notes.append
    with (
        pytest.warns(OdometryWarning, match="0 points within reach"),
        pytest.raises(NoTransformError, match="KISS-ICP lost track"),
    ):
        told.posed(empty)
    assert len(notes) == 1


def test_live_with_pose_kiss(tmp_path, flight):
    """A replay of a recording without poses: every scan is processed, and has a pose."""
    items, _ = flight
    lc.io.write_npz(tmp_path / "r.npz", [item.scan for item in items[:3]])
    arguments = ["live", "--replay", str(tmp_path / "r.npz"), "--rate", "0.1", "--pose", "kiss"]
    done = CliRunner().invoke(app, [*arguments, "--json", str(tmp_path / "s.json")])
    assert done.exit_code == 0, done.output
    summary = json.loads((tmp_path / "s.json").read_text())
    assert summary["processed"] + sum(summary["dropped"].values()) == 3
    assert summary["processed"] > 0
    assert not summary["without_pose"]


def test_without_the_package_the_extra_is_named(monkeypatch):
    import sys

    monkeypatch.setitem(sys.modules, "kiss_icp", None)
    with pytest.raises(MissingExtraError, match=re.escape(install_command("odometry"))):
        KissOdometry()


def poses_of_street(recordings, tmp_path, scans):
    """Poses of the first scans of a car without stamps, the files, and poses found offline."""
    folder = recordings / "3d/sequences/street_128_labelled"
    packed = folder / "lidar_rounded_000000-000029.tar.xz"
    names = unpack(packed, tmp_path, suffix=".pcd", most=scans)
    known = np.tile(np.eye(4), (30, 1, 1))
    known[:, :3] = np.loadtxt(folder / "poses_icp.txt").reshape(-1, 3, 4)
    with warnings.catch_warnings(), lc.io.open_recording((tmp_path / names[0]).parent) as opened:
        warnings.simplefilter("error")
        items = list(lc.io.posed_scans(opened, pose="kiss"))
    assert len(items) == scans
    return items, known


def test_kiss_on_a_real_street(recordings, tmp_path):
    """Too few scans to show their times: the way agrees with poses found offline, within 6 %."""
    items, known = poses_of_street(recordings, tmp_path, 4)
    wrong = np.linalg.inv(np.linalg.inv(known[0]) @ known[3]) @ items[-1].world_from_lidar
    assert np.linalg.norm(wrong[:3, 3]) < 0.06 * np.linalg.norm(known[3][:3, 3] - known[0][:3, 3])


@pytest.mark.nightly
def test_structure_of_a_real_street_stays_where_it_is(recordings, tmp_path):
    """With times from the order of the points, scans fit much better than with poses of ICP."""
    items, known = poses_of_street(recordings, tmp_path, 10)

    def apart(poses):
        """Median distance between the structure of two scans that are five scans apart [m]."""
        worlds = []
        for number in (3, 8):
            points = items[number].scan.points.reshape(-1, 3).astype(np.float64)
            motion = np.linalg.inv(poses[number - 1]) @ poses[number]
            of_point, parts, _, _ = untimed.parts_of_scan(points)
            moved = untimed.moved(points, of_point, parts, motion)
            ranges = np.linalg.norm(points, axis=1)
            stands = (ranges > 4) & (ranges < 20) & (points[:, 2] > -1.3)
            pose = poses[number]
            worlds.append(moved[stands] @ pose[:3, :3].T + pose[:3, 3])
        return np.median(cKDTree(worlds[0]).query(worlds[1][::20])[0])

    assert apart([item.world_from_lidar for item in items]) < 0.5 * apart(known)
