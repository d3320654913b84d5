"""Ray walk and clustering against their oracles, and as properties."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from lidar_core import ConfigError, InputError, LimitError, cluster_points, traverse
from reference import cluster as cluster_oracle
from reference.traverse import Segment

LENGTH_TOLERANCE = 1e-9  # [m], of every length and of their sum (relative above 1 m)
PLACE_TOLERANCE = 1e-9  # [m], by which a visited voxel may miss the segment
VOXEL_SIZES = (0.05, 0.1, 0.125, 0.3)
RAYS_PER_CASE = 30


def dyadic(rng, low, high, bits, shape=3):
    """Multiples of 2^-bits: exact in float64, and so are their differences."""
    return rng.integers(int(low * 2**bits), int(high * 2**bits) + 1, shape) / 2**bits


def generic(rng, size):
    return dyadic(rng, -6, 6, 20), dyadic(rng, -6, 6, 20)


def tied(rng, size):
    """Ends on corners and centres of voxels: walls are met exactly if the size is dyadic."""
    return rng.integers(-40, 40, 3) * (size / 2), rng.integers(-40, 40, 3) * (size / 2)


def diagonal(rng, size):
    start = rng.integers(-10, 10, 3) * size
    return start, start + rng.integers(-40, 40) * size * rng.choice([-1, 0, 1], 3)


def axis_parallel(rng, size):
    start, _ = (generic if rng.random() < 0.5 else tied)(rng, size)
    end = start.copy()
    end[rng.integers(3)] += rng.uniform(-8, 8)
    return start, end


def short(rng, size):
    start, _ = (generic if rng.random() < 0.5 else tied)(rng, size)
    return start, start + rng.choice([0.0, 1e-300, 1e-12, 1e-6, size], 3) * rng.choice([-1, 1], 3)


def tiny(rng, size):
    """Around the origin, with spans whose reciprocal overflows."""
    choices = [0.0, -0.0, 5e-324, -5e-324, 1e-310, -1e-310, 1e-300, -1e-300, 0.5, -0.5]
    return rng.choice(choices, 3), rng.choice(choices, 3)


def grazing(rng, size):
    start, end = generic(rng, size)
    start[0] = rng.integers(-20, 20) * size
    end[0] = start[0] + rng.choice([-1, 1]) * rng.choice([1e-12, 1e-9, 1e-7, 1e-4])
    return start, end


def far(rng, size):
    center = dyadic(rng, -1e6, 1e6, 10)
    return center + dyadic(rng, -4, 4, 20), center + dyadic(rng, -4, 4, 20)


def far_tied(rng, size):
    center = rng.integers(-1_000_000, 1_000_000, 3).astype(float)
    return center + rng.integers(-30, 30, 3) / 8, center + rng.integers(-30, 30, 3) / 8


KINDS = [generic, tied, diagonal, axis_parallel, short, tiny, grazing, far, far_tied]


def assert_walk_is_exact(start, end, size, origin=(0.0, 0.0, 0.0)):
    voxels, lengths = traverse(start, end, voxel_size=size, origin=origin)
    segment = Segment(start, end, size, origin)
    exact = segment.lengths()
    visited = [tuple(voxel) for voxel in voxels.tolist()]
    assert len(set(visited)) == len(visited), "no voxel twice"
    assert (np.abs(np.diff(voxels, axis=0)).sum(axis=1) == 1).all(), "neighbours share a face"
    mandatory = {voxel for voxel, length in exact.items() if length > LENGTH_TOLERANCE}
    assert mandatory <= set(visited)
    strangers = [voxel for voxel in visited if voxel not in exact]
    assert all(segment.is_near(voxel, PLACE_TOLERANCE) for voxel in strangers)
    expected = [exact.get(voxel, 0.0) for voxel in visited]
    np.testing.assert_allclose(lengths, expected, rtol=0, atol=LENGTH_TOLERANCE)
    assert abs(lengths.sum() - segment.length) <= LENGTH_TOLERANCE * max(1.0, segment.length)
    assert (lengths >= 0).all()
    return mandatory


@pytest.mark.parametrize("size", VOXEL_SIZES)
@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
def test_walk_equals_exact_arithmetic(kind, size):
    rng = np.random.default_rng([KINDS.index(kind), VOXEL_SIZES.index(size)])
    for _ in range(RAYS_PER_CASE):
        start, end = kind(rng, size)
        mandatory = assert_walk_is_exact(start, end, size)
        back, _ = traverse(end, start, voxel_size=size)
        assert mandatory <= set(map(tuple, back.tolist())), "the way back"


@pytest.mark.parametrize("size", VOXEL_SIZES)
def test_walk_with_an_origin_equals_exact_arithmetic(size):
    rng = np.random.default_rng(7)
    for _ in range(RAYS_PER_CASE // 2):
        origin = dyadic(rng, -3, 3, 12)
        assert_walk_is_exact(*generic(rng, size), size, origin)


@given(
    start=hnp.arrays(np.int64, 3, elements=st.integers(-(2**12), 2**12)),
    end=hnp.arrays(np.int64, 3, elements=st.integers(-(2**12), 2**12)),
    shift=hnp.arrays(np.int64, 3, elements=st.integers(-(10**6), 10**6)),
    exponent=st.integers(-4, 2),
)
def test_a_shift_by_whole_voxels_shifts_the_walk(start, end, shift, exponent):
    size = 2.0**exponent
    voxels, lengths = traverse(start / 2**9, end / 2**9, voxel_size=size)
    moved, moved_lengths = traverse(
        start / 2**9 + shift * size, end / 2**9 + shift * size, voxel_size=size
    )
    np.testing.assert_array_equal(moved, voxels + shift)
    np.testing.assert_array_equal(moved_lengths, lengths)


def test_at_a_corner_the_lowest_axis_goes_first():
    voxels, lengths = traverse([0.5, 0.5, 0.5], [1.5, 1.5, 1.5], voxel_size=1.0)
    assert voxels.tolist() == [[0, 0, 0], [1, 0, 0], [1, 1, 0], [1, 1, 1]]
    np.testing.assert_allclose(lengths, np.array([0.5, 0, 0, 0.5]) * np.sqrt(3))
    back, _ = traverse([1.5, 1.5, 1.5], [0.5, 0.5, 0.5], voxel_size=1.0)
    assert back.tolist() == [[1, 1, 1], [0, 1, 1], [0, 0, 1], [0, 0, 0]]


@pytest.mark.parametrize(
    ("point", "size", "voxel"),
    [
        (0.25, 0.25, 1),
        (-0.25, 0.25, -1),
        (0.0, 0.3, 0),
        (-5e-324, 0.3, -1),
        (5e-324, 0.3, 0),
        (0.25, 0.05, 4),  # 0.05 is a little more than 1/20, and 0.25 // 0.05 is 4
        (0.3, 0.1, 2),
    ],
)
def test_a_point_on_a_face_belongs_to_the_voxel_above(point, size, voxel):
    voxels, lengths = traverse([point] * 3, [point] * 3, voxel_size=size)
    assert voxels.tolist() == [[voxel] * 3]
    assert lengths.tolist() == [0.0]


def test_a_segment_through_too_many_voxels_is_refused():
    assert len(traverse([0.5] * 3, [99_999.5, 0.5, 0.5], voxel_size=1.0)[0]) == 100_000
    with pytest.raises(LimitError, match=r"100001 voxels: the limit is 100000; raise `voxel_size`"):
        traverse([0.5] * 3, [100_000.5, 0.5, 0.5], voxel_size=1.0)


@pytest.mark.parametrize("far", [2.0**31, -(2.0**31), 1e300])
def test_an_end_that_cannot_be_indexed_is_refused(far):
    with pytest.raises(InputError, match=r"expected finite coordinates within 2\^31 voxels"):
        traverse([0, 0, 0], [0, far, 0], voxel_size=1.0)


@pytest.mark.parametrize("size", [0.0, -1.0, np.nan, np.inf, 1e-320])
def test_a_voxel_has_a_size(size):
    with pytest.raises(ConfigError, match=r"^voxel_size: expected finite and > 0, got "):
        traverse([0, 0, 0], [1, 1, 1], voxel_size=size)


# Coordinates on a coarse grid make gaps of exactly the largest distance, and duplicates, common.
grid_points = hnp.arrays(
    np.int64, st.tuples(st.integers(0, 60), st.just(3)), elements=st.integers(-9, 9)
)
special = st.sampled_from([np.nan, np.inf, -np.inf, 3e4, -3e4])
sizes = st.tuples(st.integers(1, 4), st.none() | st.integers(0, 12))


def assert_same_labels(points, **options):
    labels = cluster_points(points, **options)
    np.testing.assert_array_equal(labels, cluster_oracle.cluster_points(points, **options))
    assert labels.dtype == np.int32
    return labels


@given(
    points=grid_points,
    steps=st.sampled_from([1.0, 2**0.5, 3**0.5, 2.0, 5**0.5, 3.0, 8.0]),
    odd=st.lists(st.tuples(st.integers(0, 59), st.integers(0, 2), special), max_size=3),
    size=sizes,
)
def test_clusters_equal_scipy_on_grids(points, steps, odd, size):
    cloud = (points / 8).astype(np.float32)
    for row, axis, value in odd:
        if row < len(cloud):
            cloud[row, axis] = value
    assert_same_labels(cloud, max_distance=steps / 8, min_points=size[0], max_points=size[1])


@given(
    points=hnp.arrays(
        np.float32,
        st.tuples(st.integers(0, 80), st.just(3)),
        elements=st.floats(-2, 2, width=32, allow_subnormal=True),
    ),
    max_distance=st.floats(1e-3, 5),
    size=sizes,
)
def test_clusters_equal_scipy_on_any_floats(points, max_distance, size):
    assert_same_labels(points, max_distance=max_distance, min_points=size[0], max_points=size[1])


def blobs(rng, n):
    centers = rng.uniform(-20, 20, (n // 50 + 1, 3))
    return (centers[rng.integers(len(centers), size=n)] + rng.normal(0, 0.3, (n, 3))).astype("f4")


def line(rng, n):
    return np.outer(rng.uniform(0, n / 40, n), [1.0, 0.5, -0.25]).astype("f4")


def rings(rng, n):
    """What a spinning LiDAR sees of flat ground: many equal heights, dense and sparse parts."""
    radius, angle = rng.integers(2, 30, n), rng.uniform(0, 2 * np.pi, n)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), -np.ones(n)], 1).astype("f4")


def copies(rng, n):
    return rng.integers(0, 4, (n, 3)).astype("f4") * 0.25


def outliers(rng, n):
    cloud = blobs(rng, n)
    cloud[rng.integers(n, size=5)] *= 1e5
    cloud[rng.integers(n, size=5), 1] = np.nan
    return cloud


@pytest.mark.parametrize("shape", [blobs, line, rings, copies, outliers])
@pytest.mark.parametrize("n", [1, 2, 50, 400, 5000])
def test_clusters_equal_scipy_on_clouds(shape, n):
    rng = np.random.default_rng(n)
    for max_distance in (0.0625, 0.25, 0.3):
        assert_same_labels(
            shape(rng, n), max_distance=max_distance, min_points=2, max_points=n // 2
        )


angles = st.sampled_from([0.0, 0.01, 0.125, 0.25, 0.5])


@given(
    points=grid_points,
    origin=st.tuples(*[st.integers(-30, 30)] * 3),
    max_angle=angles,
    size=sizes,
)
def test_clusters_seen_from_afar_equal_scipy_on_grids(points, origin, max_angle, size):
    assert_same_labels(
        (points / 8).astype(np.float32),
        max_distance=0.125,
        min_points=size[0],
        max_points=size[1],
        max_angle=max_angle,
        origin=tuple(value / 8 for value in origin),
    )


@pytest.mark.parametrize("shape", [blobs, line, rings, copies])
@pytest.mark.parametrize("n", [1, 2, 50, 400, 3000])
def test_clusters_seen_from_afar_equal_scipy_on_clouds(shape, n):
    rng = np.random.default_rng(n)
    options = {"max_distance": 0.0625, "min_points": 2, "origin": (1.0, -2.0, 0.5)}
    labels = assert_same_labels(cloud := shape(rng, n), max_angle=0.0125, **options)
    rows = rng.permutation(n)
    shuffled = np.empty_like(labels)
    shuffled[rows] = cluster_points(cloud[rows], max_angle=0.0125, **options)
    assert canonical(shuffled) == canonical(labels)


@pytest.mark.parametrize("angle", [-0.1, 0.6, np.nan])
def test_angles_out_of_range_are_refused(angle):
    with pytest.raises(ConfigError, match=r"^max_angle: expected 0 to 0.5, got "):
        cluster_points(np.zeros((1, 3)), max_distance=1.0, min_points=1, max_angle=angle)


def canonical(labels):
    """The partition alone: for every point the first member of its cluster."""
    first = {label: row for row, label in reversed(list(enumerate(labels.tolist())))}
    return [-1 if label == -1 else first[label] for label in labels.tolist()]


@given(
    points=grid_points,
    order=st.randoms(use_true_random=False),
    shift=hnp.arrays(np.int64, 3, elements=st.integers(-(2**14), 2**14)),
)
def test_order_and_whole_shifts_do_not_matter(points, order, shift):
    options = {"max_distance": 0.25, "min_points": 2}
    cloud = points / 8
    labels = cluster_points(cloud, **options)
    np.testing.assert_array_equal(cluster_points((points + shift) / 8, **options), labels)
    rows = list(range(len(cloud)))
    order.shuffle(rows)
    shuffled = np.empty_like(labels)
    shuffled[rows] = cluster_points(cloud[rows], **options)
    assert canonical(shuffled) == canonical(labels)
    kept = labels[labels >= 0]
    assert list(dict.fromkeys(kept.tolist())) == list(range(len(set(kept.tolist()))))


@pytest.mark.parametrize("distance", [0.0, -0.25, np.nan, np.inf])
def test_clusters_need_a_distance(distance):
    with pytest.raises(ConfigError, match=r"^max_distance: expected finite and > 0, got "):
        cluster_points(np.zeros((2, 3)), max_distance=distance, min_points=1)


@pytest.mark.parametrize(
    ("sizes", "text"),
    [
        ({"min_points": 0}, "min_points: expected >= 1, got 0"),
        ({"min_points": -3}, "min_points: expected a count >= 0, got -3"),
        ({"min_points": 1, "max_points": -1}, "max_points: expected a count >= 0, got -1"),
    ],
)
def test_clusters_need_sensible_sizes(sizes, text):
    with pytest.raises(ConfigError) as refusal:
        cluster_points(np.zeros((2, 3)), max_distance=1.0, **sizes)
    assert str(refusal.value) == text


def test_a_cloud_too_wide_for_its_distance_is_refused():
    with pytest.raises(InputError, match=r"expected finite coordinates within 2\^31"):
        cluster_points([[0, 0, 0], [1e10, 0, 0]], max_distance=0.25, min_points=1)


def test_too_many_points_are_refused():
    with pytest.raises(LimitError, match=r"a scan of 4000001 points: the limit is 4000000"):
        cluster_points(np.zeros((4_000_001, 3), np.float32), max_distance=0.25, min_points=1)
