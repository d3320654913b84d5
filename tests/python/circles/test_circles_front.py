"""Range limitation, horizontal projection and segmentation of 2D scans."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from lidar_core import ConfigError, InputError
from lidar_core.circles import (
    CirclesConfig,
    PreprocessConfig,
    Scanner,
    SegmentConfig,
    Side,
    limit_range,
    project_horizontal,
    segment,
)
from reference import circles_front as oracle

BEARINGS = Scanner().bearings()
ROUNDING = 1e-9  # [m] and [rad], of a few operations on numbers up to 100
ABEAM = np.array([[0.0, 5.0, 0.3]])
PITCH = math.radians(20)


def circle_through(ranges, bearings):
    """Centre and radius of noise-free hits: Kasa's fit is exact there."""
    hit = np.isfinite(ranges)
    x, y = ranges[hit] * np.cos(bearings[hit]), ranges[hit] * np.sin(bearings[hit])
    columns = np.stack([2 * x, 2 * y, np.ones(len(x))], axis=1)
    (cx, cy, c), *_ = np.linalg.lstsq(columns, x**2 + y**2, rcond=None)
    return np.array([cx, cy, math.sqrt(max(c + cx**2 + cy**2, 0.0))])


# Range limitation


@given(
    ranges=hnp.arrays(
        np.float64, 12, elements=st.floats(0, 30) | st.sampled_from([np.inf, np.nan])
    ),
    planes=hnp.arrays(np.float64, (3, 4), elements=st.integers(-4, 4)),
    angles=st.tuples(st.floats(-3, 3), st.floats(-1.2, 1.2), st.floats(-1.2, 1.2)),
)
def test_limits_equal_a_walk_along_the_ray(ranges, planes, angles):
    bearings = np.linspace(-2, 2, 12)
    where = oracle.pose((0.13, -0.27, 1.09), *angles)
    assume(planes[:, :3].any(axis=1).all())
    limited = limit_range(ranges, bearings, where, planes=planes)
    expected = oracle.limit_range(ranges, bearings, where, planes)
    # The walk has steps of 2.5 mm: what it cannot tell apart is left out.
    points = where[:3, 3] + np.where(np.isfinite(ranges), ranges, 0)[:, None] * (
        np.stack([np.cos(bearings), np.sin(bearings), 0 * bearings], 1) @ where[:3, :3].T
    )
    clear = (np.abs(points @ planes[:, :3].T - planes[:, 3]) > 0.02).all(axis=1)
    same = (limited == expected) | (np.isnan(limited) & np.isnan(expected))
    hidden = np.isnan(limited) & ~np.isnan(ranges) & np.isinf(expected)  # a sliver of the volume
    assert (same | ~clear | hidden).all()


def test_the_papers_flight_arena():
    arena = PreprocessConfig.box((-2.5, -3.0, 0.1), (2.5, 3.0, 5.0))
    where = oracle.pose((0.0, 0.0, 1.0), pitch=PITCH)
    ranges = np.array([2.0, 2.7, 2.9, 3.1, np.nan, np.inf])
    bearings = np.array([0.0, 0.0, math.pi / 2, math.pi / 2, 0.0, 0.0])
    limited = limit_range(ranges, bearings, where, planes=arena.planes)
    # 2.7 m ahead and 20 degrees down is 0.92 m below the scanner, at a height of 0.08 m.
    np.testing.assert_array_equal(limited, [2.0, np.inf, 2.9, np.inf, np.nan, np.inf])


def test_what_hides_the_volume_is_no_information():
    planes = [[-1, 0, 0, -2], [1, 0, 0, 4]]  # 2 <= x <= 4, seen from x = 0
    limited = limit_range([1.0, 3.0, 5.0], [0, 0, 0], np.eye(4), planes=planes)
    np.testing.assert_array_equal(limited, [np.nan, 3.0, np.inf])


# Projection


@given(
    ranges=hnp.arrays(
        np.float64, 9, elements=st.floats(0.1, 30) | st.sampled_from([np.inf, np.nan])
    ),
    first=st.floats(-3, 0),
    tilt=st.tuples(st.floats(-3, 3), st.floats(-1.3, 1.3), st.floats(-1.3, 1.3)),
)
def test_projection_equals_its_formulas(ranges, first, tilt):
    bearings = first + 0.35 * np.arange(9)
    got = project_horizontal(ranges, bearings, oracle.pose((5, -7, 2), *tilt))
    expected = oracle.project(ranges, bearings, oracle.pose((0, 0, 0), *tilt))
    np.testing.assert_allclose(got[0], expected[0], atol=ROUNDING)
    turns = (got[1] - expected[1]) / (2 * math.pi)
    np.testing.assert_allclose(turns, np.round(turns), atol=ROUNDING)
    np.testing.assert_allclose(got[2], expected[2], atol=ROUNDING)
    assert (np.abs(np.diff(got[1])) <= math.pi + ROUNDING).all()


def test_projection_makes_circles_of_the_ellipses_of_a_tilted_scan():
    where = oracle.pose(pitch=PITCH)
    ranges = oracle.cylinder_ranges(BEARINGS, where, ABEAM)
    error = {
        mode: np.hypot(*(circle_through(*seen[:2]) - ABEAM[0])[:2])
        for mode in ("exact", "paper")
        for seen in [project_horizontal(ranges, BEARINGS, where, mode=mode)]
    }
    assert error["exact"] < 1e-6
    assert error["paper"] == pytest.approx(0.275, abs=0.03)
    raw = np.hypot(*(circle_through(ranges, BEARINGS) - ABEAM[0])[:2])
    assert raw == pytest.approx(0.028, abs=0.01)


def test_eq_5_keeps_bearings_and_shrinks_ranges():
    where = oracle.pose(yaw=1.0, pitch=0.2, roll=-0.3)
    ranges, bearings, _ = project_horizontal([2.0, np.inf], [0.5, 0.6], where, mode="paper")
    np.testing.assert_allclose(ranges, [2 * math.cos(0.2) * math.cos(0.3), np.inf])
    np.testing.assert_array_equal(bearings, [0.5, 0.6])


@pytest.mark.parametrize("yaw_rate", [0.0, 1.0])
def test_motion_during_the_sweep_is_taken_out(yaw_rate):
    stamp, sweep_ns = 10**18, 18_750_000
    times = stamp + np.linspace(0, sweep_ns, len(BEARINGS)).astype(np.int64)
    ticks = stamp + np.arange(0, 3) * 10_000_000

    def at(time_ns):
        seconds = (time_ns - stamp) * 1e-9
        return oracle.pose((1.5 * seconds, 0.5 * seconds, 1.0), 0.4 + yaw_rate * seconds, 0.2)

    truth = np.array([4.0, 3.0, 0.3])
    ranges = oracle.cylinder_ranges(BEARINGS, np.array([at(t) for t in times]), truth)
    ranges, bearings, _ = project_horizontal(
        ranges,
        BEARINGS,
        np.array([at(t) for t in ticks]),
        stamp_ns=stamp,
        ray_time_ns=times,
        pose_stamps_ns=ticks,
    )
    x, y, radius = circle_through(ranges, bearings)
    cosine, sine = math.cos(0.4), math.sin(0.4)
    # Poses between stamps are interpolated: a turn at a constant rate exactly.
    np.testing.assert_allclose(
        [cosine * x - sine * y, sine * x + cosine * y, radius], truth, atol=1e-6
    )


def test_misses_of_a_moving_scanner_keep_their_place_beside_objects():
    times = np.arange(len(BEARINGS)) * 17_000
    ends = np.array([oracle.pose(), oracle.pose((0.0, 0.1, 0.0))])
    each = np.array([oracle.pose((0.0, 0.1 * t / times[-1], 0.0)) for t in times])
    truth = np.array([5.0, 1.0, 0.3])
    ranges, bearings, _ = project_horizontal(
        oracle.cylinder_ranges(BEARINGS, each, truth),
        BEARINGS,
        ends,
        ray_time_ns=times,
        pose_stamps_ns=[0, times[-1]],
    )
    hits = np.flatnonzero(np.isfinite(ranges))
    middle, half = math.atan2(1.0, 5.0), math.asin(0.3 / math.hypot(1.0, 5.0))
    step = Scanner().angle_increment
    assert bearings[hits[0] - 1] < middle - half < bearings[hits[0]] + 0.1 * step
    assert bearings[hits[-1]] - 0.1 * step < middle + half < bearings[hits[-1] + 1]


def test_an_upside_down_scanner_turns_the_other_way():
    _, bearings, _ = project_horizontal(
        np.full(len(BEARINGS), 3.0), BEARINGS, oracle.pose(roll=math.pi)
    )
    np.testing.assert_allclose(np.diff(bearings), -np.diff(BEARINGS), atol=ROUNDING)
    np.testing.assert_allclose(np.cos(bearings), np.cos(BEARINGS), atol=ROUNDING)


# Segmentation


def assert_like_the_oracle(ranges, bearings, corner_depth=0.0):
    config = SegmentConfig(merge_distance=0.0, min_points=2, max_gap=1, corner_depth=corner_depth)
    found = segment(ranges, bearings, config=config)
    groups, sides = oracle.segment(
        ranges,
        bearings,
        incidence=np.deg2rad(10.0),
        slack=config.slack,
        max_gap=1,
        corner=(config.corner_depth, 1.2),
        min_points=2,
        limits=(0.1, 10.0),
        margins=(0.15, 1.2),
    )
    got = {
        tuple(found.rays_of(number)): found.sides[number - 1].tolist()
        for number in range(1, len(found) + 1)
    }
    assert got == dict(zip(map(tuple, groups), sides, strict=True))
    for number in range(1, len(found) + 1):
        assert (np.sort(found.rays_of(number)) == np.flatnonzero(found.labels == number)).all()
    assert (found.labels > 0).sum() == len(found.rays)
    return found


ranges_of_steps = hnp.arrays(
    np.float64, st.integers(0, 40), elements=st.sampled_from([2.0, 2.1, 2.5, 9.5, np.inf, np.nan])
)


@given(ranges=ranges_of_steps, step=st.sampled_from([0.0044, -0.01, 0.2, 0.16]))
def test_segments_equal_plain_loops(ranges, step):
    assert_like_the_oracle(ranges, 0.3 + step * np.arange(len(ranges)))


@given(ranges=ranges_of_steps.filter(lambda ranges: len(ranges) > 2))
def test_segments_all_round_equal_plain_loops(ranges):
    assert_like_the_oracle(ranges, 2 * math.pi / len(ranges) * np.arange(len(ranges)))


@pytest.mark.parametrize("seed", range(20))
def test_surfaces_that_meet_in_corners_equal_plain_loops(seed):
    rng = np.random.default_rng(5900 + seed)
    corners = np.sort(rng.uniform(-2.3, 2.3, 7))
    corners = corners[np.append(True, np.diff(corners) > 0.3)]
    points = rng.uniform(2, 8, len(corners)) * np.exp(1j * corners)
    bearings = np.radians(np.arange(-130, 130, 0.5))
    ranges = np.full(len(bearings), np.inf)
    for start, end in itertools.pairwise(points):
        direction, way = np.exp(1j * bearings), end - start
        cross = (direction * np.conj(way)).imag
        met = (start * np.conj(way)).imag / cross
        along = ((met * direction - start) / way).real
        ranges = np.where((along >= 0) & (along <= 1) & (met > 0), met, ranges)
    ranges += rng.normal(0, 0.01, len(ranges))
    assert_like_the_oracle(ranges, bearings, corner_depth=0.15)


@given(ranges=ranges_of_steps, shift=st.floats(-7, 7), jitter=st.randoms(use_true_random=False))
def test_segments_of_unequal_steps_equal_plain_loops(ranges, shift, jitter):
    steps = np.array([0.01 * jitter.uniform(0.5, 2.0) for _ in ranges])
    bearings = shift + np.cumsum(steps)
    found = assert_like_the_oracle(ranges, bearings)
    mirrored = segment(
        ranges[::-1],
        bearings[::-1],
        config=SegmentConfig(merge_distance=0.0, min_points=2, max_gap=1, corner_depth=0.0),
    )
    assert sorted(map(sorted, _groups(found))) == sorted(
        sorted(len(ranges) - 1 - ray for ray in group) for group in _groups(mirrored)
    )


def _groups(segments):
    return [segments.rays_of(number).astype(int).tolist() for number in range(1, len(segments) + 1)]


def noisy(rng, circles, std=0.01):
    ranges = oracle.cylinder_ranges(BEARINGS, np.eye(4), np.atleast_2d(circles))
    ranges = ranges + rng.normal(0, std, len(ranges))
    return np.where(ranges > 10, np.inf, np.where(ranges < 0.1, np.nan, ranges))


def papers_circle(rng):
    """A circle of the paper's distribution, off its lattice, outside of which the sensor is."""
    while True:
        x, y, radius = *rng.uniform(-10, 10, 2), rng.uniform(0.05, 0.5)
        if math.hypot(x, y) > radius:
            return x, y, radius


def test_single_circles_are_not_split():
    rng = np.random.default_rng(41)
    seen = split = 0
    for _ in range(6000):
        ranges = noisy(rng, papers_circle(rng))
        if np.isfinite(ranges).sum() >= 4:
            seen += 1
            split += len(segment(ranges, BEARINGS, config=SegmentConfig(min_points=1))) != 1
    assert seen > 3000
    assert split <= 0.001 * seen


@pytest.mark.nightly
def test_neighbours_are_kept_apart():
    """A free gap of 0.3 m at 5 m, in any direction."""
    rng = np.random.default_rng(42)
    apart = total = 0
    while total < 1000:
        r1, r2 = rng.uniform(0.1, 0.5, 2)
        bearing, direction = rng.uniform(-2, 2), rng.uniform(-math.pi, math.pi)
        first = 5.0 * np.array([math.cos(bearing), math.sin(bearing)])
        apart_by = r1 + r2 + 0.3
        second = first + apart_by * np.array([math.cos(direction), math.sin(direction)])
        ranges = noisy(rng, [(*first, r1), (*second, r2)])
        owners = [np.isfinite(noisy(rng, circle)) for circle in [(*first, r1), (*second, r2)]]
        alone = [
            oracle.cylinder_ranges(BEARINGS, np.eye(4), np.array([circle]))
            for circle in [(*first, r1), (*second, r2)]
        ]
        nearest = np.where(alone[0] <= alone[1], 0, 1)
        hits = np.isfinite(ranges) & (owners[0] | owners[1])
        if min((nearest[hits] == 0).sum(), (nearest[hits] == 1).sum()) < 4:
            continue
        total += 1
        labels = segment(ranges, BEARINGS).labels
        shared = set(labels[hits & (nearest == 0)]) & set(labels[hits & (nearest == 1)])
        apart += not shared - {0}
    assert apart >= 0.99 * total


def test_something_thin_before_a_wall_or_a_barrel_does_not_split_it():
    rng = np.random.default_rng(43)
    for behind in [(4.0, 0.0, 0.5), (60.0, 0.0, 56.0)]:
        for y in np.linspace(-0.15, 0.15, 7):
            ranges = noisy(rng, [behind, (2.0, y, 0.03)])
            found = segment(ranges, BEARINGS)
            ends = {found.labels[int(np.argmin(np.abs(BEARINGS - angle)))] for angle in (-0.1, 0.1)}
            assert len(ends) == 1
            assert 0 not in ends
            once = segment(ranges, BEARINGS, config=SegmentConfig(merge_distance=0.0))
            assert len(once) == len(found) + 1


def test_two_trunks_behind_a_pole_stay_two():
    rng = np.random.default_rng(44)
    for _ in range(50):
        ranges = noisy(rng, [(3.0, 0.2, 0.12), (3.0, -0.2, 0.12), (1.5, 0.0, 0.06)])
        assert len(segment(ranges, BEARINGS)) == 3


def test_the_papers_reading():
    config = SegmentConfig.paper()
    ranges = np.full(1081, np.inf)
    ranges[10:13] = 2.0  # three rays: less than 0.3 %
    ranges[20:24] = 2.0
    ranges[30:40] = [3.0, 3.1, 3.2, 3.3, 3.4, 3.7, 3.7, 3.7, 3.7, 3.7]
    labels = segment(ranges, BEARINGS, config=config).labels
    assert [set(labels[i:j]) for i, j in [(10, 13), (20, 24), (30, 35), (35, 40)]] == [
        {0},
        {1},
        {2},
        {3},
    ]


@pytest.mark.parametrize(("share", "kept"), [(0.0, 2), (0.005, 1), (0.5, 0)])
def test_segments_with_a_smaller_share_of_the_rays_are_dropped(share, kept):
    """Of 1081 rays, 5 are 0.0046; a segment with as many as the share asks for is kept."""
    ranges = np.full(len(BEARINGS), np.inf)
    ranges[100:105], ranges[500:530] = 3.0, 4.0
    config = SegmentConfig.paper().model_copy(update={"min_fraction": share})
    assert len(segment(ranges, BEARINGS, config=config)) == kept
    exact = config.model_copy(update={"min_fraction": 5 / len(BEARINGS)})
    assert len(segment(ranges, BEARINGS, config=exact)) == 2


def test_sides_at_the_limits_of_the_range():
    far = segment([np.inf, 9.8, 9.8, 9.8, 9.8, np.inf], np.arange(6) * 0.004)
    assert far.sides.tolist() == [[Side.RANGE_CUT] * 2]
    scanner = Scanner(0.0, 0.004, 6, 0.1, 30.0)
    wide = segment([np.inf, 9.8, 9.8, 9.8, 9.8, np.inf], scanner.bearings(), scanner=scanner)
    assert wide.sides.tolist() == [[Side.FREE] * 2]
    config = CirclesConfig(scanner=scanner)
    whole = segment([np.inf, 9.8, 9.8, 9.8, 9.8, np.inf], scanner.bearings(), config=config)
    assert whole.sides.tolist() == [[Side.FREE] * 2]


@pytest.mark.parametrize(
    ("ranges", "bearings", "text"),
    [
        ([1.0, -2.0], [0.0, 0.1], r"ranges: expected >= 0, \+inf .*, got -2.0 in ray 1"),
        ([1.0], [0.0, 0.1], r"ranges: expected shape \(2,\), got \(1,\)"),
        ([1.0, 1.0], [0.0, np.nan], "bearings: expected finite values"),
        ([[1.0]], [0.0], r"ranges: expected shape \(1,\), got \(1, 1\)"),
        (["a"], [0.0], "ranges: expected real numbers"),
    ],
)
def test_bad_scans_are_refused(ranges, bearings, text):
    for call in (
        lambda: segment(ranges, bearings),
        lambda: limit_range(ranges, bearings, np.eye(4), planes=[[1, 0, 0, 1]]),
        lambda: project_horizontal(ranges, bearings, np.eye(4)),
    ):
        with pytest.raises(InputError, match=text):
            call()


def test_bad_poses_times_and_planes_are_refused():
    scan = ([1.0, 2.0], [0.0, 0.1])
    poses = np.stack([np.eye(4)] * 2)
    with pytest.raises(InputError, match="finite rotation and translation"):
        project_horizontal(*scan, np.full((4, 4), np.nan))
    with pytest.raises(InputError, match="pose_stamps_ns"):
        project_horizontal(*scan, poses)
    with pytest.raises(InputError, match="increasing"):
        project_horizontal(*scan, poses, pose_stamps_ns=[5, 5], ray_time_ns=[5, 5])
    with pytest.raises(InputError, match=r"ray_time_ns\[1\]: expected times within 20 ms"):
        project_horizontal(*scan, poses, pose_stamps_ns=[0, 5], ray_time_ns=[0, 10**9])
    with pytest.raises(InputError, match=r"ray_time_ns: expected shape \(2,\), got \(3,\)"):
        project_horizontal(*scan, poses, pose_stamps_ns=[0, 5], ray_time_ns=[0, 1, 2])
    with pytest.raises(InputError, match=r"planes: expected shape \(N, 4\)"):
        limit_range(*scan, np.eye(4), planes=[1, 0, 0, 1])
    with pytest.raises(InputError, match="planes: expected finite"):
        limit_range(*scan, np.eye(4), planes=[[1, 0, 0, np.inf]])
    with pytest.raises(ConfigError, match="mode"):
        project_horizontal(*scan, np.eye(4), mode="rough")
    with pytest.raises(ConfigError, match="expected a SegmentConfig, got dict"):
        segment(*scan, config={})


def test_a_range_too_close_to_be_measured_is_no_information():
    ranges, _, _ = project_horizontal([-np.inf, 1.0], [0.0, 0.1], np.eye(4))
    np.testing.assert_array_equal(ranges, [np.nan, 1.0])


@pytest.mark.parametrize("bound", [-1.0, 1.0])
def test_a_plane_without_normal_is_refused(bound):
    with pytest.raises(InputError, match=r"planes\[1\]: expected finite values, and \(a, b, c\)"):
        limit_range([1.0], [0.0], np.eye(4), planes=[[1, 0, 0, 3], [0, 0, 0, bound]])
    with pytest.raises(ConfigError, match=r"\(a, b, c\) not all 0, got planes.1"):
        PreprocessConfig(planes=((1, 0, 0, 3), (0, 0, 0, bound)))


@pytest.mark.parametrize("lower", [(-1.0, 2.0, 0.0), (-1.0, 3.0, 0.0), (0.0, 0.0)])
def test_a_box_has_an_inside(lower):
    with pytest.raises(ConfigError, match="box: expected three values each, lower < upper"):
        PreprocessConfig.box(lower, (2.0, 2.0, 2.0))
