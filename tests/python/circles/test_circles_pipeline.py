"""Scans in, map out: the circle pipeline as a whole."""

import math
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from lidar_core import ConfigError, InputError, NumericalError
from lidar_core.circles import (
    CirclePipeline,
    Circles,
    CirclesConfig,
    PreprocessConfig,
    Scanner,
    fit_circles,
    limit_range,
    project_horizontal,
    segment,
)
from lidar_core.messages import LaserScan, PosedScan
from reference import circles_front as oracle

BEARINGS = Scanner().bearings()
PERIOD_NS = 50_000_000
RANGE_STD = 0.01


def scan_of(circles, where, rng=None):
    ranges = oracle.cylinder_ranges(BEARINGS, where, np.atleast_2d(circles))
    if rng is not None:
        ranges = ranges + rng.normal(0, RANGE_STD, len(ranges))
    return ranges.astype(np.float32)


def tilting(seconds):
    """The moving sensor of the trajectories: it sways, turns and tilts."""
    return oracle.pose(
        (0.5 * math.sin(0.8 * seconds), 0.0, 1.0),
        yaw=0.3 * math.sin(0.5 * seconds),
        pitch=math.radians(15) * math.sin(2 * math.pi * seconds / 4),
        roll=math.radians(10) * math.sin(2 * math.pi * seconds / 5),
    )


def elements_as_bytes(elements):
    arrays = (
        elements.id,
        elements.center,
        elements.velocity,
        elements.radius,
        elements.covariance,
        elements.age,
        elements.visible,
    )
    return b"".join(np.ascontiguousarray(array).tobytes() for array in arrays)


def frame_as_bytes(frame):
    arrays = (
        frame.ranges,
        frame.bearings,
        frame.segments.labels,
        frame.circles.parameters,
        frame.circles_world.covariance,
        frame.element,
    )
    return b"".join(array.tobytes() for array in arrays) + elements_as_bytes(frame.map)


def test_a_moving_object_is_followed_from_a_tilting_sensor():
    rng = np.random.default_rng(61)
    pipeline = CirclePipeline()
    errors, ids = [], set()
    for k in range(120):
        seconds, stamp = 0.05 * k, k * PERIOD_NS
        truth = np.array([4.0, -2.0 + 0.7 * seconds, 0.3])
        frame = pipeline.process(scan_of(truth, tilting(seconds), rng), tilting(seconds), stamp)
        if k >= 40:
            assert len(frame.map) == 1
            ids.add(int(frame.map.id[0]))
            state = [*frame.map.center[0], frame.map.radius[0]]
            errors.append(np.array(state) - truth)
            assert frame.element.tolist() == [0]
    assert ids == {0}
    rms = np.sqrt(np.mean(np.square(errors), axis=0))
    assert rms[:2].max() < 0.01
    assert rms[2] < 0.003
    np.testing.assert_allclose(frame.map.velocity[0], [0.0, 0.7], atol=0.1)
    assert set(frame.timing_ms) == {"prepare", "segment", "fit", "map"}
    later = pipeline.map_at(119 * PERIOD_NS + 10**9)
    np.testing.assert_allclose(later.center - frame.map.center, frame.map.velocity, atol=1e-9)


def test_what_is_too_near_is_left_out_and_waited_for():
    """A post comes to 0.06 m before the scanner, which measures from 0.1 m on, and goes again."""
    rng = np.random.default_rng(1062)
    pipeline, here = CirclePipeline(), oracle.pose((0, 0, 1))
    ids, too_near = set(), 0
    for step in range(100):
        away = 0.3 + 0.06 + 0.02 * abs(step - 50)
        frame = pipeline.process(scan_of((away, 0, 0.3), here, rng), here, step * PERIOD_NS)
        assert not (frame.too_near & (frame.element >= 0)).any()
        too_near += int(frame.too_near.sum())
        if step < 5:
            continue
        ids.update(frame.map.id.tolist())
        (x, y), covariance = frame.map.center[0], frame.map.covariance[0]
        off = np.array([x - away, y])
        assert off @ np.linalg.solve(covariance[:2, :2], off) < 25
    assert ids == {0}
    assert too_near >= 3


def test_the_stages_are_the_public_functions():
    arena = PreprocessConfig.box((-3.0, -3.0, 0.0), (6.0, 3.0, 4.0))
    config = CirclesConfig(preprocess=arena)
    where = tilting(1.3)
    circles = [(4.0, 0.0, 0.3), (5.0, 2.9, 0.4), (2.0, -5.0, 0.3)]
    ranges = scan_of(circles, where, np.random.default_rng(62))
    frame = CirclePipeline(config).process(ranges, where, 0)
    reached = np.where(ranges > 10, np.inf, ranges)
    limited = limit_range(reached, BEARINGS, where, planes=arena.planes)
    seen, bearings, _ = project_horizontal(reached, BEARINGS, where)
    _, _, heights = project_horizontal(limited, BEARINGS, where)
    np.testing.assert_array_equal(frame.bearings, bearings)
    np.testing.assert_array_equal(frame.ranges, np.where(np.isfinite(limited), seen, limited))
    np.testing.assert_array_equal(frame.heights, heights)
    found = segment(frame.ranges, frame.bearings, config=config.segment)
    np.testing.assert_array_equal(frame.segments.labels, found.labels)
    world = frame.circles_world.parameters
    np.testing.assert_allclose(world[np.argmin(world[:, 1])], circles[0], atol=0.05)
    # The second one reaches out of the volume: it is not taken to end there.
    assert len(frame.circles) == 2
    np.testing.assert_allclose(world[np.argmax(world[:, 1])], circles[1], atol=0.15)


def test_any_estimator_may_stand_between_segments_and_map():
    calls = []

    def estimator(ranges, bearings, segments):
        calls.append((ranges, bearings, segments))
        rows = [segments.rays_of(number + 1) for number in range(len(segments))]
        middle = [row[len(row) // 2] for row in rows]
        center = [
            (ranges[m] + 0.3) * np.array([np.cos(bearings[m]), np.sin(bearings[m])]) for m in middle
        ]
        parameters = np.column_stack([np.reshape(center, (-1, 2)), np.full(len(rows), 0.3)])
        covariance = np.tile(1e-4 * np.eye(3), (len(rows), 1, 1))
        return Circles(parameters, covariance, np.array([len(row) for row in rows], np.int64))

    pipeline = CirclePipeline(estimator=estimator)
    for k in range(5):
        frame = pipeline.process(scan_of((4, 1, 0.3), np.eye(4)), np.eye(4), k * PERIOD_NS)
    assert len(calls) == 5
    np.testing.assert_array_equal(calls[-1][0], frame.ranges)
    np.testing.assert_array_equal(calls[-1][2].labels, frame.segments.labels)
    np.testing.assert_allclose(frame.map.center, [[4.0, 1.0]], atol=0.02)
    pipeline.process(np.full(1081, np.inf), np.eye(4), 5 * PERIOD_NS)

    with pytest.raises(InputError, match="expected Circles, got list"):
        CirclePipeline(estimator=lambda *_: []).process(np.full(1081, np.inf), np.eye(4), 0)
    nobody = Circles(np.empty((0, 3)), np.empty((0, 3, 3)), np.empty(0, np.int64))
    few = CirclePipeline(estimator=lambda *_: nobody)
    with pytest.raises(InputError, match=r"circles: expected shape \(1, 3\)"):
        few.process(scan_of((4, 1, 0.3), np.eye(4)), np.eye(4), 0)


BEAM = math.pi / 360
AROUND = Scanner(-math.pi, BEAM, 720, 0.1, 10.0)


def posed_sweep(angle_min, angle_increment, stamp_ns=0, rays=720, topic="/scan"):
    ranges = np.full(rays, 3.0, np.float32)
    scan = LaserScan(stamp_ns, ranges, angle_min, angle_increment, 0.1, 10.0, topic=topic)
    return PosedScan(scan, np.eye(4))


@pytest.mark.parametrize(
    ("angle_min", "angle_increment"),
    [
        (math.pi - BEAM, -BEAM),  # mirrored
        (0.0, BEAM),
        (-math.pi / 2, BEAM / 2),
        (-math.pi + 0.5 * BEAM, BEAM),
        (-math.pi, BEAM * (1 + 1e-3)),
        (math.nan, BEAM),
        (-math.pi, math.inf),
    ],
)
def test_bearings_that_contradict_the_scanner_are_refused(angle_min, angle_increment):
    pipeline = CirclePipeline(CirclesConfig(scanner=AROUND))
    pipeline.process(posed_sweep(-math.pi, BEAM))
    before = pipeline.map_at(0)
    expected = (
        r"expected the bearings of `scanner`, 720 rays with angle_min=-3\.14159,"
        rf" angle_increment=0\.00872665, got 720 rays with angle_min={angle_min:.6g},"
        rf" angle_increment={angle_increment:.6g}; .*Scanner\(scan\.angle_min"
    )
    with pytest.raises(InputError, match=expected):
        pipeline.process(posed_sweep(angle_min, angle_increment, PERIOD_NS))
    assert elements_as_bytes(pipeline.map_at(0)) == elements_as_bytes(before)
    assert pipeline.process(posed_sweep(-math.pi, BEAM, PERIOD_NS)).rejected is None
    counting = CirclePipeline(CirclesConfig(scanner=AROUND, on_bad_scan="count"))
    rejected = counting.process(posed_sweep(angle_min, angle_increment)).rejected
    assert rejected is not None
    assert "angle_increment" in rejected
    assert counting.health().rejected == 1


def test_a_bearing_that_is_no_number_is_named():
    pipeline = CirclePipeline(CirclesConfig(scanner=AROUND))
    with pytest.raises(InputError, match=r"scan\.angle_min: expected a number, got NoneType"):
        pipeline.process(posed_sweep(None, BEAM))


def test_rounded_bearings_are_those_of_the_scanner():
    """Float32 angles of drivers, angles in a file, and a start that is one turn away."""
    starts = (float(np.float32(-math.pi)), -3.1416, math.pi)
    steps = (float(np.float32(BEAM)), 0.0087266, BEAM)
    pipeline = CirclePipeline(CirclesConfig(scanner=AROUND))
    for number, (start, step) in enumerate(zip(starts, steps, strict=True)):
        assert pipeline.process(posed_sweep(start, step, number * PERIOD_NS)).rejected is None


def test_a_named_scanner_overrides_what_its_scans_state():
    pipeline = CirclePipeline(CirclesConfig(scanners={"/scan": AROUND}))
    frame = pipeline.process(posed_sweep(math.pi - BEAM, -BEAM))
    np.testing.assert_allclose(frame.bearings, AROUND.bearings())
    with pytest.raises(InputError, match="expected the bearings"):
        pipeline.process(posed_sweep(0.0, 0.001, PERIOD_NS, rays=1081, topic="/other"))


@pytest.mark.parametrize(("factor", "far"), [(1000, 3), (1, 0)])
def test_health_counts_scans_in_millimetres(factor, far):
    pipeline = CirclePipeline()
    ranges = factor * scan_of([(4, 1, 0.3), (3, -2, 1.0), (5, 4, 2.0)], np.eye(4))
    for number in range(3):
        pipeline.process(ranges, np.eye(4), number * PERIOD_NS)
    assert pipeline.health().far_scans == far
    assert CirclePipeline.from_bytes(pipeline.to_bytes()).health().far_scans == far


def test_two_scanners_make_one_map():
    half = Scanner(-1.0, 0.005, 401, 0.1, 10.0)
    pipeline = CirclePipeline(CirclesConfig(scanners={"left": half, "right": half}))
    poses = {"left": oracle.pose(yaw=0.9), "right": oracle.pose(yaw=-0.9)}
    truth = {"left": (2.0, 3.0, 0.25), "right": (2.0, -3.0, 0.25)}
    both = (4.0, 0.0, 0.3)
    for k in range(10):
        for name, where in poses.items():
            ranges = oracle.cylinder_ranges(half.bearings(), where, np.array([truth[name], both]))
            frame = pipeline.process(ranges, where, k * PERIOD_NS, scanner=name)
    assert frame.scanner == "right"
    found = pipeline.map_at(10 * PERIOD_NS)
    order = np.argsort(found.center[:, 1])
    expected = [truth["right"][:2], both[:2], truth["left"][:2]]
    np.testing.assert_allclose(found.center[order], expected, atol=0.03)
    assert len(pipeline.process(np.full(1081, np.inf), np.eye(4), 10 * PERIOD_NS).map) == 3


def test_motion_during_the_sweep_is_taken_out():
    """At 1 rad/s a sweep of 18.75 ms smears 0.13 m at 7 m."""
    sweep_ns = 18_750_000
    truth = (4.9, 4.9, 0.3)

    def run(with_times):
        pipeline = CirclePipeline()
        for k in range(10):
            stamp = k * PERIOD_NS
            times = stamp + np.linspace(0, sweep_ns, 1081).astype(np.int64)
            each = np.array([oracle.pose(yaw=t * 1e-9) for t in times])
            ticks = stamp + np.array([0, sweep_ns])
            if with_times:
                poses = np.array([oracle.pose(yaw=t * 1e-9) for t in ticks])
                options = {"ray_time_ns": times, "pose_stamps_ns": ticks}
            else:
                poses, options = oracle.pose(yaw=stamp * 1e-9), {}
            frame = pipeline.process(scan_of(truth, each), poses, stamp, **options)
        return np.hypot(*(frame.map.center[0] - truth[:2]))

    assert run(with_times=True) < 0.005
    assert run(with_times=False) > 0.05


def test_what_moves_during_the_sweep_is_where_it_was_at_the_stamp():
    """At 1.5 m/s the middle of a sweep of 40 ms is 30 mm on."""
    sweep_ns = 40_000_000
    after = np.linspace(0, sweep_ns, 1081).astype(np.int64)

    def run(**options):
        pipeline = CirclePipeline()
        for k in range(40):
            y = -1.5 + 1.5 * (k * PERIOD_NS + after) * 1e-9
            seen = [
                oracle.cylinder_ranges(BEARINGS, oracle.pose((0.0, -one, 0.0)), (4, 0, 0.3))
                for one in y[::20]
            ]
            ranges = np.array(seen)[np.arange(1081) // 20, np.arange(1081)]
            times = dict.fromkeys(options, k * PERIOD_NS + after)
            frame = pipeline.process(ranges, np.eye(4), k * PERIOD_NS, **times)
        return frame.map.center[0, 1] - y[0]

    assert abs(run(ray_time_ns=True)) < 0.006
    assert run() > 0.02


def test_a_wall_stays_out_of_the_map():
    wall = 3.0 / np.cos(BEARINGS)
    ranges = np.where(np.abs(BEARINGS) < 0.8, wall, np.inf)
    pipeline = CirclePipeline()
    for k in range(10):
        frame = pipeline.process(ranges, np.eye(4), k * PERIOD_NS)
    assert len(frame.segments) == 1
    assert frame.element.tolist() == [-1]
    assert len(frame.map) == 0


def test_an_uncertain_pose_makes_uncertain_elements():
    spread = {}
    for doubt in (0.0, 0.02):
        pipeline = CirclePipeline()
        for k in range(10):
            frame = pipeline.process(
                scan_of((5, 0, 0.3), np.eye(4)),
                np.eye(4),
                k * PERIOD_NS,
                pose_covariance=doubt**2 * np.eye(6),
            )
        spread[doubt] = frame.map.covariance[0, 1, 1]
    assert spread[0.02] > 3 * spread[0.0]


def test_the_paper_runs():
    pipeline = CirclePipeline(CirclesConfig.paper())
    rng = np.random.default_rng(63)
    for k in range(20):
        frame = pipeline.process(scan_of((4, 1, 0.3), np.eye(4), rng), np.eye(4), k * PERIOD_NS)
    assert len(frame.map) == 1
    np.testing.assert_allclose(frame.map.center, [[4, 1]], atol=0.05)


ONES = np.ones(1081, np.float32)
BAD = {
    "rays": ((ONES[:-1], np.eye(4), 10**9), {}, r"ranges: expected 1081 rows, got 1080"),
    "shape": ((ONES.reshape(1, -1), np.eye(4), 10**9), {}, "ranges: expected shape"),
    "kind": ((ONES.astype(complex), np.eye(4), 10**9), {}, "ranges: expected real numbers"),
    "pose": ((ONES, np.full((4, 4), np.nan), 10**9), {}, "world_from_lidar: expected a finite"),
    "scale": ((ONES, 2 * np.eye(4), 10**9), {}, "world_from_lidar: expected a finite rotation"),
    "past": ((ONES, np.eye(4), -(10**9)), {}, "later than the map can go back"),
    "again": ((ONES, np.eye(4), 4 * PERIOD_NS), {}, "it was processed"),
    "stamp": ((ONES, np.eye(4), 1.5), {}, "stamp_ns: expected an integer"),
    "scanner": ((ONES, np.eye(4), 10**9), {"scanner": 3}, "scanner: expected a name, got int"),
    "stream": ((ONES, np.stack([np.eye(4)] * 2), 10**9), {}, "pose_stamps_ns"),
    "times": ((ONES, np.eye(4), 10**9), {"ray_time_ns": [1, 2]}, "ray_time_ns: expected shape"),
    "clock": (
        (ONES, np.eye(4), 10**9),
        {"ray_time_ns": np.full(1081, 10**18)},
        "times within 10 s of `stamp_ns`",
    ),
    "doubt": (
        (ONES, np.eye(4), 10**9),
        {"pose_covariance": -np.eye(6), "scanner": "new"},
        r"pose_covariance\[0\]: expected a symmetric matrix without negative eigenvalues",
    ),
}


def test_a_failing_estimator_leaves_no_trace():
    def estimator(ranges, bearings, segments):
        if failing:
            raise RuntimeError("broken")
        return Circles(np.empty((0, 3)), np.empty((0, 3, 3)), np.empty(0, np.int64))

    pipeline = CirclePipeline(estimator=estimator)
    nothing = np.full(1081, np.inf, np.float32)
    failing = True
    for number in range(100):  # more names than a pipeline takes
        with pytest.raises(RuntimeError, match="broken"):
            pipeline.process(nothing, np.eye(4), 0, scanner=f"name {number}")
    failing = False
    assert pipeline.process(nothing, np.eye(4), 0, scanner="good").rejected is None


def test_an_estimator_is_a_function():
    with pytest.raises(ConfigError, match="estimator: expected a function of"):
        CirclePipeline(estimator=5)


@pytest.mark.parametrize("pitch", [89.0, 90.0, 91.0])
def test_a_vertical_scan_plane_is_told(pitch):
    ranges = scan_of((4.0, 0.0, 0.3), np.eye(4))
    where = oracle.pose((0.0, 0.0, 1.0), yaw=0.3, pitch=math.radians(pitch), roll=0.0)
    with pytest.raises(InputError, match=r"not nearly vertical, got a tilt of (89|90)\.0 deg"):
        CirclePipeline().process(ranges, where, 0)


@pytest.mark.parametrize("name", BAD)
def test_a_bad_scan_is_refused_and_changes_nothing(name):
    arguments, options, text = BAD[name]
    met, spared = (CirclePipeline() for _ in range(2))
    counting = CirclePipeline(CirclesConfig(on_bad_scan="count"))
    good = [scan_of((4, 0.1 * k, 0.3), np.eye(4)) for k in range(8)]
    for k in range(5):
        for pipeline in (met, spared, counting):
            pipeline.process(good[k], np.eye(4), k * PERIOD_NS)
    with pytest.raises(InputError, match=text):
        met.process(*arguments, **options)
    rejected = counting.process(*arguments, **options)
    assert rejected.rejected is not None
    assert len(rejected.circles) == len(rejected.segments) == 0
    for k in range(5, 8):
        frames = [
            pipeline.process(good[k], np.eye(4), k * PERIOD_NS)
            for pipeline in (met, spared, counting)
        ]
        assert len({frame_as_bytes(frame) for frame in frames}) == 1
    health = met.health()
    assert (health.received, health.processed, health.rejected) == (9, 8, 1)
    assert counting.health() == health


def test_every_error_of_a_scan_is_counted_by_its_reason():
    def estimator(ranges, bearings, segments):
        raise NumericalError("S is not positive definite")

    scan, limit = scan_of((4, 0, 0.3), np.eye(4)), 64
    broken = CirclePipeline(CirclesConfig(on_bad_scan="count"), estimator=estimator)
    for k in range(3):
        assert broken.process(scan, np.eye(4), k * PERIOD_NS).rejected is not None
    assert broken.health().reasons == {"S is not positive definite": 3}
    with pytest.raises(NumericalError):
        CirclePipeline(estimator=estimator).process(scan, np.eye(4), 0)
    pipeline = CirclePipeline(CirclesConfig(on_bad_scan="count"))
    for k in range(limit + 2):
        frame = pipeline.process(scan, np.eye(4), k * PERIOD_NS, scanner=f"name {k}")
    assert "more" in frame.rejected
    for _ in range(2):
        pipeline.process(scan[:50], np.eye(4), 0, scanner="name 0")
    health = pipeline.health()
    assert (health.received, health.rejected) == (limit + 4, 4)
    assert sum(health.reasons.values()) == 4


@pytest.mark.parametrize("config", [CirclesConfig(), CirclesConfig.paper()])
def test_errors_name_the_scanner(config):
    scan = scan_of((4, 0, 0.3), np.eye(4))
    pipeline = CirclePipeline(config, estimator=usual)
    for name in ("left", "right"):
        pipeline.process(scan, np.eye(4), 0, scanner=name)
    with pytest.raises(InputError, match='from scanner "right": it was processed'):
        pipeline.process(scan, np.eye(4), 0, scanner="right")


def usual(ranges, bearings, segments):
    return fit_circles(ranges, bearings, segments)


def test_late_scans_are_taken_in_where_they_belong():
    rng = np.random.default_rng(4100)
    scans = [scan_of((4, 0.05 * k, 0.3), np.eye(4), rng) for k in range(10)]
    in_order, late = CirclePipeline(), CirclePipeline()
    for k in range(10):
        in_order.process(scans[k], np.eye(4), k * PERIOD_NS)
    for k in [0, 1, 2, 4, 3, 5, 6, 8, 7, 9]:
        frame = late.process(scans[k], np.eye(4), k * PERIOD_NS)
        assert frame.events.is_late == (k in (3, 7))
    stamps = 10 * PERIOD_NS
    assert elements_as_bytes(in_order.map_at(stamps)) == elements_as_bytes(late.map_at(stamps))


def test_reset_forgets_the_map_but_no_numbers():
    pipeline = CirclePipeline()
    for k in range(5):
        first = pipeline.process(scan_of((4, 0, 0.3), np.eye(4)), np.eye(4), k * PERIOD_NS)
    pipeline.reset()
    assert len(pipeline.map_at(0)) == 0
    for k in range(5):
        again = pipeline.process(scan_of((4, 0, 0.3), np.eye(4)), np.eye(4), k * PERIOD_NS)
    assert again.map.id[0] > first.map.id[0]


def test_pipelines_in_threads_agree():
    rng = np.random.default_rng(64)
    scans = [scan_of([(4, 0.1 * k, 0.3), (3, -2, 0.2)], np.eye(4), rng) for k in range(20)]

    def run(_):
        pipeline = CirclePipeline()
        frames = [
            frame_as_bytes(pipeline.process(ranges, np.eye(4), k * PERIOD_NS))
            for k, ranges in enumerate(scans)
        ]
        return b"".join(frames)

    with ThreadPoolExecutor(8) as pool:
        assert len(set(pool.map(run, range(8)))) == 1
