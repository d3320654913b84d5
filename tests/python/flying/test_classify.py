"""Classes of clusters against Algorithm 1 in plain Python, and on ray-traced scenes."""

import tempfile
from pathlib import Path

import numpy as np
import pytest

from lidar_core import ConfigError, InputError, PointClass, VoxelMap, VoxelMapConfig, cluster_points
from lidar_core.flying import ClassifyConfig
from reference import classify as oracle
from reference import raycast
from reference.voxel_map import VoxelMap as MapOracle

BACKGROUND, FLYING, UNKNOWN = PointClass.BACKGROUND, PointClass.FLYING, PointClass.UNKNOWN
SIZE = 0.25


def random_world(rng, *, edge=7, p_free=0.75, p_occupied=0.02, config=None):
    """A cube of random voxels, made by every way that leads into the map; unobserved outside."""
    config = config if config is not None else VoxelMapConfig()
    vmap, reference = VoxelMap(config), MapOracle(config)
    voxels = np.argwhere(np.ones((2 * edge + 1,) * 3)) - edge
    points = ((voxels + 0.5) * config.voxel_size).astype(np.float32)
    fate = rng.random(len(points))
    for change, value, chosen in [
        ("set_free", -np.inf, fate < p_free),
        ("set_occupied", np.inf, fate > 1 - p_occupied),
    ]:
        getattr(vmap, change)(points[chosen])
        reference.set_all(points[chosen], value)
    rest = points[(fate >= p_free) & (fate <= 1 - p_occupied)]
    rest = rest[rng.random(len(rest)) < 0.5]
    rest = np.repeat(rest, rng.integers(1, 3, len(rest)), axis=0)
    classes = rng.choice([1, 2, 3, 3, 3, 3, 3], len(rest))
    vmap.integrate(rest, classes, rest)  # rays of no length
    reference.integrate(rest, classes, rest)
    return vmap, reference


def points_in(rng, vmap, n, reach=1.5):
    return rng.uniform(-reach, reach, (n, 3)).astype(np.float32)


@pytest.mark.parametrize("seed", range(8))
def test_floating_equals_algorithm_1(seed):
    rng = np.random.default_rng(seed)
    p_free = [0.6, 0.7, 0.8, 0.9, 1.0][seed % 5]
    vmap, reference = random_world(rng, p_free=p_free, p_occupied=0.01 * (seed % 3))
    found = []
    for _ in range(120):
        cluster = points_in(rng, vmap, rng.integers(1, 4))
        distance = float(rng.choice([0.1, 0.25, 0.26, 0.5, 1.0, 1.1, 3.0]))
        floating = vmap.is_floating(cluster, search_distance=distance)
        assert floating == oracle.is_floating(reference, cluster, distance)
        found.append(floating)
    assert any(found)
    assert p_free == 1.0 or not all(found)


@pytest.mark.parametrize("border", ["open", "closed"])
def test_a_search_that_leaves_the_operating_volume(border):
    rng = np.random.default_rng(3)
    config = VoxelMapConfig(bounds=((-1, -1, -1), (1, 1, 1)))
    rules = ClassifyConfig.paper().model_copy(update={"border": border, "close_distance": 0.01})
    vmap, reference = random_world(rng, config=config, p_occupied=0.0)
    classes = []
    for _ in range(200):
        cluster = points_in(rng, vmap, 1, reach=1.0)
        found = vmap.classify(cluster, [0], [0, 0, 0], config=rules)
        assert found.tolist() == oracle.classify(
            reference, cluster, np.array([0]), [0, 0, 0], rules
        )
        floating = oracle.is_floating(reference, cluster, 3.0)
        assert vmap.is_floating(cluster, search_distance=3.0) == floating
        classes.append(int(found[0]))
    assert {FLYING, UNKNOWN} <= set(classes)


def free_box(vmap, half, center=(0, 0, 0)):
    """Free shell of a cube whose inside has never been observed."""
    voxels = np.argwhere(np.ones((2 * half + 1,) * 3)) - half
    shell = voxels[np.abs(voxels).max(axis=1) == half]
    vmap.set_free((shell + center + 0.5) * SIZE)


def test_the_search_ends_at_its_distance_not_before():
    """From the middle of a closed free box with inner half edge h, the corner is 3 h steps away."""
    vmap = VoxelMap()
    free_box(vmap, 3)
    point = [[SIZE / 2] * 3]
    assert not vmap.is_floating(point, search_distance=6 * SIZE)
    assert vmap.is_floating(point, search_distance=7 * SIZE)
    assert vmap.is_floating(point, search_distance=6.5 * SIZE)
    assert not vmap.is_floating(point, search_distance=5.5 * SIZE)


def test_one_start_that_finds_a_way_out_is_enough():
    vmap = VoxelMap()
    free_box(vmap, 2)
    inside, outside = [SIZE / 2] * 3, [9.0, 0.0, 0.0]
    assert vmap.is_floating([inside, inside], search_distance=3.0)
    assert not vmap.is_floating([inside, outside], search_distance=3.0)
    assert not vmap.is_floating(np.zeros((0, 3)), search_distance=3.0)


def test_a_start_in_a_free_or_an_occupied_voxel():
    vmap = VoxelMap()
    vmap.set_free([[0.1, 0.1, 0.1]])
    vmap.set_occupied([[1.1, 0.1, 0.1]])
    assert vmap.is_floating([[0.1, 0.1, 0.1]], search_distance=3.0)
    assert not vmap.is_floating([[1.1, 0.1, 0.1]], search_distance=3.0)


def test_what_was_never_observed_counts_as_the_initial_value():
    point = [[0.1, 0.1, 0.1]]
    assert not VoxelMap().is_floating(point, search_distance=3.0)
    assert VoxelMap(VoxelMapConfig(initial=-1000.0)).is_floating(point, search_distance=3.0)
    assert not VoxelMap(VoxelMapConfig(initial=-100.0)).is_floating(point, search_distance=3.0)


@pytest.mark.parametrize("distance", [0.0, -1.0, np.nan, np.inf, 32.1])
def test_a_search_distance_is_bounded(distance):
    with pytest.raises(ConfigError, match="search_distance: expected 0 to 128 voxels, got"):
        VoxelMap().is_floating([[0, 0, 0]], search_distance=distance)


RULES = {
    "paper": {},
    "own shadow": {"shadow": "own"},
    "short search": {"search_distance": 0.6},
    "small d_close": {"close_distance": 0.125},
    "gates": {"min_points": 3, "max_extent": 0.5, "max_distance": 3.0, "background_extent": 1.2},
    "own voxels": {"own_voxels": "expanded"},
    "groups": {"group_distance": 0.3, "max_extent": 0.7, "background_extent": 0.9},
    "all": {
        "shadow": "own",
        "own_voxels": "expanded",
        "border": "open",
        "min_points": 2,
        "max_extent": 0.9,
        "group_distance": 0.25,
    },
}


@pytest.mark.ci_cases("2-paper", "2-groups", "2-all")
@pytest.mark.parametrize("name", RULES)
@pytest.mark.parametrize("threads", [1, 2])
def test_classes_equal_the_oracle(name, threads):
    rng = np.random.default_rng(list(RULES).index(name))
    rules = ClassifyConfig.paper().model_copy(update=RULES[name])
    classes = []
    for world in range(6):
        vmap, reference = random_world(
            rng, edge=6, p_free=0.8, p_occupied=[0.0, 0.001, 0.01][world % 3]
        )
        if threads > 1:
            vmap = reload(vmap, threads)
        centers = rng.uniform(-1.3, 1.3, (12, 3))
        labels = rng.integers(-1, 12, 60).astype(np.int32)
        labels[:12] = np.arange(12)
        points = (centers[labels] + rng.normal(0, 0.12, (60, 3))).astype(np.float32)
        origin = rng.uniform(-4, 4, 3)
        before = vmap._map.to_bytes()
        found = vmap.classify(points, labels, origin, config=rules)
        assert found.dtype == np.uint8
        assert found.tolist() == oracle.classify(reference, points, labels, origin, rules)
        assert vmap._map.to_bytes() == before, "the map stays as it is"
        classes.extend(found.tolist())
    assert {BACKGROUND, FLYING, UNKNOWN} <= set(classes)


def reload(vmap, threads):
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "map.lcvm"
        vmap.save(path)
        return VoxelMap.load(path, threads=threads)


def test_rule_a_is_strict_and_measures_to_the_centre():
    vmap = VoxelMap()
    vmap.set_occupied([[0.125, 0.125, 0.125]])
    rules = ClassifyConfig.paper().model_copy(update={"close_distance": 0.75})
    at, before = [[0.875, 0.125, 0.125]], [[0.8749, 0.125, 0.125]]
    assert vmap.classify(before, [0], [0, 0, 0], config=rules).tolist() == [BACKGROUND]
    assert vmap.classify(at, [0], [0, 0, 0], config=rules).tolist() == [UNKNOWN]
    corner = [[0.125 + 0.433, 0.125 + 0.433, 0.125 + 0.433]]  # 0.74998 m off, three axes
    assert vmap.classify(corner, [0], [0, 0, 0], config=rules).tolist() == [BACKGROUND]


@pytest.mark.parametrize(
    ("points", "labels", "origin"),
    [
        ([[0, 0, 0]], [0, 1], [0, 0, 0]),
        ([[0, 0, 0]], [1], [0, 0, 0]),
        ([[0, 0, 0]], [-2], [0, 0, 0]),
        ([[0, 0, 0]], [2**32], [0, 0, 0]),
        ([[0, 0, 0]], [0.5], [0, 0, 0]),
        ([[0, 0, 0]], [0], [0, 0]),
        ([[0, 0, 0]], [0], [0, 0, np.nan]),
        ([[0, 0]], [0], [0, 0, 0]),
    ],
)
def test_classify_refuses_what_it_cannot_read(points, labels, origin):
    with pytest.raises(InputError):
        VoxelMap().classify(points, labels, origin)


def test_labels_without_points_and_points_that_are_not_finite_are_unknown():
    points = [[np.nan, 0, 0], [1, 1, 1], [np.inf, 0, 0], [1, 1, 1]]
    for rules in (ClassifyConfig(background_extent=None), ClassifyConfig(), ClassifyConfig.paper()):
        found = VoxelMap().classify(points, [0, 2, 3, -1], [0, 0, 0], config=rules)
        assert found.tolist() == [UNKNOWN] * 4


@pytest.mark.parametrize("name", ["close_distance", "search_distance"])
def test_distances_of_the_rules_are_bounded(name):
    rules = ClassifyConfig(**{name: 10.0})
    fine = VoxelMapConfig(voxel_size=0.05)
    with pytest.raises(ConfigError, match=f"{name}: expected 0 to 128 voxels, got"):
        VoxelMap(fine).classify([[0, 0, 0]], [0], [0, 0, 0], config=rules)


def test_no_cluster_has_no_class():
    assert VoxelMap().classify(np.zeros((0, 3)), np.zeros(0, int), [0, 0, 0]).size == 0
    assert VoxelMap().classify([[0, 0, 0]], [-1], [0, 0, 0]).size == 0


# Scenes: a narrow field of view of 0.35 deg steps, as an OS1-128 has, ray by ray in numpy.
STEP = np.radians(0.35)
RANGE = 60.0


def beams(half_width, half_height):
    azimuth = np.arange(-half_width, half_width + 1) * STEP
    elevation = np.arange(-half_height, half_height + 1) * STEP
    a, e = (angles.ravel() for angles in np.meshgrid(azimuth, elevation))
    return np.stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)], axis=1)


def ray_trace(shapes, sensor, directions):
    """Distance along every ray to the nearest of the shapes, and which; inf and -1 if none."""
    with np.errstate(all="ignore"):
        distances = np.array(
            [
                meet(np.tile(sensor - center, (len(directions), 1)), directions)
                for meet, center in shapes
            ]
        )
    distances[~(distances < RANGE)] = np.inf
    nearest = distances.argmin(axis=0)
    return distances.min(axis=0), np.where(np.isfinite(distances.min(axis=0)), nearest, -1)


class Flight:
    """Scans through the stages before tracking: cluster, classify, integrate, remove separate."""

    def __init__(self, rules, directions, noise=0.02):
        self.vmap = VoxelMap(VoxelMapConfig(max_range=22.0))
        self.rules, self.directions, self.noise = rules, directions, noise
        self.rng = np.random.default_rng(0)

    def scan(self, shapes, sensor):
        """Class of every ray's point, 0 where it has none, and the shape it met."""
        distance, shape = ray_trace(shapes, np.asarray(sensor, np.float64), self.directions)
        hit = np.isfinite(distance)
        noisy = distance + self.rng.normal(0, self.noise, len(distance))
        points = np.full((len(distance), 3), np.nan)
        points[hit] = sensor + noisy[hit, None] * self.directions[hit]
        points = points.astype(np.float32)
        labels = cluster_points(points, max_distance=0.25, min_points=1)
        of_cluster = self.vmap.classify(points, labels, sensor, config=self.rules)
        classes = np.where(labels >= 0, of_cluster[labels] if of_cluster.size else 0, 0)
        self.vmap.integrate(points, classes, sensor, ray_directions=self.directions, no_return=~hit)
        self.vmap.remove_separate(max_gap=0.8, min_confident=24)
        return classes, shape


def approach(rules, speed):
    """Fly at a hovering sphere of 0.325 m from 21 m down to 7 m: classes of its points."""
    flight = Flight(rules, beams(24, 24))
    found = []
    for x in np.arange(0, 14, speed * 0.1):
        target = (raycast.sphere(0.325), np.array([21.0, 0.03, 0.02]))
        classes, shape = flight.scan([target], [x, 0.0, 0.0])
        found.append(bool((classes[shape == 0] == FLYING).any()))
    return found


@pytest.mark.parametrize("speed", [2.0, 6.0])
def test_a_hovering_target_approached_head_on_is_found_in_best_mode_only(speed):
    best = approach(ClassifyConfig(), speed)
    assert np.mean(best[1:]) > 0.95
    # Algorithm 1 as published walks through the target's shadow; a stray point may lie before it.
    paper = approach(ClassifyConfig.paper(), speed)
    assert np.mean(paper) < 0.05


def wall(rng):
    return [(raycast.box((0.2, 40.0, 12.0)), np.array([40.0, 10.0, 0.0]))]


def slanted_rows(rng):
    return [(raycast.box((30.0, 0.2, 8.0)), np.array([35.0, y, 0.0])) for y in (-6.0, 7.0)]


def poles(rng):
    return [
        (raycast.cylinder(0.06, 8.0), np.array([x, y, 2.0]))
        for x, y in [(24, -2), (30, 3), (36, -4), (42, 0.5), (28, 6)]
    ]


def trees(rng):
    found = []
    for x, y in [(26, -4), (33, 4), (40, -1)]:
        found.append((raycast.cylinder(0.15, 4.0), np.array([x, y, 0.0])))
        crown = rng.normal(size=(150, 3))
        crown *= 1.4 * rng.random((150, 1)) ** (1 / 3) / np.linalg.norm(crown, axis=1)[:, None]
        crown += [x, y, 3.0]
        found.extend((raycast.sphere(rng.uniform(0.1, 0.2)), leaf) for leaf in crown)
    return found


@pytest.mark.parametrize("things", [wall, slanted_rows, poles, trees], ids=lambda f: f.__name__)
def test_things_seen_for_the_first_time_do_not_fly_in_best_mode(things):
    rng = np.random.default_rng(1)
    ground = (raycast.plane((400.0, 400.0)), np.array([0.0, 0.0, -2.0]))
    shapes = [ground, *things(rng)]
    flight = Flight(ClassifyConfig(), beams(48, 30))
    flying = {}
    for scan, x in enumerate(np.arange(0, 15, 0.75)):
        classes, shape = flight.scan(shapes, [x, 0.0, 0.0])
        if (classes == FLYING).any():
            flying[scan] = sorted(set(shape[classes == FLYING].tolist()))
    assert flying == {}
