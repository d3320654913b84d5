"""Elements of the map that are no circles, against least squares and the truth."""

import numpy as np
import pytest

import lidar_core as lc
from lidar_core.circles import CircleMapConfig, CirclePipeline, CirclesConfig, ShapeKind
from lidar_core.errors import InputError
from reference import circle_lines as oracle
from reference.circles_front import cylinder_ranges

SCANNER = lc.circles.Scanner(-np.pi * 0.75, np.pi / 180, 271, 0.1, 10.0)
PERIOD_NS = 50_000_000
LOW, HIGH = (-3.0, -2.5), (5.0, 3.0)
STD = 0.01


def walk(step):
    """Pose of a sensor that goes to and fro and turns."""
    x, y, yaw = 1.5 * np.sin(0.1 * step), 0.8 * np.sin(0.07 * step), 0.4 * np.sin(0.13 * step)
    pose = np.eye(4)
    pose[:2, :2] = [[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]]
    pose[:3, 3] = x, y, 1.0
    return pose


def sweep(pose, rng):
    yaw = np.arctan2(pose[1, 0], pose[0, 0])
    ranges = oracle.room_ranges(SCANNER.bearings(), pose[:2, 3], yaw, LOW, HIGH)
    return ranges + rng.normal(0, STD, len(ranges))


def mapped(seed, scans, **options):
    rng = np.random.default_rng(seed)
    config = CirclesConfig(scanner=SCANNER, map=CircleMapConfig(**options))
    pipeline = CirclePipeline(config)
    for step in range(scans):
        pose = walk(step)
        yield pose, pipeline.process(sweep(pose, rng), pose, step * PERIOD_NS)


def wall_of(heading):
    """The wall whose front is on the left of this way."""
    walls = oracle.walls_of_room(LOW, HIGH)
    away = [abs(np.sin((heading - np.pi / 2 - normal) / 2)) for normal, *_ in walls]
    return walls[int(np.argmin(away))]


def test_lines_equal_least_squares_of_all_that_was_seen():
    seen = {}
    for pose, frame in mapped(5200, 60, line_noise=0.0):
        for row in np.flatnonzero(frame.line >= 0):
            shapes = frame.shapes
            line = oracle.placed(shapes.parameters[row], shapes.covariance[row], pose)
            seen.setdefault(int(frame.line[row]), []).append(line)
    found = frame.map_shapes
    assert set(found.id.tolist()) <= set(seen)
    assert len(found) == 5  # the wall behind, beside both ends of what is out of view
    for row, number in enumerate(found.id.tolist()):
        angle, P, ends = oracle.line_of(seen[number], std=0.01)
        normal = np.array([np.cos(angle), np.sin(angle)])
        turned = found.heading[row] - angle - np.pi / 2
        assert abs(np.sin(turned)) < 1e-4
        assert abs((found.ends[row] - ends) @ normal).max() < 1e-3
        assert abs((found.ends[row] - ends) @ [-normal[1], normal[0]]).max() < 0.02
        across = normal @ found.covariance[row][:2, :2] @ normal
        np.testing.assert_allclose(across, P[1, 1], rtol=0.02)
        np.testing.assert_allclose(found.covariance[row][4, 4], P[0, 0], rtol=0.02)


def test_errors_of_lines_are_as_large_as_their_covariances_say():
    squared = []
    for seed in range(5300, 5325):
        *_, (_, frame) = mapped(seed, 12, line_noise=0.0, line_std=0.0)
        found = frame.map_shapes
        for row in range(len(found)):
            normal, distance, *_ = wall_of(found.heading[row])
            n = np.array([np.cos(normal), np.sin(normal)])
            error = [
                np.sin(found.heading[row] - np.pi / 2 - normal),
                found.center[row] @ n - distance,
            ]
            P = found.covariance[row]
            cross = P[4, :2] @ n
            C = np.array([[P[4, 4], cross], [cross, n @ P[:2, :2] @ n]])
            squared.append(error @ np.linalg.solve(C, error))
    squared = np.array(squared)
    assert len(squared) >= 90
    assert 1.4 < squared.mean() < 3.0  # 2 degrees of freedom; hits at corners are a little biased
    assert (squared < 5.99).mean() >= 0.87


def test_a_room_is_walls_that_keep_their_numbers_and_holds_no_circle():
    seen = set()
    for step, (_, frame) in enumerate(mapped(5400, 150)):
        assert len(frame.map) == 0
        if step >= 5:
            seen |= set(frame.map_shapes.id.tolist())
    found = frame.map_shapes
    assert len(seen) <= 5
    assert set(found.id.tolist()) <= seen
    assert (found.kind == ShapeKind.LINE).all()
    assert (found.velocity == 0).all()
    assert (found.half_size[:, 1] == 0).all()
    for row in np.flatnonzero(found.half_size[:, 0] > 2):
        *_, start, end = wall_of(found.heading[row])
        assert np.linalg.norm(found.ends[row] - [start, end], axis=1).max() < 0.6


def test_shapes_at_changes_nothing_and_bad_scans_leave_them():
    *_, (pose, frame) = mapped(5500, 10)
    rng = np.random.default_rng(5501)
    pipeline = CirclePipeline(CirclesConfig(scanner=SCANNER))
    for step in range(6):
        frame = pipeline.process(sweep(pose, rng), pose, step * PERIOD_NS)
    first = pipeline.shapes_at(frame.stamp_ns)
    np.testing.assert_array_equal(first.ends, frame.map_shapes.ends)
    pipeline.shapes_at(10**12)
    with pytest.raises(InputError):
        pipeline.process(sweep(pose, rng), np.full((4, 4), np.nan), 7 * PERIOD_NS)
    with pytest.raises(InputError):
        pipeline.shapes_at("now")
    again = pipeline.shapes_at(frame.stamp_ns)
    for name in ("id", "ends", "covariance", "age"):
        np.testing.assert_array_equal(getattr(again, name), getattr(first, name))
    pipeline.reset()
    assert len(pipeline.shapes_at(frame.stamp_ns)) == 0


def test_the_paper_has_no_lines():
    paper = CirclesConfig.paper(scanner=SCANNER, detector="taubin")
    frame = CirclePipeline(paper).process(
        sweep(np.eye(4), np.random.default_rng(5600)), np.eye(4), 0
    )
    assert len(frame.map_shapes) == 0
    assert (frame.line == -1).all()


def box_ranges(pose, center, heading, half):
    """Noise-free ranges to a box, by the slabs between its faces."""
    yaw = np.arctan2(pose[1, 0], pose[0, 0])
    angle = SCANNER.bearings() + yaw - heading
    offset = pose[:2, 3] - center
    cos, sin = np.cos(heading), np.sin(heading)
    start = np.array([cos * offset[0] + sin * offset[1], cos * offset[1] - sin * offset[0]])
    ways = np.stack([np.cos(angle), np.sin(angle)])
    with np.errstate(divide="ignore", invalid="ignore"):
        enter = (-np.sign(ways) * np.array(half)[:, None] - start[:, None]) / ways
        leave = (np.sign(ways) * np.array(half)[:, None] - start[:, None]) / ways
    near, far = enter.max(axis=0), leave.min(axis=0)
    return np.where((near < far) & (near > 0), near, np.inf)


FINE = lc.circles.Scanner(-np.pi * 0.75, np.pi / 720, 1081, 0.1, 10.0)


@pytest.fixture
def fine(monkeypatch):
    monkeypatch.setitem(globals(), "SCANNER", FINE)
    return CirclesConfig(
        scanner=FINE,
        map=CircleMapConfig(modes=((1e-6, 1.0, 1.0),), turn_noise=0.0),
    )


def test_boxes_keep_their_place_heading_and_size(fine):
    squared, missing = [], 0
    for seed in range(5700, 5740):
        rng = np.random.default_rng(seed)
        half = rng.uniform(0.4, 1.2) * np.array([1.0, rng.uniform(0.4, 0.8)])
        heading = rng.choice([-1, 1]) * rng.uniform(0.5, 1.1)  # two faces are seen
        center = np.array([4.0, 0.0]) + rng.uniform(-0.5, 0.5, 2)
        pipeline = CirclePipeline(fine)
        for step in range(12):
            ranges = box_ranges(walk(step), center, heading, half)
            noisy = ranges + rng.normal(0, STD, len(ranges))
            frame = pipeline.process(noisy, walk(step), step * PERIOD_NS)
        found = frame.map_shapes
        rows = np.flatnonzero(found.kind == ShapeKind.RECTANGLE)
        if len(rows) != 1:
            missing += 1
            continue
        (row,) = rows
        mean = [*found.center[row], found.heading[row], *found.half_size[row]]
        P = np.delete(np.delete(found.covariance[row], (2, 3), 0), (2, 3), 1)
        error = mean - np.array([*center, heading, *half])
        error[2] -= np.pi * np.round(error[2] / np.pi)
        squared.append(error @ np.linalg.solve(P, error))
        assert np.hypot(*error[:2]) < 0.1
    squared = np.array(squared)
    assert missing <= 2
    assert 2.5 < np.median(squared) < 7  # 5 degrees of freedom: 4.35
    assert (squared < 11.07).mean() >= 0.7  # single fits: 0.86


def test_a_number_stays_whatever_its_object_is_taken_for(fine):
    rng = np.random.default_rng(5800)
    pipeline = CirclePipeline(CirclesConfig(scanner=FINE))
    kinds, center = [], np.array([3.0, 0.5])
    for step in range(90):
        pose = walk(0)
        if step // 30 == 1:
            ranges = oracle_circle(pose, center, 0.25)
        else:
            ranges = box_ranges(pose, center, 0.6, (0.3, 0.22))
        noisy = ranges + rng.normal(0, STD, len(ranges))
        frame = pipeline.process(noisy, pose, step * PERIOD_NS)
        if step >= 4:
            assert frame.map.id.tolist() == [0]
            assert set(frame.map_shapes.id.tolist()) <= {0}
        kinds.append(frame.map_shapes.kind.tolist())
    assert kinds[25] == [ShapeKind.RECTANGLE]
    assert kinds[55] == []
    assert kinds[85] == [ShapeKind.RECTANGLE]


def oracle_circle(pose, center, radius):
    return cylinder_ranges(SCANNER.bearings(), pose, np.array([[*center, radius]]))
