"""Boxes around what is not round and moves, against an oracle that sees the same scans."""

import numpy as np
import pytest

import reference.circles_front as front
from lidar_core.circles import CirclePipeline, CirclesConfig, Scanner, ShapeKind
from reference.circle_box import Box
from reference.circle_map import level_pose
from reference.circle_shapes import face_ranges
from reference.circle_trace import Earlier, Scan

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
