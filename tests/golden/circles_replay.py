"""Scenes of round obstacles whose results are kept: pipeline, networks, map, functions."""

from collections.abc import Callable
from functools import cache, partial
from typing import get_args

import numpy as np

from golden.digest import Record
from lidar_core.circles import (
    CircleDetector,
    CircleMap,
    CircleMapConfig,
    CirclePipeline,
    CirclesConfig,
    DatasetConfig,
    PreprocessConfig,
    Scanner,
    SegmentConfig,
    fit_circles,
    fit_shapes,
    limit_range,
    make_samples,
    project_horizontal,
    segment,
)
from lidar_core.circles.estimators.fit_config import FitMethod
from lidar_core.sim import circle_scenes, sweeps

SEED = 18
TEXTS = frozenset({"rejected", "reasons"})
"""Sentences, which are no results."""
NETWORKED = frozenset({"circles", "circles_world", "map", "map_shapes"})
"""Fields of a frame that hold what a network said."""


@cache
def _sweeps(name):
    made = {
        "posts": lambda: circle_scenes.several(SEED, scans=40),
        "room": lambda: circle_scenes.several(SEED, walls=True, scans=40),
        "lab": lambda: circle_scenes.lab(SEED, scans=40),
        "trees": lambda: circle_scenes.trees(SEED, scans=40),
        "hidden": lambda: circle_scenes.hidden(SEED, scans=20),
    }
    return tuple(sweeps(made[name](), seed=SEED))


def _arguments(sweep):
    """What `process` is given. Poses are rounded: the last bits of a sine differ among CPUs."""
    scan = sweep.scan
    rays = np.arange(len(scan.ranges), dtype=np.int64)
    return {
        "ranges": scan.ranges,
        "world_from_lidar": np.round(sweep.poses, 10),
        "stamp_ns": scan.stamp_ns,
        "ray_time_ns": scan.stamp_ns + scan.time_increment_ns * rays,
        "pose_stamps_ns": sweep.pose_stamps_ns,
    }


def _process(record, pipeline, arguments, *, near=False, **changes):
    given = arguments | changes
    record.add("inputs", given)
    frame = pipeline.process(**given)
    record.add("frame", frame, skip=TEXTS | (NETWORKED if near else frozenset()))
    if near:
        record.add("frame", {name: getattr(frame, name) for name in NETWORKED}, near=True)
    record.add("later", pipeline.map_at(given["stamp_ns"] + 30_000_000), near=near)


# The pipeline


def _mapped(record, _threads, name, config, near=False):
    """A moving scanner maps a scene; every ray is placed by the pose of its own time."""
    pipeline = CirclePipeline(config)
    for sweep in _sweeps(name):
        _process(record, pipeline, _arguments(sweep), near=near)
    last = sweep.scan.stamp_ns + 500_000_000
    record.add("end/circles", pipeline.map_at(last), near=near)
    record.add("end/shapes", pipeline.shapes_at(last), near=near)
    record.add("health", pipeline.health(), skip=TEXTS)


def _two_scanners(record, _threads):
    """Two scanners with rays of their own; some scans late, uncertain, or of no use."""
    front = Scanner(n_beams=541)
    config = CirclesConfig(scanners={"front": front}, on_bad_scan="count")
    pipeline = CirclePipeline(config)
    swept = _sweeps("posts")
    doubt = np.diag([1e-4, 1e-4, 1e-4, 1e-6, 1e-6, 4e-6])
    for number, sweep in enumerate(swept):
        arguments = _arguments(sweep)
        _process(record, pipeline, arguments, pose_covariance=doubt if number % 3 else None)
        older = _arguments(swept[max(number - 2 * (number % 5 == 4), 0)])
        half = {"ranges": older["ranges"][:541], "ray_time_ns": older["ray_time_ns"][:541]}
        _process(record, pipeline, older, scanner="front", **half)
        if number == 20:
            upright = np.diag([1.0, -1.0, -1.0, 1.0])[[0, 2, 1, 3]]
            _process(record, pipeline, older, world_from_lidar=upright)
    record.add("health", pipeline.health(), skip=TEXTS)
    pipeline.reset()
    snapshot = {"ranges": swept[0].scan.ranges, "world_from_lidar": np.eye(4)}
    _process(record, pipeline, snapshot | {"stamp_ns": 10**11})


# The parts


def _map(record, _threads, mode):
    """The map alone, fed with circles of two sensors, some late; the paper knows no late ones."""
    kinds = {
        "best": CircleMapConfig,
        "paper": CircleMapConfig.paper,
        "posts": CircleMapConfig.posts,
    }
    made, late = CircleMap(kinds[mode]()), 0 if mode == "paper" else 2
    rng = np.random.default_rng(SEED)
    start, velocity = rng.uniform(-4, 4, (6, 2)), rng.uniform(-1, 1, (6, 2))
    velocity[:3] = 0
    for k in range(60):
        stamp = (k - late * (k % 11 == 8)) * 50_000_000 + k
        here = rng.random(6) < (0.85 if k < 40 else 0.4)
        places = (start + velocity * stamp * 1e-9)[here]
        circles = np.column_stack([places, np.linspace(0.1, 0.4, 6)[here]])
        circles += rng.normal(0, 0.01, circles.shape)
        delays = np.round(rng.uniform(0, 0.02, len(circles)), 6)
        record.add("inputs", {"circles": circles, "stamp": stamp, "delays": delays})
        noise = np.tile(np.diag([1e-4, 1e-4, 2e-4]), (len(circles), 1, 1))
        pose = np.eye(4)
        pose[:3, 3] = (0.01 * k, 0, 1)
        events = made.update(circles, noise, pose, stamp, delays=delays, sensor=k % 2)
        record.add("events", events)
        record.add("map", made.map_at(stamp + 20_000_000))


def _front(record, _threads):
    """Range limitation, projection, segmentation and fits as functions."""
    scanner = Scanner()
    bearings, arena = scanner.bearings(), PreprocessConfig.box((-3.0, -3.0, 0.0), (6.0, 3.0, 4.0))
    for name in ("room", "hidden", "lab"):
        for sweep in _sweeps(name)[::13]:
            pose, ranges = np.round(sweep.poses[0], 10), sweep.scan.ranges
            record.add("inputs", {"ranges": ranges, "pose": pose})
            record.add("limited", limit_range(ranges, bearings, pose, planes=arena.planes))
            for mode in ("exact", "paper"):
                level = project_horizontal(ranges, bearings, pose, mode=mode)
                record.add(f"projected/{mode}", np.stack(level))
            for mode, config in (("best", SegmentConfig()), ("paper", SegmentConfig.paper())):
                parts = segment(ranges, bearings, config=config)
                record.add(f"segments/{mode}", parts)
                for method in get_args(FitMethod):
                    found = fit_circles(ranges, bearings, parts, method=method)
                    record.add(f"fit/{mode}/{method}", found)
                record.add(f"shapes/{mode}", fit_shapes(ranges, bearings, parts))


def _samples(record, threads, kind):
    """Samples of single circles, and what every detector says of them."""
    config = DatasetConfig.continuous(circles=1) if kind == "continuous" else DatasetConfig()
    samples = make_samples(config, count=60, seed=SEED, threads=threads)
    record.add("inputs", samples)
    scans = samples.scans(config.scanner)
    for method in get_args(FitMethod):
        detector = CircleDetector(method, scanner=config.scanner)
        record.add(f"detected/{method}", detector.detect(scans, config.scanner.bearings()))
    for network in ("cnn", "paper-cnn"):
        detector = CircleDetector(network, scanner=config.scanner, threads=threads)
        found = detector.detect(scans, config.scanner.bearings())
        record.add(f"detected/{network}", found, near=True)


SCENES: dict[str, Callable[[Record, int], None]] = {
    "posts, best": partial(_mapped, name="posts", config=CirclesConfig()),
    "posts, best for posts": partial(_mapped, name="trees", config=CirclesConfig.posts()),
    "posts, paper without network": partial(
        _mapped, name="posts", config=CirclesConfig.paper(detector="taubin")
    ),
    "posts, paper": partial(_mapped, name="posts", config=CirclesConfig.paper(), near=True),
    "posts, network": partial(
        _mapped, name="posts", config=CirclesConfig(detector="cnn"), near=True
    ),
    "room, best": partial(_mapped, name="room", config=CirclesConfig()),
    "lab, limited": partial(
        _mapped,
        name="lab",
        config=CirclesConfig(preprocess=PreprocessConfig.box(*circle_scenes.LAB_VOLUME)),
    ),
    "hidden, best": partial(_mapped, name="hidden", config=CirclesConfig()),
    "two scanners": _two_scanners,
    "map, best": partial(_map, mode="best"),
    "map, paper": partial(_map, mode="paper"),
    "map, posts": partial(_map, mode="posts"),
    "front end": _front,
    "samples, lattice": partial(_samples, kind="lattice"),
    "samples, anywhere": partial(_samples, kind="continuous"),
}
