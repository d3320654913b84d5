"""Scenes of flying objects whose results are kept: detector, tracker, map, functions."""

import tempfile
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path

import numpy as np

from golden.digest import Record
from lidar_core import VoxelMap, VoxelMapConfig, cluster_points, traverse
from lidar_core.flying import (
    ClassifyConfig,
    ClusterConfig,
    FlyingConfig,
    FlyingObjectDetector,
    PointCloudTracker,
    PoseConfig,
    SeedConfig,
    SensorConfig,
    SeparateConfig,
    TrackerConfig,
    detection_probability,
    hit_probability,
    point_covariance,
    target_center,
)
from lidar_core.sim import (
    Body,
    Box,
    Circle,
    Cylinder,
    Hover,
    LidarModel,
    Plane,
    Rosette,
    Scene,
    Sphere,
    Spinning,
    Target,
    Waypoints,
    simulate,
)

SEED = 18
STEP_NS = 100_000_000
FAR = (431_250.0, 5_512_800.0, 310.0)
"""World coordinates as of a map projection [m]."""
TEXTS = frozenset({"reason", "rejected"})
"""Sentences, which are no results."""


def lidar(**changes):
    elevations = tuple(np.linspace(22.5, -22.5, 32).tolist())
    return LidarModel(pattern=Spinning(elevations_deg=elevations, columns=256), **changes)


ROWS_DEG = tuple(range(-15, 17, 2))
"""Elevations of a LiDAR of 16 rows."""


def _few_rows(delivery):
    pattern = Spinning(elevations_deg=ROWS_DEG, columns=600)
    return LidarModel(pattern=pattern, delivery=delivery)


def _drone(*places, seconds=1.8):
    times = tuple(np.linspace(0, seconds, len(places)).tolist())
    return Target(shape=Sphere(radius=0.325), motion=Waypoints(times=times, positions=places))


def yard(sensor_model, sensor, *, scans=18, **changes):
    """Ground, two walls, a pole, open sky on two sides, two drones that pass each other."""
    return Scene(
        bodies=(
            Body(shape=Plane(size=(60.0, 60.0))),
            Body(shape=Box(size=(1.0, 20.0, 6.0)), position=(12.0, 0.0, 3.0)),
            Body(shape=Box(size=(20.0, 1.0, 6.0)), position=(0.0, -11.0, 3.0)),
            Body(shape=Cylinder(radius=0.3, height=6.0), position=(-7.0, 3.0, 3.0)),
        ),
        targets=(
            _drone((5.0, 1.0, 3.3), (-1.0, 6.0, 4.2)),
            _drone((-3.0, 7.0, 3.5), (3.0, 4.0, 3.9)),
        ),
        lidar=sensor_model,
        sensor=sensor,
        scans=scans,
        **changes,
    )


_ROUND = Circle(center=(0.0, 0.0, 3.0), radius=2.0, speed=3.0)
_STILL = Hover(position=(0.0, 0.0, 3.0))


@cache
def _scans(name):
    made = {
        "turning": lambda: yard(lidar(), _ROUND),
        "still": lambda: yard(lidar(), _STILL),
        "dropped": lambda: yard(_few_rows("dropped"), _ROUND),
        "zeros": lambda: yard(_few_rows("zeros"), _ROUND),
        "organised": lambda: yard(lidar(delivery="organised"), _ROUND),
        "rosette": lambda: yard(
            LidarModel(
                pattern=Rosette(rays=6000, elevation_deg=(-20, 25), azimuth_half_deg=100),
                delivery="dropped",
            ),
            _ROUND,
        ),
    }
    return tuple(simulate(made[name](), seed=SEED))


def _arguments(simulated, offset=(0.0, 0.0, 0.0)):
    """What `process` is given. Poses are rounded: the last bits of a sine differ among CPUs."""
    scan = simulated.scan
    poses = np.round(simulated.poses, 10)
    poses[:, :3, 3] += offset
    return {
        "points_lidar": scan.points,
        "world_from_lidar": poses,
        "stamp_ns": scan.stamp_ns,
        "no_return": scan.no_return,
        "directions": scan.directions,
        "point_time_ns": scan.point_time_ns,
        "pose_stamps_ns": simulated.pose_stamps_ns,
    }


def _process(record, detector, arguments, name="frame", **changes):
    given = arguments | changes
    record.add("inputs", {key: value for key, value in given.items() if key != "sensor"})
    frame = detector.process(**given)
    record.add(name, frame, skip=TEXTS)
    record.add(f"{name}/later", detector.tracks_at(int(given["stamp_ns"]) + 30_000_000))
    return frame


def _add_map(record, detector, origin=(0.0, 0.0, 0.0)):
    """The map: what is occupied, states at places of a lattice, and values as a file holds them."""
    places = _lattice() + origin
    record.add("map/occupied", sorted_rows(detector.occupied_points()))
    record.add("map/state", detector.state_at(places))
    record.add("map/n_observed", detector.n_observed)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "map.lcvm"
        detector.save_map(path)
        loaded = VoxelMap.load(path)
    record.add("map/file/origin", loaded.origin)
    record.add("map/file/values", loaded.values_at(places))
    record.add("map/file/occupied", sorted_rows(loaded.occupied_points()))
    record.add("health", detector.health())


def _lattice():
    axes = np.arange(-12.6, 13, 0.5), np.arange(-12.6, 13, 0.5), np.arange(-0.4, 8, 0.5)
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def sorted_rows(points):
    return points[np.lexsort(points.T)]


# Scenes of the detector


def play_deskewed(record, threads, config):
    """A sensor that flies a circle; every ray is placed by the pose of its own time."""
    detector = FlyingObjectDetector(config, threads=threads)
    for one in _scans("turning"):
        _process(record, detector, _arguments(one))
    _add_map(record, detector)


def _as_authors(record, threads):
    """What the configuration offers of the authors' code, and other choices."""
    config = FlyingConfig(
        voxel_map=VoxelMapConfig(rays="one_per_end", ray_unit="diagonals", end_margin=0.2),
        cluster=ClusterConfig(of="voxels", min_points=2, max_points=4000),
        classify=ClassifyConfig(
            search_adds_extent=True, map_state="after_update", shadow="paper", fill_pockets=True
        ),
        separate=SeparateConfig(dilate=True, waits_for_background=False),
        seed=SeedConfig(burn_in_scans=6, standing_scans=3, ground_height=0.3, take_off_height=3.0),
        forget_distance=11.0,
        position="paper",
    )
    detector = FlyingObjectDetector(config, threads=threads)
    for one in _scans("still"):
        _process(record, detector, _arguments(one))
    _add_map(record, detector)


def _uncertain(record, threads, weighting):
    """Poses with a covariance, given or configured."""
    pose = PoseConfig(weighting=weighting, position_std=(0.03, 0.03, 0.02))
    detector = FlyingObjectDetector(FlyingConfig(pose=pose), threads=threads)
    given = np.diag([0.01, 0.01, 0.002, 1e-6, 1e-6, 4e-6])
    for number, one in enumerate(_scans("turning")[:13]):
        doubt = {"pose_covariance": given} if number % 2 else {}
        _process(record, detector, _arguments(one), **doubt)
    _add_map(record, detector)


def _driver(record, threads, name, **sensor):
    """What a driver delivers, without directions; rays into the sky are found or are not."""
    sensor = SensorConfig(**sensor)
    detector = FlyingObjectDetector(FlyingConfig(sensor=sensor), threads=threads)
    for one in _scans(name)[:14]:
        _process(record, detector, _arguments(one))
    _add_map(record, detector)


def _masks(record, threads):
    """Two LiDARs, each with masks of its own, teammates, places that are known."""
    both = FlyingConfig(
        sensors={
            "ahead": SensorConfig(
                self_box=((-0.7, 0.3, -0.5), (0.7, 1.0, 0.3)),
                blind_sectors=((1.15, 1.85, -0.5, 0.0),),
            ),
            "back": SensorConfig(min_range=3.0, learn_mask_scans=4, mask_empty_only=True),
        },
        seed=SeedConfig(burn_in_scans=12),
    )
    detector = FlyingObjectDetector(both, threads=threads)
    detector.set_occupied([[2.0, 2.0, 0.5], [2.3, 2.0, 0.5]])
    detector.set_free([[0.0, 8.0, 4.0]])
    for number, one in enumerate(_scans("still")):
        arguments = _arguments(one)
        if number == 9:
            detector.set_teammates([7], one.truth.position[:1], radius=1.5)
        for name, sign in (("ahead", 1), ("back", -1)):
            part = sign * one.scan.directions[:, 0] > 0
            halves = {
                key: arguments[key][part] for key in ("no_return", "directions", "point_time_ns")
            }
            points = one.scan.points.reshape(-1, 3)[part].copy()
            points[::97] = 0.5 * one.scan.directions[part][::97]  # the robot itself
            halves["no_return"][::97] = False
            _process(record, detector, arguments, name, points_lidar=points, sensor=name, **halves)
    _add_map(record, detector)


def _jump(record, threads):
    """Far from the world's origin the pose jumps; the map goes along; then all is forgotten."""
    detector = FlyingObjectDetector(FlyingConfig(), threads=threads)
    for number, one in enumerate(_scans("turning")):
        away = np.array(FAR) + (4.0, -3.0, 1.0) * np.array(number >= 13)
        _process(record, detector, _arguments(one, away))
        if number == 14:
            record.add("reanchored", detector.reanchor())
    _add_map(record, detector, FAR)
    detector.reset()
    _process(record, detector, _arguments(_scans("still")[0]) | {"stamp_ns": 10**10}, "reset")


def _saved(record, threads):
    """A run that goes on with the map of an earlier one."""
    first = FlyingObjectDetector(FlyingConfig(), threads=threads)
    for one in _scans("still")[:12]:
        first.process(**_arguments(one))
    second = FlyingObjectDetector(FlyingConfig(seed=SeedConfig(burn_in_scans=0)), threads=threads)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "map.lcvm"
        first.save_map(path)
        second.load_map(path)
    for one in _scans("still")[12:]:
        _process(record, second, _arguments(one))
    _add_map(record, second)


# Scenes of the parts


def _tracked(record, threads, mode):
    """Clouds and detections, some of them late, of targets that vanish and pass one another."""
    config = TrackerConfig() if mode == "best" else TrackerConfig.paper()
    rng = np.random.default_rng(SEED)
    tracker = PointCloudTracker(config, threads=threads)
    start, velocity = rng.uniform(-4, 4, (4, 3)), rng.uniform(-1, 1, (4, 3))
    ground = rng.uniform(-8, 8, (60, 3)) * [1, 1, 0] - [0, 0, 6]
    for k in range(60):
        stamp = (k + (2 * (k % 9 == 4) - 2 * (k % 9 == 6))) * STEP_NS + k
        there = (rng.random(4) < 0.85) & (np.arange(4) < (4 if k < 20 else 3))
        places = (start + velocity * 1e-9 * stamp)[there] + FAR
        bodies = places[:, None] + rng.normal(0, 0.12, (len(places), 9, 3))
        cloud = np.concatenate([bodies.reshape(-1, 3), ground + FAR])
        times = stamp + np.linspace(0, STEP_NS, len(cloud)).astype(np.int64)
        seen = np.concatenate([places[rng.random(len(places)) < 0.7], places[:1] + 0.15])
        late = stamp - int(rng.choice([0, 0, 1, 3])) * STEP_NS
        spread = np.tile(np.diag([0.01, 0.02, 0.03]), (len(seen), 1, 1)) if k % 2 else None
        record.add("inputs", {"cloud": cloud, "times": times, "seen": seen, "late": late})
        sensor = np.array(FAR) if k % 3 else None
        events = tracker.new_point_cloud(
            cloud, ground + FAR, stamp, sensor_origin=sensor, point_time_ns=times
        )
        record.add("cloud", events)
        record.add("detections", tracker.new_detections(seen, late, covariance=spread))
        record.add("tracks", tracker.tracks_at(stamp + 20_000_000))
    tracker.reset()
    record.add("reset", tracker.tracks_at(stamp))


MAPS = {
    "best": {},
    "paper": {"ray_unit": "metres", "saturation": "paper"},
    "one ray per end": {"rays": "one_per_end", "voxel_size": 0.5, "end_margin": 0.3},
    "bounds": {"bounds": ((-2.0, -1.5, -1.0), (2.3, 1.1, 1.6)), "ray_unit": "diagonals"},
    "many states": {"extra_thresholds": (-900.0, -740.0, -500.0), "ray_gain": 0.3},
}


def _map(record, threads, name):
    """The map alone: every kind of entry of a cloud, permanent voxels, removal, files."""
    rng = np.random.default_rng(SEED)
    made = VoxelMap(VoxelMapConfig(**MAPS[name]), threads=threads, origin=(0.1, 0.2, 0.3))
    places = rng.uniform(-5, 5, (4000, 3)).astype(np.float32)
    made.set_occupied(places[:5])
    made.set_free(places[5:10])
    for number in range(6):
        points = rng.uniform(-4, 4, (600, 3)).astype(np.float32)
        points[:200] = rng.uniform(1.0, 1.6, (200, 3))
        points[rng.random(600) < 0.05, 1] = np.nan
        classes = rng.integers(0, 4, 600).astype(np.uint8)
        origin = np.round(rng.uniform(-0.5, 0.5, (600, 3) if number % 2 else 3), 6)
        rays = np.round(rng.normal(size=(600, 3)), 6).astype(np.float32)
        lost = rng.random(600) < 0.2
        record.add("inputs", {"points": points, "classes": classes, "origin": origin, "rays": rays})
        stats = made.integrate(points, classes, origin, ray_directions=rays, no_return=lost)
        record.add("integrate", stats)
        record.add("removed", made.remove_separate(max_gap=0.8, min_confident=12))
        record.add("state", made.state_at(places))
        record.add("values", made.values_at(places))
    labels = cluster_points(places[:800], max_distance=0.4, min_points=2)
    for mode in (ClassifyConfig(), ClassifyConfig.paper()):
        record.add("classes", made.classify(places[:800], labels, (0.1, 0.2, 0.3), config=mode))
    for place in places[:40]:
        record.add("floating", made.is_floating(place[None], search_distance=1.0))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "map.lcvm"
        made.save(path)
        loaded = VoxelMap.load(path, threads=threads)
    record.add("file/origin", loaded.origin)
    record.add("file/values", loaded.values_at(places))
    record.add("file/occupied", sorted_rows(loaded.occupied_points()))
    record.add("file/n_observed", loaded.n_observed)


def _functions(record, threads):
    """The functions of geometry and analysis."""
    rng = np.random.default_rng(SEED)
    one = _scans("still")[0]
    points = one.scan.points.reshape(-1, 3)
    known = points[np.isfinite(points).all(axis=1)]
    record.add("inputs", known)
    for angle in (0.0, 0.02):
        options = {"max_distance": 0.25, "min_points": 2, "max_angle": angle}
        record.add("clusters", cluster_points(points, **options))
    for _ in range(20):
        start, end = np.round(rng.uniform(-9, 9, (2, 3)), 3)
        cells, lengths = traverse(start, end, voxel_size=0.3, origin=(0.05, 0.1, 0.0))
        record.add("traverse", {"cells": cells, "lengths": lengths})
    pose = np.round(one.poses[0], 10)
    doubt = np.diag([0.01, 0.02, 0.03, 1e-4, 2e-4, 3e-4])
    covariance = point_covariance(known[:300], pose, pose_covariance=doubt, range_std=0.03)
    record.add("point_covariance", covariance)
    near = known[:300].astype(np.float64)
    record.add("hit", hit_probability(near, covariance, voxel_size=0.25, threads=threads))
    rays = one.scan.directions.astype(np.float64)
    found = detection_probability(
        rays, radius=0.325, distance=np.linspace(2, 60, 30), threads=threads
    )
    record.add("detection", found)
    for label, target in zip(one.truth.id, one.truth.position, strict=True):
        on = one.label == label
        beside = rays[~on & (rays @ (target / np.linalg.norm(target)) > 0.99)]
        at = points[on].astype(np.float64)
        center = target_center(at, (0, 0, 0), passing_directions=beside, range_std=0.03)
        record.add("center", center)


SCENES: dict[str, Callable[[Record, int], None]] = {
    "yard, best": partial(play_deskewed, config=FlyingConfig()),
    "yard, paper": partial(play_deskewed, config=FlyingConfig.paper()),
    "yard, options of the authors": _as_authors,
    "uncertain poses, ends": partial(_uncertain, weighting="ends"),
    "uncertain poses, spread": partial(_uncertain, weighting="spread"),
    "dropped rows, sky found": partial(_driver, name="dropped", beams="auto"),
    "dropped rows, sensor described": partial(
        _driver, name="dropped", beam_elevations=tuple(np.radians(ROWS_DEG)), beam_columns=600
    ),
    "dropped rows, sensor named": partial(_driver, name="dropped", beams="vlp-16"),
    "dropped rows, sky to be given": partial(_driver, name="dropped", beams="given"),
    "dropped rows, no sky": partial(_driver, name="dropped", beams=None),
    "zeros, sky found": partial(_driver, name="zeros", beams="auto"),
    "organised, sky learnt": partial(_driver, name="organised", beams="learnt"),
    "rosette, sky found": partial(_driver, name="rosette", beams="auto"),
    "two LiDARs, masks": _masks,
    "far away, a jump of the pose": _jump,
    "saved map": _saved,
    "tracker, best": partial(_tracked, mode="best"),
    "tracker, paper": partial(_tracked, mode="paper"),
    "functions": _functions,
} | {f"map, {name}": partial(_map, name=name) for name in MAPS}
