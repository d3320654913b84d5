"""Shapes of segments: the right class, honest parameters, walls and boxes, bad input."""

import numpy as np
import pytest

from lidar_core.circles import Scanner, ShapeKind, fit_shapes, segment
from lidar_core.errors import InputError
from reference import circle_shapes as reference
from reference.circle_bound import centre_bound

BEARINGS = Scanner().bearings()
STD = 0.01


def scenes(kind, count, seed):
    """Shapes that can be seen, with noisy ranges."""
    rng = np.random.default_rng(seed)
    found = []
    while len(found) < count:
        shape, ranges = reference.draw(rng, kind, BEARINGS)
        if reference.is_seen(shape, kind, ranges, BEARINGS):
            found.append((shape, ranges + STD * rng.standard_normal(len(BEARINGS))))
    return found


def largest(ranges):
    """The shape of the segment with most rays, as (kind, parameters, covariance)."""
    segments = segment(ranges, BEARINGS)
    row = int(np.argmax(np.diff(segments.starts)))
    shapes = fit_shapes(ranges, BEARINGS, segments)
    return shapes.kind[row], shapes.parameters[row], shapes.covariance[row]


def confusion(count, seed):
    """Rows: what it is, columns: what it is taken for, both in the order of `ShapeKind`."""
    table = np.zeros((4, 4), int)
    for kind in ShapeKind:
        for _, ranges in scenes(kind, count, seed):
            table[kind, largest(ranges)[0]] += 1
    return table


def test_the_class_is_right():
    table = confusion(250, seed=10)
    assert np.trace(table) >= 0.95 * table.sum()
    assert (np.diag(table) >= 0.93 * table.sum(axis=1)).all()


@pytest.mark.parametrize("kind", [ShapeKind.ELLIPSE, ShapeKind.RECTANGLE])
def test_parameters_and_covariance_are_honest(kind):
    scores = []
    for shape, ranges in scenes(kind, 200, seed=11):
        found, parameters, covariance = largest(ranges)
        if found != kind:
            continue
        error = parameters - shape
        error[4] -= np.pi * np.round(error[4] / np.pi)
        scores.append(abs(error) / np.sqrt(np.diag(covariance)))
    within = (np.array(scores) < 2).mean(axis=0)
    assert (within[:4] > 0.88).all()
    assert within[4] > 0.85  # of nearly square boxes the longer side may be taken for the shorter
    assert (np.median(scores, axis=0) > 0.3).all()


@pytest.mark.parametrize(
    "shape", [(2.5, 0.0, 0.5, 0.3, 0.4), (2.0, 0.3, 0.6, 0.25, 1.2), (3.0, 0.0, 0.45, 0.3, 0.0)]
)
def test_centres_of_ellipses_come_near_the_bound_of_cramer_and_rao(shape):
    """No estimator without bias is below it; the reported spread is neither, nor far above."""
    rng, exact = np.random.default_rng(14), reference.ellipse_ranges(shape, BEARINGS)
    errors, reported = [], []
    for _ in range(150):
        kind, parameters, covariance = largest(exact + STD * rng.standard_normal(len(exact)))
        if kind == ShapeKind.ELLIPSE:
            errors.append(parameters[:2] - shape[:2])
            reported.append(np.sqrt(np.trace(covariance[:2, :2])))
    assert len(errors) > 140
    rms = np.sqrt(np.square(errors).sum(axis=1).mean())
    bound = centre_bound(reference.ELLIPSE, shape, [(0.0, 0.0, 0.0)], BEARINGS, STD)
    assert 0.9 * bound < rms < 1.5 * bound  # a rms of 150 draws is uncertain by 6 %
    assert 0.9 * bound < np.median(reported) < 1.7 * bound


def test_ends_of_lines():
    for shape, ranges in scenes(ShapeKind.LINE, 100, seed=12):
        segments = segment(ranges, BEARINGS)
        shapes = fit_shapes(ranges, BEARINGS, segments)
        if len(shapes) != 1 or shapes.kind[0] != ShapeKind.LINE:
            continue
        ends, std = shapes.ends()[0], np.sqrt(np.diag(shapes.covariance[0]))
        truth = shape.reshape(2, 2)
        if np.linalg.norm(ends[0] - truth[0]) > np.linalg.norm(ends[0] - truth[1]):
            truth = truth[::-1]
        apart = np.linalg.norm(ends - truth, axis=1)
        spread = STD + np.hypot(std[2:4], std[1] + std[0] * abs(shapes.parameters[0, 2:4]))
        assert (apart < 5 * spread).all()


def test_a_room_is_made_of_lines_and_a_post_in_it_is_a_circle():
    walls = [((5, -4), (5, 4)), ((5, 4), (-5, 4)), ((5, -4), (-5, -4))]
    room = np.min([reference.line_ranges(wall, BEARINGS) for wall in walls], axis=0)
    post = reference.ranges_of((2.0, 0.5, 0.15), BEARINGS)
    ranges = np.minimum(room, post) + STD * np.random.default_rng(13).standard_normal(len(room))
    segments = segment(ranges, BEARINGS)
    shapes = fit_shapes(ranges, BEARINGS, segments)
    circles = np.flatnonzero(shapes.kind == ShapeKind.CIRCLE)
    assert len(circles) == 1
    np.testing.assert_allclose(shapes.parameters[circles[0], :3], (2.0, 0.5, 0.15), atol=0.02)
    assert np.isnan(shapes.ends()[circles[0]]).all()


def test_bad_arrays_are_refused():
    ranges = np.where(abs(BEARINGS) < 0.1, 3.0, np.inf)
    segments = segment(ranges, BEARINGS)
    with pytest.raises(InputError, match="expected rays that ended on something"):
        fit_shapes(np.full_like(ranges, np.inf), BEARINGS, segments)
