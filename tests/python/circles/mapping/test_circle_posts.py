"""Posts that are no thin circles: boxes that show one face for a while, and large columns."""

import math
from itertools import pairwise

import numpy as np
import pytest

from lidar_core.circles import CirclePipeline, FitConfig, Scanner, ShapeKind, fit_shapes, segment
from reference import circle_fit, circle_shapes
from reference.circle_bound import centre_bound
from reference.circle_map import level_pose
from reference.circles_front import pose as pose_at

BEARINGS = Scanner().bearings()
SPARSE = BEARINGS[::6]  # every hit against every circle of a grid takes time
STD = 0.01
PERIOD_NS = 50_000_000
BOX = (3.0, 0.0, 0.4, 0.2, 0.1)


def swings(count):
    """Places (x, y, yaw) of a scanner that goes to and fro across."""
    time = np.arange(count) * 0.05
    return np.column_stack([0 * time, 0.9 * np.sin(0.8 * time), 0.1 * np.sin(time)])


def seen(shape, place, rng):
    """Ranges to a box from a place, and the pose."""
    pose = pose_at((*place[:2], 0.0), yaw=place[2])
    (x, y), yaw = level_pose(pose)
    cosine, sine = np.cos(yaw), np.sin(yaw)
    level = np.array([[cosine, sine], [-sine, cosine]]) @ [shape[0] - x, shape[1] - y]
    turned = (*level, *shape[2:4], shape[4] - yaw)
    ranges = circle_shapes.face_ranges(turned, BEARINGS).min(axis=0)
    return ranges + STD * rng.standard_normal(len(ranges)), pose


@pytest.mark.parametrize("shape", [BOX, (2.8, 0.3, 0.3, 0.3, 0.05)])
def test_a_box_that_shows_one_face_for_a_while_keeps_its_centre(shape):
    rng, pipeline, errors, faces, both = np.random.default_rng(5601), CirclePipeline(), [], 0, 0
    places = swings(240)
    for number, place in enumerate(places):
        ranges, pose = seen(shape, place, rng)
        frame = pipeline.process(ranges, pose, number * PERIOD_NS)
        kinds = frame.shapes.kind.tolist()
        faces += kinds == [ShapeKind.LINE]
        both += kinds == [ShapeKind.RECTANGLE]
        if number >= 60:
            assert len(frame.map) == 1
            errors.append(frame.map.center[0] - shape[:2])
    assert faces >= 20
    assert both >= 60  # squares stay squares
    found = frame.map_shapes
    assert found.kind.tolist() == [ShapeKind.RECTANGLE]
    np.testing.assert_allclose(2 * found.half_size[0], shape[2:4], atol=0.03)
    rms = np.sqrt(np.mean(np.square(errors).sum(axis=1)))
    bound = centre_bound(circle_shapes.RECTANGLE, shape, places, BEARINGS[400:681], STD)
    assert bound < rms < 0.012


def test_the_depth_of_a_box_that_showed_one_face_only_is_not_known():
    """Nothing behind the face was ever seen: the covariance contains a panel and a square."""
    rng, pipeline = np.random.default_rng(5602), CirclePipeline()
    shape = (3.0, 0.0, 0.3, 0.3, 0.0)
    for number in range(60):
        ranges, pose = seen(shape, (0.0, 0.0, 0.002 * number), rng)
        frame = pipeline.process(ranges, pose, number * PERIOD_NS)
    assert len(frame.map) == 1
    assert abs(frame.map.center[0] - shape[:2]).max() < 0.16
    assert np.sqrt(frame.map.covariance[0][0, 0]) > 0.05


def column(radius, bearing=0.2, away=3.0):
    away = radius + away
    return away * math.cos(bearing), away * math.sin(bearing), radius


def test_large_columns_are_circles_as_the_oracle_says():
    config, off, spacing = FitConfig(), [], SPARSE[1] - SPARSE[0]
    for number, radius in enumerate((1.2, 1.8, 2.5)):
        rng = np.random.default_rng([5605, number])
        ranges = circle_fit.ranges_of(column(radius), SPARSE)
        ranges = ranges + STD * rng.standard_normal(len(ranges))
        found = fit_shapes(ranges, SPARSE, segment(ranges, SPARSE))
        assert found.kind.tolist() == [ShapeKind.CIRCLE]
        (hits,) = np.nonzero(np.isfinite(ranges))
        low, high = SPARSE[hits[[0, -1]]]
        expected, spread = circle_fit.posterior(
            ranges[hits],
            SPARSE[hits],
            (low - spacing, low),
            (high, high + spacing),
            std=STD,
            radius=(config.min_radius, 3 * config.max_radius),
            usual=config.usual_radius,
        )
        std = np.sqrt(np.diag(spread))
        off.append((found.parameters[0, :3] - expected) / std)
        assert np.sqrt(np.diag(found.covariance[0])[:3]) == pytest.approx(std, rel=0.3)
    assert abs(np.array(off)).max() < 0.5  # two grids


@pytest.mark.parametrize("seed", range(3))
def test_walls_between_doors_are_no_large_columns(seed):
    """Pieces of walls with free ends, flat and bent like a counter, under any angle."""
    rng = np.random.default_rng([5604, seed])
    for _ in range(40):
        x, y, heading = rng.uniform(1.5, 5), rng.uniform(-1, 1), rng.uniform(-1.1, 1.1)
        half, bend = rng.uniform(0.6, 2.0), rng.choice([0.0, 4.0, 8.0])
        along = np.linspace(-half, half, 60)
        behind = along**2 / (2 * bend) if bend else 0 * along
        cosine, sine = np.cos(heading), np.sin(heading)
        points = np.column_stack(
            [x + cosine * behind - sine * along, y + sine * behind + cosine * along]
        )
        parts = pairwise(points)
        ranges = np.min([circle_shapes.line_ranges(ends, BEARINGS) for ends in parts], axis=0)
        ranges = np.minimum(ranges, 9.0) + STD * rng.standard_normal(len(BEARINGS))
        found = fit_shapes(ranges, BEARINGS, segment(ranges, BEARINGS))
        circles = found.parameters[found.kind == ShapeKind.CIRCLE]
        assert (circles[:, 2] <= 1.0).all()
