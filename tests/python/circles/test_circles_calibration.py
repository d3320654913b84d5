"""What scans tell about their scanner: noise of the ranges, and poses that are late."""

import numpy as np
import pytest

import reference.circles_front as oracle
from lidar_core.circles import CircleMapConfig, CirclePipeline, CirclesConfig, FitConfig, Scanner
from lidar_core.runs.scans.circles import CirclesRun

SCANNER = Scanner(-np.pi, np.pi / 360, 720, 0.1, 12.0)
POSTS = np.array([(3.0, 0.5, 0.2), (-2.0, 3.0, 0.3), (1.0, -4.0, 0.25), (-4.0, -2.0, 0.2)])
RATE = 20.0


def turning(seconds):
    """A scanner that turns to and fro, by 0.6 rad/s at most."""
    return oracle.pose((0.0, 0.0, 0.0), yaw=1.2 * np.sin(0.5 * seconds), pitch=0.0, roll=0.0)


def run(*, std=0.01, late=0.0, where=turning, seconds=20.0, seed=4200, **more):
    """A pipeline that was given all scans, and NEES of (x, y, radius) in the last quarter."""
    rng = np.random.default_rng(seed)
    pipeline = CirclePipeline(CirclesConfig(scanner=SCANNER, **more))
    nees = []
    for scan in range(round(seconds * RATE)):
        time = scan / RATE
        ranges = oracle.cylinder_ranges(SCANNER.bearings(), where(time), POSTS)
        ranges = ranges + rng.normal(0, std, len(ranges))
        frame = pipeline.process(
            ranges.astype(np.float32), where(time - late), round(time * 1e9) + 10**9
        )
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
