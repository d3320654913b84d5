"""Rays without return as drivers of 2D scanners give them: the map is the same."""

import numpy as np
import pytest

import lidar_core as lc
import reference.circles_front as oracle
from lidar_core.circles import CirclePipeline, CirclesConfig, Scanner
from lidar_core.circles.scan_layout import scanner_of
from lidar_core.errors import InputError

SCANNER = Scanner(-np.pi, np.pi / 180, 360, 0.1, 12.0)
POSTS = np.array([(3.0, 0.5, 0.2), (-2.0, 3.0, 0.3), (1.0, -4.0, 0.25)])


def open_field(count=40, masked=()):
    """Ranges and poses of a robot that drives between posts."""
    rng = np.random.default_rng(4400)
    for number in range(count):
        pose = oracle.pose((0.03 * number, 0.0, 0.0), yaw=0.02 * number, pitch=0.0, roll=0.0)
        ranges = oracle.cylinder_ranges(SCANNER.bearings(), pose, POSTS)
        ranges = (ranges + rng.normal(0, 0.01, len(ranges))).astype(np.float32)
        ranges[list(masked)] = np.nan
        yield ranges, pose, (number + 20) * 50_000_000


def run(scans, change=lambda ranges: ranges, config=None):
    pipeline = CirclePipeline(config or CirclesConfig(scanner=SCANNER))
    frames = [pipeline.process(change(ranges), pose, stamp) for ranges, pose, stamp in scans]
    return pipeline, frames


def marked(value):
    return lambda ranges: np.where(np.isposinf(ranges), np.float32(value), ranges)


def assert_same_maps(found, expected):
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_array_equal(one.map.id, other.map.id)
        np.testing.assert_array_equal(one.map.center, other.map.center)
        np.testing.assert_array_equal(one.map.covariance, other.map.covariance)


@pytest.mark.parametrize(
    ("value", "name"), [(0.0, "zero"), (SCANNER.range_max, "inf"), (65.533, "inf")]
)
def test_other_marks_of_a_miss_give_the_same_map(value, name):
    usual, expected = run(open_field())
    pipeline, found = run(open_field(), marked(value))
    assert len(expected[-1].map.id) == len(POSTS)
    assert_same_maps(found, expected)
    assert (pipeline.health().no_return, usual.health().no_return) == (name, "inf")


def test_nan_is_a_miss_once_the_rays_have_worked():
    mask = range(300, 330)
    _, expected = run(open_field(120, mask))
    pipeline, found = run(open_field(120, mask), marked(np.nan))
    assert pipeline.health().no_return == "nan"
    last, other = found[-1], expected[-1]
    assert np.isnan(last.ranges[list(mask)]).all(), "the mask stays no information"
    apart = np.linalg.norm(last.map.center[:, None] - other.map.center, axis=2)
    assert (apart.min(axis=0) < 0.01).all()


def test_nan_of_a_few_bad_rays_and_of_a_mask_is_no_information():
    """A room: walls at 5 m, posts, ten masked rays, and three bad rays elsewhere in every scan."""
    rng = np.random.default_rng(4401)

    def in_a_room(ranges):
        ranges = np.minimum(ranges, 5 + rng.normal(0, 0.01, len(ranges))).astype(np.float32)
        ranges[100:110] = np.nan
        ranges[rng.integers(0, len(ranges), 3)] = np.nan
        return ranges

    pipeline, frames = run(open_field(120), in_a_room)
    assert pipeline.health().no_return == "inf"
    assert not np.isposinf(frames[-1].ranges).any()


def test_the_stages_as_published_take_ranges_as_they_are():
    pipeline, frames = run(
        open_field(), marked(0.0), CirclesConfig.paper(scanner=SCANNER, detector="taubin")
    )
    assert pipeline.health().no_return == "inf"
    assert not np.isposinf(frames[-1].ranges).any()


def test_the_meaning_is_saved_and_a_refused_scan_does_not_change_it(tmp_path):
    scans = list(open_field(60))
    whole, expected = run(scans, marked(0.0))
    pipeline, _ = run(scans[:30], marked(0.0))
    ranges, pose, stamp = scans[29]
    before = pipeline._state()[0]
    with pytest.raises(InputError):
        pipeline.process(np.full_like(ranges, np.inf), pose, stamp)  # this stamp was processed
    assert pipeline._state()[0] == before
    pipeline.save(tmp_path / "state")
    again = CirclePipeline.load(tmp_path / "state")
    found = [again.process(marked(0.0)(r), pose, stamp) for r, pose, stamp in scans[30:]]
    assert_same_maps(found, expected[30:])
    assert again.health().no_return == whole.health().no_return == "zero"


def test_a_real_vehicle_is_seen_with_zeros_and_with_nan(recordings):
    """An RPLIDAR with +inf, as if its driver gave zero, its limit or NaN for a miss."""
    with lc.io.open_recording(recordings / "2d/datmo/overtake_ego.bag") as recording:
        items = list(
            lc.io.posed_laser_scans(recording, mounting=["ego_pose laser -0.12 0 0 0 0 0"])
        )

    def moving(change):
        scanner = scanner_of(items[0].scan, CirclesConfig(), "scan")
        pipeline = CirclePipeline(CirclesConfig(scanner=scanner))
        seen = 0
        for item in items:
            pose, stamp = item.world_from_lidar, item.scan.stamp_ns
            frame = pipeline.process(change(np.asarray(item.scan.ranges)), pose, stamp)
            seen += bool((np.linalg.norm(frame.map.velocity, axis=1) > 0.3).any())
        return seen

    usual = moving(lambda ranges: ranges)
    assert usual > 60
    assert moving(marked(0.0)) == usual
    assert moving(marked(items[0].scan.range_max)) == usual
    assert moving(marked(np.nan)) > 0.9 * usual
