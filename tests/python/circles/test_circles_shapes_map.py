"""Shapes in the pipeline: walls stay out of the map, a person is one object; boxes, by oracle."""

from collections import Counter

import numpy as np
import pytest

import reference.circles_front as front
from lidar_core import sim
from lidar_core.circles import CirclePipeline, CirclesConfig, PreprocessConfig, Scanner, ShapeKind
from reference.circle_box import Box
from reference.circle_map import level_pose
from reference.circle_shapes import face_ranges
from reference.circle_trace import Earlier, Scan

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


# --- boxes around what is not round and moves ---

SCANNER = Scanner(-2.0, 0.005, 801, 0.1, 10.0)
STILL = np.array([(6.0, 3.0, 0.6), (7.0, -2.0, 0.8), (5.5, -3.5, 0.3)])
ORACLE_TOLERANCE = 1e-7  # relative
OCCLUDED = 1


def boxes(seed):
    """Way, size and turn rate of a box that drives past, and a post that hides a part of it."""
    rng = np.random.default_rng([5200, seed])
    start, heading = np.array([rng.uniform(2.5, 4), -2.5]), np.pi / 2 + rng.uniform(-0.3, 0.3)
    speed, turn = rng.uniform(0.5, 1.1), rng.uniform(-0.25, 0.25)
    size = rng.uniform(0.35, 0.7), rng.uniform(0.2, 0.35)
    post = (*(0.4 * start + [0.0, 1.3]), 0.05)
    return start, heading, speed, turn, size, post


def scans(seed, count, rate):
    """Ranges, pose and stamp of every scan."""
    rng = np.random.default_rng([5300, seed])
    place, heading, speed, turn, size, post = boxes(seed)
    for scan in range(count):
        time = scan / rate
        pose = front.pose((0.02 * scan / rate, -0.1 * time, 0.0), yaw=0.1 * np.sin(time))
        yaw = np.arctan2(pose[1, 0], pose[0, 0])
        level = pose[:2, :2].T @ (place - pose[:2, 3])
        ranges = front.cylinder_ranges(SCANNER.bearings(), pose, np.vstack([STILL, post]))
        of_box = face_ranges((*level, *size, heading - yaw), SCANNER.bearings()).min(axis=0)
        ranges = np.minimum(ranges, of_box) + rng.normal(0, 0.01, len(ranges))
        yield ranges.astype(np.float32), pose, round(time * 1e9) + 10**9
        heading += turn / rate
        place = place + speed / rate * np.array([np.cos(heading), np.sin(heading)])


def world_points(frame, pose, number):
    """Ends of the rays of a segment."""
    rays = frame.segments.rays_of(number)
    ranges, bearings = frame.ranges[rays], frame.bearings[rays]
    place, yaw = level_pose(pose)
    level = ranges * np.stack([np.cos(bearings), np.sin(bearings)])
    return (front.rotation(yaw, 0, 0)[:2, :2] @ level).T + place


@pytest.mark.parametrize(
    "seed", [0, *(pytest.param(seed, marks=pytest.mark.nightly) for seed in range(1, 8))]
)
def test_boxes_equal_the_oracle(seed):
    rate, config = 10.0, CirclesConfig(scanner=SCANNER)
    pipeline, earlier = CirclePipeline(config), Earlier()
    references, several, compared, last = {}, set(), 0, None
    for ranges, pose, stamp in scans(seed, 50, rate):
        frame = pipeline.process(ranges, pose, stamp)
        now = Scan(stamp, *level_pose(pose), frame.bearings, frame.ranges, 10.0)
        for box in references.values():
            box.predict((stamp - last) * 1e-9)
        for number in sorted(set(frame.element.tolist()) - {-1}):
            (own,) = np.nonzero(frame.element == number)
            if len(own) > 1:
                several.add(number)  # parts of one body: which of them is it?
            if number not in references:
                references[number] = Box(config.map)
            points = world_points(frame, pose, int(own[0]) + 1)
            # Only what a box may follow needs it.
            trace = earlier.trace(now, points) if references[number].x is not None else None
            references[number].see(
                points,
                frame.shapes.kind[own[0]] == ShapeKind.CIRCLE,
                covered=bool((frame.segments.sides[own[0]] == OCCLUDED).any()),
                is_in_free=trace is not None and trace < 0.5,
                place=pose[:2, 3],
                spacing=SCANNER.angle_increment,
            )
        for row, number in enumerate(frame.map.id.tolist()):
            box = references[number]
            is_box = box.x is not None and box.has_moved and box.doubt() == 1
            if not is_box or number in several or number not in frame.element:
                continue
            stands = not frame.map.velocity[row].any()
            mean, covariance = box.reported(stands=stands)
            got = [*frame.map.center[row], *frame.map.velocity[row], frame.map.radius[row]]
            np.testing.assert_allclose(got, mean, rtol=0, atol=ORACLE_TOLERANCE)
            np.testing.assert_allclose(
                frame.map.covariance[row],
                covariance,
                rtol=0,
                atol=ORACLE_TOLERANCE * np.abs(covariance).max(),
            )
            compared += 1
        earlier.keep(now)
        last = stamp
    assert compared >= 25
