"""VoxelMap against a dictionary and exact rays; permanent voxels, files, limits, removal."""

import hashlib
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lidar_core import FormatError, InputError, LimitError, PointClass, VoxelMap, VoxelMapConfig
from lidar_core.flying import FlyingObjectDetector
from reference import separate as separate_oracle
from reference.traverse import Segment
from reference.voxel_map import UNITS_PER_EDGE, walk
from reference.voxel_map import VoxelMap as Oracle

# The map computes 2^-n to 3e-13, the oracle to 1e-16: a result next to the middle between two
# float32 values may round the other way, and the next scans keep that difference.
VALUE_ULPS = 1

CONFIGS = {
    "default": {},
    "size 0.1": {"voxel_size": 0.1, "max_range": 5.0},
    "size 0.3": {"voxel_size": 0.3},
    "short range": {"max_range": 1.7},
    "end margin": {"end_margin": 0.6},
    "metres": {"ray_unit": "metres", "ray_gain": 0.5, "saturation": "paper"},
    "saturated": {"ray_gain": 40.0},
    "diagonals": {"ray_unit": "diagonals", "ray_gain": 3.0, "voxel_size": 0.5},
    "weak rays": {"ray_gain": 0.003, "initial": -500.0},
    "bounds": {"bounds": ((-2.0, -1.5, -1.0), (2.3, 1.1, 1.6))},
    "initially free": {"initial": -1000.0},
    "more states": {"extra_thresholds": (-900.0, -740.0, -500.0)},
    "one ray per end": {"rays": "one_per_end", "voxel_size": 0.5},
}


def random_scan(rng, n=40, reach=4.0, each_origin=False, dyadic=True):
    """A scan with every kind of entry: all classes, NaN, duplicates, rays without return."""
    points = rng.uniform(-reach, reach, (n, 3))
    points[: n // 4] = rng.uniform(1.0, 1.6, (n // 4, 3))  # several points per voxel
    if dyadic:
        points = np.round(points * 64) / 64  # many on faces, edges and corners
    points = points.astype(np.float32)
    points[n // 2] = points[n // 2 + 1]
    classes = rng.integers(0, 4, n).astype(np.uint8)
    no_return = rng.random(n) < 0.2
    directions = rng.normal(size=(n, 3)).astype(np.float32)
    directions[rng.random(n) < 0.05] = 0.0
    points[rng.random(n) < 0.05, rng.integers(3)] = np.nan
    points[rng.random(n) < 0.03] = np.inf
    origin = np.round(rng.uniform(-0.5, 0.5, (n, 3) if each_origin else 3) * 32) / 32
    return {
        "points": points,
        "classes": classes,
        "origin": origin,
        "directions": directions,
        "no_return": no_return,
    }


def integrate(vmap, scan):
    return vmap.integrate(
        scan["points"],
        scan["classes"],
        scan["origin"],
        ray_directions=scan["directions"],
        no_return=scan["no_return"],
    )


def integrate_oracle(oracle, scan):
    oracle.integrate(
        scan["points"], scan["classes"], scan["origin"], scan["directions"], scan["no_return"]
    )


def centers(voxels, size):
    return (np.array(sorted(voxels), np.float64).reshape(-1, 3) + 0.5) * size


def assert_equals_oracle(vmap, oracle, ulps=VALUE_ULPS):
    voxels = sorted(oracle.values)
    points = centers(voxels, vmap.config.voxel_size)
    expected = np.array([oracle.values[voxel] for voxel in voxels], np.float32)
    values = vmap.values_at(points)
    np.testing.assert_array_max_ulp(values, expected, maxulp=ulps)
    states = [oracle.state(value) for value in expected]
    np.testing.assert_array_equal(vmap.state_at(points), np.array(states, np.uint8))
    assert vmap.n_observed == len(voxels), "and nothing else has been observed"
    occupied = centers(oracle.occupied(), vmap.config.voxel_size)
    np.testing.assert_allclose(vmap.occupied_points(), occupied, rtol=0, atol=1e-9)


def digest(vmap):
    return hashlib.sha256(bytes(vmap._map.to_bytes())).hexdigest()


@pytest.mark.parametrize("each_origin", [False, True], ids=["one origin", "origins"])
@pytest.mark.parametrize("name", CONFIGS)
def test_integration_equals_the_oracle(name, each_origin):
    config = VoxelMapConfig(**CONFIGS[name])
    vmap, oracle = VoxelMap(config), Oracle(config)
    rng = np.random.default_rng(list(CONFIGS).index(name))
    for index in range(6):
        scan = random_scan(rng, each_origin=each_origin, dyadic=index % 2 == 0)
        stats = integrate(vmap, scan)
        integrate_oracle(oracle, scan)
        assert_equals_oracle(vmap, oracle)
        check_stats(stats, scan)


@pytest.mark.parametrize("reach", [0.7, 12.0, 300.0])
def test_walks_in_whole_numbers_are_exact_to_a_unit(reach):
    """And to the rounding of walls, of which one sub-unit per voxel adds up."""
    rng = np.random.default_rng(21)
    for index in range(60):
        start, end = rng.uniform(-reach, reach, (2, 3))
        if index % 2:
            start, end = np.round([start, end]) / 2
        exact = Segment(start, end, 1.0)
        lengths, visits = exact.lengths(), walk(start, end)
        units = exact.length * UNITS_PER_EDGE
        bound = 1 + 2 * (len(visits) + 1) * units / 2**30
        assert len(visits) == 1 + np.abs(np.floor(end) - np.floor(start)).sum()
        assert abs(sum(length for _, length in visits) - units) <= 1
        met = dict(visits)
        for voxel in met.keys() | lengths.keys():
            error = met.get(voxel, 0) - lengths.get(voxel, 0.0) * UNITS_PER_EDGE
            assert abs(error) <= bound
        for (a, _), (b, _) in pairwise(visits):
            assert np.abs(np.subtract(a, b)).sum() == 1


def check_stats(stats, scan):
    finite = np.isfinite(scan["points"]).all(axis=1) & ~scan["no_return"]
    used = finite & (scan["classes"] > 0)
    empty = scan["no_return"] & (scan["directions"] != 0).any(axis=1)
    counts = [int((used & (scan["classes"] == kind)).sum()) for kind in (1, 2, 3)]
    assert [stats.n_background, stats.n_flying, stats.n_unknown] == counts
    assert stats.n_no_return_rays == empty.sum()
    assert stats.n_rays == used.sum() + empty.sum()
    assert stats.n_skipped == len(used) - used.sum() - empty.sum()
    assert stats.n_visits >= stats.n_rays
    assert stats.n_voxels > 0


@pytest.mark.parametrize("threads", [2, 4])
def test_threads_and_order_do_not_change_a_bit(threads):
    rng = np.random.default_rng(5)
    one, many = VoxelMap(threads=1), VoxelMap(threads=threads)
    for _ in range(3):
        scan = random_scan(rng, n=5000, reach=15.0, each_origin=True, dyadic=False)
        order = rng.permutation(5000)
        integrate(one, scan)
        integrate(many, {name: values[order] for name, values in scan.items()})
        assert one.remove_separate(max_gap=0.8, min_confident=3) == many.remove_separate(
            max_gap=0.8, min_confident=3
        )
        assert digest(one) == digest(many)


def test_many_rays_through_one_voxel_saturate():
    config = VoxelMapConfig(voxel_size=1.0, ray_gain=1e-5, initial=-500.0)
    vmap = VoxelMap(config)
    n = 70_000  # of one edge each: more than the 65,536 edges that are counted
    points = np.tile(np.float32([[2.5, 0.5, 0.5]]), (n, 1))
    vmap.integrate(points, np.full(n, 3), [0.5, 0.5, 0.5])
    keep = 2.0 ** -((2**30 - 1) / 16_384 * 1e-5)
    expected = keep * -500 + (1 - keep) * -1000
    assert vmap.values_at([[1.5, 0.5, 0.5]])[0] == np.float32(expected)


def test_a_point_that_is_not_finite_changes_no_voxel():
    rng = np.random.default_rng(11)
    scan = random_scan(rng, n=200, each_origin=True)
    finite = np.isfinite(scan["points"]).all(axis=1) | scan["no_return"]
    with_nan, without = VoxelMap(), VoxelMap()
    integrate(with_nan, scan)
    integrate(without, {name: values[finite] for name, values in scan.items()})
    assert not finite.all()
    assert digest(with_nan) == digest(without)


def test_entries_without_information_change_nothing():
    vmap = VoxelMap()
    empty = digest(vmap)
    stats = vmap.integrate(np.full((3, 3), np.nan), [1, 2, 3], [0, 0, 0])
    assert (stats.n_skipped, stats.n_rays, stats.n_voxels) == (3, 0, 0)
    stats = vmap.integrate(np.ones((2, 3)), [0, 0], [0, 0, 0])
    assert (stats.n_skipped, stats.n_rays) == (2, 0)
    vmap.integrate(np.zeros((0, 3)), np.zeros(0, np.uint8), [0, 0, 0])
    assert digest(vmap) == empty
    assert vmap.n_stored == 0


def test_permanent_voxels_never_change():
    rng = np.random.default_rng(2)
    vmap = VoxelMap(VoxelMapConfig(extra_thresholds=(-900.0,)))
    occupied, free = [[1.1, 1.1, 1.1], [0.1, 0.1, 0.1]], [[1.3, 1.4, 1.2]]
    vmap.set_occupied(occupied)
    vmap.set_free(free)
    for _ in range(4):
        integrate(vmap, random_scan(rng, n=300))
        vmap.remove_separate(max_gap=0.8, min_confident=1000)
        assert vmap.values_at(occupied).tolist() == [np.inf, np.inf]
        assert vmap.values_at(free).tolist() == [-np.inf]
        assert vmap.state_at(occupied + free).tolist() == [4, 4, 0]
    vmap.set_free(occupied[:1])  # but a caller may change his mind
    assert vmap.state_at(occupied).tolist() == [0, 4]


def test_a_ray_weight_beyond_all_measure_gives_no_nan():
    vmap = VoxelMap(VoxelMapConfig(ray_gain=1000.0))
    vmap.set_occupied([[1.1, 0.1, 0.1]])
    vmap.integrate([[3.1, 0.1, 0.1]], [3], [0.1, 0.1, 0.1])
    assert vmap.values_at([[0.6, 0.1, 0.1], [1.1, 0.1, 0.1]]).tolist() == [-1000.0, np.inf]


@given(value=st.floats(-1000, 0, width=32), n=st.integers(1, 60))
@settings(max_examples=50)
def test_n_points_pull_like_n_updates(value, n):
    """Eq. 12 is eq. 8 applied n times; both voxels start at the same value."""
    config = VoxelMapConfig(initial=value)
    at_once, one_by_one = VoxelMap(config), VoxelMap(config)
    point = np.float32([[0.1, 0.1, 0.1]])
    at_once.integrate(np.repeat(point, n, axis=0), np.ones(n, np.uint8), point[0])
    for _ in range(n):
        one_by_one.integrate(point, [1], point[0])
    # One rounding to float32 per update, of a value that halves: below 2^-23 |value| in all.
    np.testing.assert_allclose(
        at_once.values_at(point), one_by_one.values_at(point), rtol=1e-6, atol=1e-43
    )


def test_the_last_matching_case_of_eq_9_gives_way_to_the_first():
    inside = [[1.05, 0.1, 0.1], [1.1, 0.1, 0.1], [1.15, 0.1, 0.1], [1.2, 0.1, 0.1]]
    g = {}
    for classes in ([3, 1, 1, 2], [3, 3, 2, 3], [3, 3, 3, 3]):
        vmap = VoxelMap(VoxelMapConfig(initial=-100.0))
        vmap.integrate(inside, classes, [0.1, 0.1, 0.1])
        g[tuple(classes)] = vmap.values_at(inside[:1])[0]
    assert g[3, 1, 1, 2] == -25.0  # two background points
    assert g[3, 3, 2, 3] == -740.0  # flying sets it outright, eq. 17
    assert g[3, 3, 3, 3] == -100 / 16 - 740 * 15 / 16  # four unknown points


def test_an_origin_far_away_shifts_the_map_and_loses_nothing():
    rng = np.random.default_rng(9)
    origin = np.array([512_345.25, 5_012_876.5, 312.75])
    near, far = VoxelMap(), VoxelMap(origin=origin)
    for _ in range(3):
        scan = random_scan(rng, each_origin=True)
        integrate(near, scan)
        integrate(
            far,
            scan
            | {
                "points": scan["points"].astype(np.float64) + origin,
                "origin": scan["origin"] + origin,
            },
        )
    points = rng.uniform(-4, 4, (500, 3)).astype(np.float32).astype(np.float64)
    np.testing.assert_array_equal(far.values_at(points + origin), near.values_at(points))
    np.testing.assert_array_equal(far.occupied_points(), near.occupied_points() + origin)
    assert far.n_observed == near.n_observed > 100


def sample_map(**options):
    vmap = VoxelMap(
        VoxelMapConfig(extra_thresholds=(-500.0,), bounds=((-9, -9, -9), (9, 9, 9))), **options
    )
    integrate(vmap, random_scan(np.random.default_rng(4), n=30, reach=2.0))
    vmap.set_occupied([[1.0, 2.0, 3.0]])
    vmap.set_free([[1.3, 2.0, 3.0]])
    return vmap


def test_a_map_comes_back_from_its_file(tmp_path):
    vmap = sample_map(origin=(1e5, 2e5, 3.0))
    path = tmp_path / "a map.lcvm"
    vmap.save(path)
    back = VoxelMap.load(path, threads=2)
    assert digest(back) == digest(vmap)
    assert back.config == vmap.config
    assert back.origin.tolist() == [1e5, 2e5, 3.0]
    np.testing.assert_array_equal(back.occupied_points(), vmap.occupied_points())
    scan = random_scan(np.random.default_rng(8), n=30)
    for one in (vmap, back):
        integrate(one, scan)
        one.remove_separate(max_gap=0.8, min_confident=2)
    assert digest(back) == digest(vmap)
    assert [entry.name for entry in tmp_path.iterdir()] == [path.name], "nothing temporary left"


def test_a_damaged_file_is_refused_with_its_name(tmp_path):
    path = tmp_path / "map.lcvm"
    sample_map().save(path)
    good = path.read_bytes()
    rng = np.random.default_rng(0)
    for cut in [0, 1, 4, 7, 8, 100, len(good) - 1, *rng.integers(0, len(good), 40)]:
        path.write_bytes(good[:cut])
        with pytest.raises(FormatError, match=r"map\.lcvm: byte \d+: "):
            VoxelMap.load(path)
    for place in [*range(64), *rng.integers(0, len(good), 100)]:
        damaged = bytearray(good)
        damaged[place] ^= 1 << rng.integers(8)
        path.write_bytes(damaged)
        with pytest.raises(FormatError, match=r"map\.lcvm: byte \d+: "):
            VoxelMap.load(path)
    path.write_bytes(good + b"\0")
    with pytest.raises(FormatError):
        VoxelMap.load(path)


def test_files_that_cannot_be_read_or_written_are_named(tmp_path):
    missing = tmp_path / "missing.lcvm"
    with pytest.raises(FileNotFoundError, match=r"missing\.lcvm"):
        VoxelMap.load(missing)
    with pytest.raises(OSError, match=str(tmp_path)):
        VoxelMap.load(tmp_path)
    with pytest.raises(FileNotFoundError, match=r"nowhere"):
        sample_map().save(tmp_path / "nowhere" / "map.lcvm")
    (tmp_path / "text.lcvm").write_text("no map", encoding="utf-8")
    with pytest.raises(FormatError, match=r"text\.lcvm: byte 0: "):
        FlyingObjectDetector().load_map(tmp_path / "text.lcvm")


def test_saving_over_a_map_replaces_it(tmp_path):
    path = tmp_path / "map.lcvm"
    VoxelMap().save(path)
    sample_map().save(path)
    assert digest(VoxelMap.load(path)) == digest(sample_map())


def test_a_full_map_refuses_and_stays_as_it_was():
    vmap = VoxelMap(VoxelMapConfig(max_voxels=8 * 512))
    vmap.integrate([[0.4, 0.4, 0.4]], [1], [0.1, 0.1, 0.1])
    before = digest(vmap)
    text = r"a voxel map of \d+ voxels: the limit is 4096; raise `voxel_map\.max_voxels`"
    with pytest.raises(LimitError, match=text):
        vmap.integrate([[15.0, 14.0, 13.0], [0.3, 0.3, 0.3]], [1, 1], [0.1, 0.1, 0.1])
    with pytest.raises(LimitError, match=text):
        vmap.set_occupied(np.mgrid[0:20:2, 0:20:2, 0:1].reshape(3, -1).T)
    assert digest(vmap) == before
    assert vmap.n_stored == 512


def unchecked(**values):
    """A configuration that only users of the core can have."""
    return VoxelMapConfig().model_copy(update=values)


def test_a_scan_wider_than_any_window_is_refused():
    vmap = VoxelMap(unchecked(voxel_size=1e-3))
    with pytest.raises(LimitError, match=r"raise `voxel_size`"):
        vmap.integrate([[19.0, 18.0, 17.0]], [1], [0.1, 0.1, 0.1])
    assert vmap.n_stored == 0


def test_one_stray_return_far_away_is_mapped_and_costs_nothing():
    """It used to widen the dense window around the scan until the scan was refused."""
    rng = np.random.default_rng(6)
    scan = random_scan(rng, dyadic=False)
    far = np.float32([[9e5, -8e5, 7e5], [-9e5, 8e5, 7e5]])
    scan["points"][:2], scan["classes"][:2], scan["no_return"][:2] = far, [1, 3], False
    for config in (VoxelMapConfig(), VoxelMapConfig(bounds=((-2, -2, -2), (2, 2, 2)))):
        vmap, oracle = VoxelMap(config), Oracle(config)
        integrate(vmap, scan)
        integrate_oracle(oracle, scan)
        assert_equals_oracle(vmap, oracle)
        assert vmap.memory_bytes < 2e6


def test_a_scan_that_touches_too_much_is_refused_before_it_is_marked():
    config = VoxelMapConfig(voxel_size=0.01, max_range=50.0, max_voxels=10**6)
    angle = np.linspace(0, 2 * np.pi, 1000)
    circle = 100 * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    vmap = VoxelMap(config)
    before = digest(vmap)
    with pytest.raises(LimitError, match=r"raise `voxel_map\.max_voxels`"):
        vmap.integrate(circle, np.ones(1000, int), [0, 0, 0])
    assert digest(vmap) == before
    vmap.integrate([[0.5, 0.5, 0.5]], [1], [0.1, 0.1, 0.1])
    assert vmap.values_at([[0.5, 0.5, 0.5]]).tolist() == [-370.0]


def test_a_ray_whose_span_underflows_ends():
    vmap = VoxelMap(VoxelMapConfig(voxel_size=1.0))
    stats = vmap.integrate([[0.5, 0.0, 0.5]], [3], [0.5, -1e-310, 0.5])
    assert (stats.n_rays, stats.n_visits) == (1, 2)


@pytest.mark.parametrize(
    "scan",
    [
        {"points_world": np.zeros((3, 2))},
        {"point_class": [1, 2]},
        {"point_class": [1, 2, 5]},
        {"point_class": [1, 2, -1]},
        {"point_class": [1.0, 2.0, 3.0]},
        {"sensor_origin": [0, 0]},
        {"sensor_origin": np.zeros((2, 3))},
        {"sensor_origin": [0, 0, np.nan]},
        {"sensor_origin": [0, 0, 1e30]},
        {"points_world": [[1, 1, 1], [1, 1, 1e30], [1, 1, 1]]},
        {"no_return": [True, False, False]},
        {"no_return": [True, False], "ray_directions": np.ones((3, 3))},
        {"no_return": [1, 0, 0], "ray_directions": np.ones((3, 3))},
        {"ray_directions": np.ones((2, 3)), "no_return": [True, False, False]},
    ],
    ids="-".join,
)
def test_a_refused_scan_leaves_the_map_bit_identical(scan):
    vmap = sample_map()
    before = digest(vmap)
    good = {"points_world": np.ones((3, 3)), "point_class": [1, 2, 3], "sensor_origin": [0, 0, 0]}
    with pytest.raises(InputError):
        vmap.integrate(**(good | scan))
    assert digest(vmap) == before


@pytest.mark.parametrize("bad", [[[np.nan, 0, 0]], [[1e30, 0, 0]], [[0, 0]]])
def test_permanent_voxels_need_points_that_can_be_indexed(bad):
    vmap = sample_map()
    before = digest(vmap)
    for change in (vmap.set_occupied, vmap.set_free):
        with pytest.raises(InputError):
            change(bad)
    assert digest(vmap) == before


def test_what_was_never_observed_has_the_initial_value():
    vmap = VoxelMap(VoxelMapConfig(initial=-200.0))
    points = [[0, 0, 0], [1e30, 0, 0], [np.nan, 0, 0]]
    assert vmap.values_at(points).tolist() == [-200.0] * 3
    assert vmap.state_at(points).tolist() == [2, 2, 2]


def heaps(rng, n):
    """Points without rays, up to 16 in a voxel, some of them in voxels that touch."""
    voxels = rng.integers(-5, 6, (n, 3)) * rng.choice([1, 1, 2])
    points = np.repeat((voxels + 0.5) * 0.25, rng.integers(1, 17, n), axis=0).astype(np.float32)
    return {
        "points": points,
        "classes": rng.choice([1, 1, 1, 2, 3], len(points)).astype(np.uint8),
        "origin": points.astype(np.float64),
        "directions": None,
        "no_return": None,
    }


@pytest.mark.ci_cases("0", "4")
@pytest.mark.parametrize("seed", range(6))
def test_incremental_removal_equals_removal_from_scratch(seed, tmp_path):
    rng = np.random.default_rng(seed)
    vmap, oracle = VoxelMap(), Oracle(VoxelMapConfig())
    options = {"max_gap": 0.8, "min_confident": 3}
    removed = 0
    for step in range(60):
        points = (rng.integers(-6, 7, (2, 3)) + 0.5) * 0.25
        action = rng.choice(["heaps", "scan", "occupied", "free", "parameters", "file", "none"])
        if action in {"heaps", "scan"}:
            scan = heaps(rng, 12) if action == "heaps" else random_scan(rng, n=12, reach=2.0)
            integrate(vmap, scan)
            integrate_oracle(oracle, scan)
        elif action in {"occupied", "free"} and step % 3 == 0:
            getattr(vmap, f"set_{action}")(points)
            oracle.set_all(points, np.inf if action == "occupied" else -np.inf)
        elif action == "parameters":
            options["max_gap"] = float(rng.choice([0.0, 0.25, 0.5, 0.8, 1.3]))
            options["min_confident"] = int(rng.choice([0, 1, 3, 24]))
        elif action == "file":
            vmap.save(tmp_path / "map.lcvm")
            vmap = VoxelMap.load(tmp_path / "map.lcvm")
        for _ in range(rng.integers(0, 3)):
            changed = vmap.remove_separate(**options)
            assert changed == separate_oracle.remove_separate(oracle, **options)
            removed += changed
        assert_equals_oracle(vmap, oracle)
    assert removed > 50


def test_the_only_anchored_group_is_removed_once_it_is_no_longer_anchored():
    """It used to be looked up first, as a known anchor, and then forgotten."""
    vmap = VoxelMap()
    point = np.float32([[0.1, 0.1, 0.1]])
    vmap.integrate(np.repeat(point, 30, axis=0), np.ones(30, np.uint8), point[0])
    assert vmap.remove_separate(max_gap=0.8, min_confident=1) == 0
    vmap.integrate([[0.1, 0.1, 1.1]], [3], [0.1, 0.1, 0.2])  # a ray grazes it: tentative now
    assert vmap.state_at(point).tolist() == [2]
    assert vmap.remove_separate(max_gap=0.8, min_confident=1) == 1


def test_a_separate_group_is_free_after_a_few_removals():
    vmap = VoxelMap()
    point = np.float32([[0.1, 0.1, 0.1]])
    vmap.integrate(np.repeat(point, 30, axis=0), np.ones(30, np.uint8), point[0])
    values = []
    while vmap.remove_separate(max_gap=0.8, min_confident=24):
        values.append(float(vmap.values_at(point)[0]))
    assert [round(value) for value in values] == [-500]  # uncertain now: no longer occupied
    assert vmap.remove_separate(max_gap=0.8, min_confident=24) == 0


@pytest.mark.parametrize("gap", [-0.1, np.nan, np.inf, 16.1])
def test_a_gap_is_bounded(gap):
    with pytest.raises(ValueError, match="max_gap: expected a distance of 0 to 64 voxels"):
        VoxelMap().remove_separate(max_gap=gap, min_confident=1)


def test_searches_at_the_edge_of_the_index_range_do_not_overflow():
    size = 1 / (2**31 - 5000)
    vmap = VoxelMap(unchecked(voxel_size=size))
    for x in (1.0, -1.0):
        vmap.set_occupied([[x, 0, 0]])
        assert vmap.remove_separate(max_gap=64 * size, min_confident=5) == 0
        assert not vmap.is_floating([[x, 0, 0]], search_distance=128 * size)
    with pytest.raises(InputError):
        vmap.set_occupied([[1.00001, 0, 0]])


def test_moving_points_count_as_unknown_ones():
    rng = np.random.default_rng(3)
    points = rng.uniform(-4, 4, (300, 3)).astype(np.float32)
    classes = rng.integers(0, 4, 300).astype(np.uint8)
    moving = np.where(classes == PointClass.UNKNOWN, PointClass.MOVING, classes)
    maps = [VoxelMap(), VoxelMap()]
    stats = [
        vmap.integrate(points, kinds, (0, 0, 0))
        for vmap, kinds in zip(maps, (classes, moving), strict=True)
    ]
    assert stats[0] == stats[1]
    assert (maps[0].values_at(points) == maps[1].values_at(points)).all()
    with pytest.raises(InputError, match="4 moving"):
        maps[0].integrate(points[:1], [5], (0, 0, 0))


def test_an_empty_cloud_changes_nothing():
    grid = VoxelMap()
    for nothing in (np.empty((0, 3), np.float32), np.empty((0, 3))):
        stats = grid.integrate(nothing, [], (0, 0, 0))
        assert (stats.n_rays, stats.n_voxels, grid.n_observed) == (0, 0, 0)
