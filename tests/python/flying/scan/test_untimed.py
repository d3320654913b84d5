"""Clouds of moving spinning sensors without the times of points."""

import numpy as np
import pytest
from untimed_clouds import BOXES, PERIOD_NS, drive

from lidar_core.flying import FlyingConfig, FlyingObjectDetector, SensorConfig
from reference import untimed


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


@pytest.mark.ci_cases("straight", "turning", "noisy")
@pytest.mark.parametrize("name", CASES)
def test_points_are_moved_where_the_ends_show_it(name):
    scans, poses = drive(**CASES[name])
    frames, detector = frames_of(scans, poses)
    found = [frame.status.point_times for frame in frames]
    expected = untimed.is_estimated([points.astype(np.float64) for points in scans], poses)
    assert found == [{True: "estimated", False: "none"}[one] for one in expected]
    assert found[-3:] == ["estimated"] * 3
    assert detector.health().point_times == "estimated"


@pytest.mark.ci_cases("turning", "noisy")
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
