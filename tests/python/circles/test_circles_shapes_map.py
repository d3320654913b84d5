"""Shapes in the pipeline: walls stay out of the map, a person is one object."""

from collections import Counter

import numpy as np

from lidar_core import sim
from lidar_core.circles import CirclePipeline, CirclesConfig, PreprocessConfig, Scanner, ShapeKind

BEARINGS = Scanner().bearings()
PERIOD_NS = 50_000_000
SCENES = sim.circle_scenes


def frames(scene, seed, config=None):
    """Truth and result of every scan of a scene."""
    pipeline = CirclePipeline(config)
    for sweep in sim.sweeps(scene, seed=seed):
        scan = sweep.scan
        stamp = int(scan.stamp_ns)
        times = stamp + np.arange(len(scan.ranges)) * int(scan.time_increment_ns)
        poses = {"pose_stamps_ns": sweep.pose_stamps_ns, "ray_time_ns": times}
        ranges = scan.ranges.astype(np.float32)
        yield sweep.truth, pipeline.process(ranges, sweep.poses, stamp, **poses)


def lab_volume():
    """The operating volume of the lab as planes."""
    low, high = SCENES.LAB_VOLUME
    axes = np.eye(3).tolist()
    upper = [(*axis, limit) for axis, limit in zip(axes, high, strict=True)]
    lower = [(*[-value for value in axis], -limit) for axis, limit in zip(axes, low, strict=True)]
    return PreprocessConfig(planes=(*upper, *lower))


def test_walls_are_lines_and_no_objects():
    ghosts = lines = 0
    for number, (truth, frame) in enumerate(
        frames(SCENES.several(1003, walls=True, scans=120), 1003)
    ):
        lines += int((frame.shapes.kind == ShapeKind.LINE).sum())
        centers = frame.map.center[frame.map.visible]
        apart = np.linalg.norm(centers[:, None] - truth.center[None], axis=2) - truth.radius
        ghosts += int((apart.min(axis=1, initial=np.inf) > 0.3).sum()) if len(centers) else 0
        seen = truth.center[truth.hits >= 8]
        if number > 15 and len(seen):
            missing = np.linalg.norm(seen[:, None] - frame.map.center[None], axis=2).min(axis=1)
            assert (missing > 0.3).mean() < 0.2
    assert lines > 400
    assert ghosts <= 10  # 0.5 s, of all together


def test_a_person_with_arms_is_one_object():
    config = CirclesConfig(preprocess=lab_volume())
    nearest, others = set(), Counter()
    for truth, frame in frames(SCENES.lab(1004, scans=100), 1004, config):
        person = truth.center[truth.kind.index("person")]
        apart = np.linalg.norm(frame.map.center - person, axis=1)
        near = apart < 0.6
        if near.any():
            nearest.add(int(frame.map.id[apart.argmin()]))
            others.update(frame.map.id[near & frame.map.visible].tolist())
    assert len(nearest) == 1
    (kept,) = nearest
    assert others.pop(kept) > 90
    assert max(others.values(), default=0) <= 10  # an arm apart from the trunk: 0.5 s at most


def test_a_box_seen_from_one_side_is_an_object_and_a_panel_is_none():
    face = 3.0 / np.cos(BEARINGS)
    for half, count in ((0.2, 1), (1.5, 0)):
        pipeline = CirclePipeline()
        ranges = np.where(abs(3.0 * np.tan(BEARINGS)) < half, face, np.inf)
        ranges[abs(BEARINGS) > 1.5] = np.inf
        for number in range(7):  # its size is not known: it takes 0.3 s until it is reported
            frame = pipeline.process(ranges, np.eye(4), number * PERIOD_NS)
        assert frame.shapes.kind.tolist() == [ShapeKind.LINE]
        assert len(frame.map) == count
        assert (frame.element >= 0).sum() == count


def test_without_shapes_every_segment_is_a_circle():
    pipeline = CirclePipeline(CirclesConfig.paper())
    ranges = np.where(abs(BEARINGS) < 0.1, 3.0, np.inf)
    frame = pipeline.process(ranges, np.eye(4), 0)
    assert len(frame.shapes) == 0
    assert len(frame.circles) == len(frame.map) == 1


def test_a_post_that_looks_like_another_shape_by_chance_is_followed_all_the_same():
    """Its circle has the covariance that it always has, so that the element does not lag behind."""
    scene = SCENES.single(0.1, 2, speed=1.5, sensor="swinging", seed=1_000_003_002)
    errors, others = [], 0
    for number, (truth, frame) in enumerate(frames(scene, 1_000_003_002)):
        if number == 180:
            break
        others += int((frame.shapes.kind != ShapeKind.CIRCLE).sum())
        if number >= 40:
            errors.append(frame.map.center[0] - truth.center[0])
    assert others >= 3
    assert np.abs(errors).max() < 0.012
