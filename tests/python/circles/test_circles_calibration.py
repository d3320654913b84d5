"""What scans tell about their scanner: noise of the ranges, and poses that are late."""

import numpy as np
import pytest

import reference.circles_front as oracle
from lidar_core import sim
from lidar_core.circles import CircleMapConfig, CirclePipeline, CirclesConfig, FitConfig, Scanner
from lidar_core.runs.scans.circles_output import CirclesRun

SCANNER = Scanner(-np.pi, np.pi / 360, 720, 0.1, 12.0)
POSTS = np.array([(3.0, 0.5, 0.2), (-2.0, 3.0, 0.3), (1.0, -4.0, 0.25), (-4.0, -2.0, 0.2)])
RATE = 20.0


def turning(seconds):
    """A scanner that turns to and fro, by 0.6 rad/s at most."""
    return oracle.pose((0.0, 0.0, 0.0), yaw=1.2 * np.sin(0.5 * seconds), pitch=0.0, roll=0.0)


def run(
    *, std=0.01, late=0.0, where=turning, told=None, seconds=20.0, seed=4200, rate=RATE, **more
):
    """A pipeline that was given all scans, and NEES of (x, y, radius) in the last quarter.

    The scanner is at `where(time)`, and its pose says `told(time)`.
    """
    told = told or (lambda time: where(time - late))
    rng = np.random.default_rng(seed)
    pipeline = CirclePipeline(CirclesConfig(scanner=SCANNER, **more))
    nees = []
    for scan in range(round(seconds * rate)):
        time = scan / rate
        ranges = oracle.cylinder_ranges(SCANNER.bearings(), where(time), POSTS)
        ranges = ranges + rng.normal(0, std, len(ranges))
        frame = pipeline.process(ranges.astype(np.float32), told(time), round(time * 1e9) + 10**9)
        if time < 0.75 * seconds:
            continue
        for center, radius, P in zip(
            frame.map.center, frame.map.radius, frame.map.covariance, strict=True
        ):
            error = np.r_[center, radius] - POSTS
            error = error[np.linalg.norm(error[:, :2], axis=1).argmin()]
            nees.append(error @ np.linalg.solve(P[np.ix_([0, 1, 4], [0, 1, 4])], error))
    return pipeline, float(np.mean(nees))


@pytest.mark.parametrize(("std", "told"), [(0.03, 0.01), (0.01, 0.01), (0.01, 0.04)])
def test_the_noise_of_the_ranges_is_found_and_used(std, told):
    pipeline, nees = run(std=std, fit=FitConfig(range_std=told))
    assert pipeline.health().range_std_estimated == pytest.approx(std, rel=0.1)
    assert 0.9 < nees < 5  # 3 values


def test_covariances_are_true_for_a_scanner_at_rest():
    # The rays meet every post alike in all scans: the errors of its sides do not average out.
    found = [run(where=lambda _: np.eye(4), seconds=5.0, seed=4300 + k)[1] for k in range(3)]
    assert 0.9 < np.mean(found) < 5


@pytest.mark.parametrize("late", [0.05, -0.04])
def test_late_and_early_poses_are_found_told_and_moved_on(late):
    pipeline, nees = run(late=late)
    assert pipeline.health().pose_offset_s == pytest.approx(late, abs=0.005)
    assert 0.9 < nees < 5
    (note,) = CirclesRun(pipeline, film=False).notes
    assert note.startswith(f"poses are {abs(late) * 1e3:.0f} ms {'late' if late > 0 else 'early'}")


def test_poses_in_time_are_left_as_they_are():
    pipeline, _ = run()
    assert abs(pipeline.health().pose_offset_s) < 0.003
    assert CirclesRun(pipeline, film=False).notes == []


def test_a_scanner_that_turns_steadily_cannot_tell_and_says_so():
    def steadily(seconds):
        return oracle.pose((0.0, 0.0, 0.0), yaw=0.4 * seconds, pitch=0.0, roll=0.0)

    pipeline, _ = run(late=0.05, where=steadily)
    assert pipeline.health().pose_offset_s is None


@pytest.mark.parametrize(
    ("rate", "late", "is_found"), [(5, 0.03, True), (4, 0.03, False), (10, 0.3, False)]
)
def test_scans_too_far_apart_and_long_delays_leave_the_offset_open(rate, late, is_found):
    """Limits that the guide states: None is "not determined", not "in time"."""
    offset = run(late=late, rate=rate, seconds=40.0)[0].health().pose_offset_s
    assert (offset is not None) == is_found
    assert offset is None or offset == pytest.approx(late, abs=0.005)


def driving(seconds):
    """A scanner that drives along at 0.4 m/s."""
    return oracle.pose((0.4 * seconds - 1.0, 0.0, 0.0), yaw=0.3, pitch=0.0, roll=0.0)


@pytest.mark.parametrize("where", [turning, driving])
def test_poses_that_stop_while_the_scanner_moves_are_told(where):
    pipeline, _ = run(where=where, told=lambda time: where(min(time, 2.0)), seconds=4.0)
    stuck = pipeline.health().stuck_poses
    assert 20 <= stuck <= 40  # of the 40 scans of the last 2 s; the first show it too little
    (note,) = CirclesRun(pipeline, film=False).notes
    assert note.startswith(f"at least {stuck} scans have a pose that stays the same")


@pytest.mark.parametrize("where", [turning, driving, lambda _: np.eye(4)])
def test_right_poses_are_not_stuck(where):
    pipeline, _ = run(where=where, seconds=4.0)
    assert pipeline.health().stuck_poses == 0


@pytest.mark.parametrize("count", [4, 9])
def test_a_scanner_at_rest_among_people_is_not_stuck(count):
    rng = np.random.default_rng(4250)
    pipeline = CirclePipeline(CirclesConfig(scanner=SCANNER))
    ways = rng.uniform(-1, 1, (count, 2))
    start = POSTS
    if count > len(POSTS):
        bearings, away = np.linspace(-2.0, 2.0, count), rng.uniform(1.5, 5.0, count)
        sizes = rng.uniform(0.15, 0.3, count)
        start = np.c_[away * np.cos(bearings), away * np.sin(bearings), sizes]
    for scan in range(60):
        people = start + np.c_[ways * scan / RATE, np.zeros(count)]
        ranges = oracle.cylinder_ranges(SCANNER.bearings(), np.eye(4), people)
        ranges = ranges + rng.normal(0, 0.01, len(ranges))
        pipeline.process(ranges.astype(np.float32), np.eye(4), scan * 50_000_000)
    assert pipeline.health().stuck_poses == 0


def test_poses_that_stop_are_told_where_a_part_of_the_room_moves():
    """Posts go their own ways before walls and other posts."""
    scene = sim.circle_scenes.several(1000, walls=True, sensor="swinging", scans=110)
    pipeline, stopped = CirclePipeline(), 80
    for number, sweep in enumerate(sim.sweeps(scene, seed=1000)):
        if number < stopped:
            assert pipeline.health().stuck_poses == 0
            poses = sweep.poses
        elif number == stopped:
            poses = np.repeat(sweep.poses[:1], len(sweep.poses), axis=0)
        scan = sweep.scan
        times = scan.stamp_ns + scan.time_increment_ns * np.arange(len(scan.ranges))
        stamps = {"ray_time_ns": times, "pose_stamps_ns": sweep.pose_stamps_ns}
        pipeline.process(scan.ranges, poses, scan.stamp_ns, **stamps)
    assert pipeline.health().stuck_poses >= 8


def test_paper_mode_estimates_nothing():
    pipeline, _ = run(std=0.03, late=0.05, seconds=2.0, map=CircleMapConfig.paper())
    health = pipeline.health()
    assert (health.range_std_estimated, health.pose_offset_s) == (None, None)


def test_a_saved_pipeline_goes_on_with_what_it_learnt(tmp_path):
    pipeline, _ = run(std=0.03, late=0.05, seconds=8.0)
    pipeline.save(tmp_path / "state")
    again = CirclePipeline.load(tmp_path / "state")
    ranges = oracle.cylinder_ranges(SCANNER.bearings(), turning(8.0), POSTS).astype(np.float32)
    for one in (pipeline, again):
        one.process(ranges, turning(7.95), 9 * 10**9)
    assert again.health() == pipeline.health()
    stamp = 9 * 10**9
    assert again.map_at(stamp).covariance.tobytes() == pipeline.map_at(stamp).covariance.tobytes()
