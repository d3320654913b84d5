"""Clouds of moving spinning sensors without the times of points."""

import numpy as np
import pytest

from lidar_core.flying import FlyingConfig, FlyingObjectDetector, SensorConfig
from reference import untimed

PERIOD_NS = 100_000_000
BOXES = np.array(
    [
        [[-30, 11, -2], [60, 11.5, 6]],  # facades and the ground
        [[-30, -9.5, -2], [60, -9, 6]],
        [[-40, -20, -2.5], [80, 20, -1.8]],
        [[-12, 8, -2], [-9, 11, 4]],  # bays of the facades
        [[2, 8.5, -2], [4, 11, 5]],
        [[14, 8, -2], [17, 11, 3]],
        [[26, 7.5, -2], [28, 11, 5]],
        [[-6, -9, -2], [-4, -6.5, 4]],
        [[8, -9, -2], [11, -6, 5]],
        [[20, -9, -2], [22, -7, 3]],
        [[-20, -2, -2], [-19, 2, 4]],
        [[44, -3, -2], [45, 3, 4]],
    ],
    np.float64,
)
ELEVATIONS = np.radians(np.linspace(-14, 14, 16))


def cast(origins, directions):
    """Ranges to the nearest of `BOXES`; inf without."""
    nearest = np.full(len(origins), np.inf)
    with np.errstate(divide="ignore", invalid="ignore"):
        for low, high in BOXES:
            first, second = (low - origins) / directions, (high - origins) / directions
            enter = np.minimum(first, second).max(axis=1)
            leave = np.maximum(first, second).min(axis=1)
            hit = (enter <= leave) & (enter > 0)
            nearest = np.where(hit & (enter < nearest), enter, nearest)
    return nearest


def pose_at(time, *, speed, yaw_rate):
    """Pose of a sensor that drives along x and turns [s, m/s, rad/s]."""
    pose = np.eye(4)
    angle = yaw_rate * time
    pose[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    pose[:3, 3] = [speed * time, 0.3 * speed * time, 0.02 * speed * time]
    return pose


def drive(
    *,
    scans=7,
    turn=1.09,
    columns=900,
    speed=6.0,
    yaw_rate=0.0,
    is_moved=False,
    sense=-1,
    sigma=0.01,
):
    """Scans of a spinning sensor in the order of firing, without times, and their poses.

    `turn`: turns per scan. `is_moved`: a driver has moved the points to the middle of the scan.
    """
    rng = np.random.default_rng(5)
    every, poses = [], []
    for number in range(scans):
        part = np.arange(columns) / columns
        azimuth = 0.4 + sense * 2 * np.pi * turn * (number + part)
        level = np.stack([np.cos(azimuth), np.sin(azimuth), np.zeros(columns)], axis=1)
        rays = np.cos(ELEVATIONS)[:, None] * level[:, None] + np.sin(ELEVATIONS)[:, None] * [
            0,
            0,
            1,
        ]
        middle = pose_at((number + 0.5) * 0.1, speed=speed, yaw_rate=yaw_rate)
        times = np.repeat((number + part) * 0.1, 16)
        at = np.stack([pose_at(time, speed=speed, yaw_rate=yaw_rate) for time in times[::16]])
        at = np.repeat(at, 16, axis=0)
        rays = rays.reshape(-1, 3)
        ranges = cast(at[:, :3, 3], np.einsum("nij,nj->ni", at[:, :3, :3], rays))
        ranges = ranges + rng.normal(0, sigma, len(ranges))
        sees = ranges < 50
        points = (ranges[:, None] * rays)[sees]
        if is_moved:
            world = np.einsum("nij,nj->ni", at[sees, :3, :3], points) + at[sees, :3, 3]
            points = (world - middle[:3, 3]) @ middle[:3, :3]
        every.append(points.astype(np.float32))
        poses.append(middle)
    return every, poses


def frames_of(scans, poses, *, config=None, times=None):
    """Frames of a detector, and the detector. `times`: times and poses of a scan, or None."""
    detector = FlyingObjectDetector(config or FlyingConfig())
    frames = []
    for number, (points, pose) in enumerate(zip(scans, poses, strict=True)):
        stamp = number * PERIOD_NS
        given = times(number) if times else None
        if given is None:
            frames.append(detector.process(points, pose, stamp))
        else:
            point_time, stream, stamps = given
            options = {"point_time_ns": point_time, "pose_stamps_ns": stamps}
            frames.append(detector.process(points, stream, stamp, **options))
    return frames, detector


def off_surface(detector):
    """Share of the occupied voxels that are no part of `BOXES`."""
    centers = detector.occupied_points()
    apart = np.maximum(BOXES[:, 0] - centers[:, None], centers[:, None] - BOXES[:, 1])
    return float((np.linalg.norm(np.maximum(apart, 0), axis=2).min(axis=1) > 0.25).mean())


CASES = {
    "straight": {},
    "the other sense of turning": {"sense": 1},
    "little overlap": {"turn": 1.02},
    "turning": {"speed": 1.0, "yaw_rate": -0.6},
    "slow": {"speed": 3.0},
    "noisy": {"sigma": 0.03},
}


@pytest.mark.parametrize("name", CASES)
def test_points_are_moved_where_the_ends_show_it(name):
    scans, poses = drive(**CASES[name])
    frames, detector = frames_of(scans, poses)
    found = [frame.status.point_times for frame in frames]
    expected = untimed.is_estimated([points.astype(np.float64) for points in scans], poses)
    assert found == [{True: "estimated", False: "none"}[one] for one in expected]
    assert found[-3:] == ["estimated"] * 3
    assert detector.health().point_times == "estimated"


@pytest.mark.parametrize("name", CASES)
def test_points_that_a_driver_has_moved_are_left_alone(name):
    scans, poses = drive(**CASES[name], is_moved=True)
    frames, detector = frames_of(scans, poses)
    assert {frame.status.point_times for frame in frames} == {"none"}
    assert off_surface(detector) < 0.02
    expected = untimed.is_estimated([points.astype(np.float64) for points in scans], poses)
    assert not any(expected)


def test_estimated_times_give_what_given_times_give():
    scans, poses = drive(yaw_rate=0.3)
    expected = untimed.is_estimated([points.astype(np.float64) for points in scans], poses)

    def times(number):
        if not expected[number]:
            return None
        motion = np.linalg.inv(poses[number - 1]) @ poses[number]
        of_point, parts, _, _ = untimed.parts_of_scan(scans[number].astype(np.float64))
        time = number * PERIOD_NS + np.round((parts - 0.5) * PERIOD_NS).astype(np.int64)
        ends = np.stack([poses[number] @ untimed.part_of(motion, end) for end in (-0.5, 0.5)])
        stamps = number * PERIOD_NS + np.array([-1, 1]) * PERIOD_NS // 2
        return time[of_point], ends, stamps

    found, detector = frames_of(scans, poses)
    given, reference = frames_of(scans, poses, times=times)
    assert found[-1].status.point_times == "estimated"
    assert given[-1].status.point_times == "given"
    for one, other in zip(found, given, strict=True):
        same = one.point_class == other.point_class
        assert same.mean() > 0.999  # times are rounded to nanoseconds
    voxels = {tuple(np.round(center, 3)) for center in detector.occupied_points()}
    others = {tuple(np.round(center, 3)) for center in reference.occupied_points()}
    assert len(voxels ^ others) <= 0.002 * len(voxels)


def test_moved_points_make_a_sharper_map():
    scans, poses = drive(scans=10)
    _, detector = frames_of(scans, poses)
    as_they_are = [np.full(len(points), number * PERIOD_NS) for number, points in enumerate(scans)]
    blurred = FlyingObjectDetector(FlyingConfig())
    for number, (points, pose) in enumerate(zip(scans, poses, strict=True)):
        # Given times are never doubted: these say that all points are of the stamp.
        stamp = number * PERIOD_NS
        frame = blurred.process(points, pose, stamp, point_time_ns=as_they_are[number])
        assert frame.status.point_times == "given"
    assert off_surface(detector) < 0.5 * off_surface(blurred)


def test_a_saved_detector_remembers_what_its_clouds_are(tmp_path):
    scans, poses = drive()
    frames, detector = frames_of(scans[:5], poses[:5])
    assert frames[-1].status.point_times == "estimated"
    detector.save(tmp_path / "state")
    restored = FlyingObjectDetector.load(tmp_path / "state")
    stamp = 5 * PERIOD_NS
    one, other = (each.process(scans[5], poses[5], stamp) for each in (detector, restored))
    assert other.status.point_times == "estimated"
    assert np.array_equal(one.point_class, other.point_class)


def test_a_missing_scan_does_not_double_the_motion():
    scans, poses = drive(scans=9)
    detector = FlyingObjectDetector(FlyingConfig())
    for number in (0, 1, 2, 3, 5, 7, 8):
        frame = detector.process(scans[number], poses[number], number * PERIOD_NS)
    assert frame.status.point_times == "estimated"
    assert off_surface(detector) < 0.03


OTHERS = {
    "less than a turn": lambda scans: [points[: int(0.88 * len(points))] for points in scans],
    "row after row": lambda scans: [
        points[np.argsort(points[:, 2] / np.linalg.norm(points, axis=1), kind="stable")]
        for points in scans
    ],
    "shuffled": lambda scans: [np.random.default_rng(1).permutation(points) for points in scans],
    "empty": lambda scans: [points[:0] for points in scans],
}


@pytest.mark.parametrize("name", OTHERS)
def test_clouds_that_show_nothing_stay_as_they_are(name):
    scans, poses = drive()
    frames, _ = frames_of(OTHERS[name](scans), poses)
    assert {frame.status.point_times for frame in frames} == {"none"}


def test_nothing_is_estimated_where_all_is_given():
    scans, poses = drive()
    for config in (FlyingConfig(sensor=SensorConfig(beams="given")), FlyingConfig.paper()):
        frames, _ = frames_of(scans, poses, config=config)
        assert {frame.status.point_times for frame in frames} == {"none"}


def test_a_sensor_that_stands_needs_no_times():
    scans, poses = drive(speed=0.0)
    frames, _ = frames_of(scans, poses)
    assert {frame.status.point_times for frame in frames} == {"none"}
