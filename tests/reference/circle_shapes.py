"""Random shapes and the ranges at which rays meet them."""

import numpy as np

from reference.circle_fit import ranges_of

CIRCLE, ELLIPSE, RECTANGLE, LINE = range(4)


def ellipse_ranges(parameters, bearings):
    """Centre x, y, semi-axes, bearing of the first."""
    x, y, first, second, heading = parameters
    cosine, sine = np.cos(heading), np.sin(heading)

    def scaled(x, y):
        return np.array([(cosine * x + sine * y) / first, (cosine * y - sine * x) / second])

    origin, along = scaled(x, y)[:, None], scaled(np.cos(bearings), np.sin(bearings))
    a, b, c = (along**2).sum(0), (along * origin).sum(0), (origin**2).sum() - 1
    square = b**2 - a * c
    with np.errstate(invalid="ignore"):
        return np.where((square >= 0) & (b > 0), (b - np.sqrt(square)) / a, np.inf)


def line_ranges(ends, bearings):
    """A line between two points."""
    (x, y), (ex, ey) = ends[0], np.subtract(ends[1], ends[0])
    dx, dy = np.cos(bearings), np.sin(bearings)
    with np.errstate(divide="ignore", invalid="ignore"):
        along, at = (x * ey - y * ex) / (dx * ey - dy * ex), (x * dy - y * dx) / (dx * ey - dy * ex)
    return np.where((along > 0) & (at >= 0) & (at <= 1), along, np.inf)


def face_ranges(parameters, bearings):
    """The four faces of a rectangle: centre x, y, sides, bearing of the first; (4, rays)."""
    x, y, length, width, heading = parameters
    ahead = 0.5 * length * np.array([np.cos(heading), np.sin(heading)])
    aside = 0.5 * width * np.array([-np.sin(heading), np.cos(heading)])
    corners = [
        np.array([x, y]) + a * ahead + b * aside for a, b in [(1, 1), (-1, 1), (-1, -1), (1, -1)]
    ]
    return np.array([line_ranges((corners[k], corners[k - 1]), bearings) for k in range(4)])


def draw(rng, kind, bearings):
    """A shape 1 to 8 m away and its ranges: circles of 0.05-0.6 m, semi-axes of 0.15-0.6 m with
    ratios of 1.5-3, sides of 0.2-1.5 m, lines of 0.5-5 m, headings anyhow."""
    distance, bearing = rng.uniform(1, 8), rng.uniform(-2.2, 2.2)
    x, y = distance * np.cos(bearing), distance * np.sin(bearing)
    heading = rng.uniform(0, np.pi)
    if kind == CIRCLE:
        shape = np.array([x, y, rng.uniform(0.05, 0.6)])
        return shape, ranges_of(shape, bearings)
    if kind == ELLIPSE:
        first = rng.uniform(0.15, 0.6)
        shape = np.array([x, y, first, first / rng.uniform(1.5, 3), heading])
        return shape, ellipse_ranges(shape, bearings)
    if kind == RECTANGLE:
        shape = np.array([x, y, *np.sort(rng.uniform(0.2, 1.5, 2))[::-1], heading])
        return shape, face_ranges(shape, bearings).min(axis=0)
    half = 0.5 * rng.uniform(0.5, 5) * np.array([np.cos(heading), np.sin(heading)])
    shape = np.array([x - half[0], y - half[1], x + half[0], y + half[1]])
    return shape, line_ranges((shape[:2], shape[2:]), bearings)


def is_seen(shape, kind, ranges, bearings):
    """At least 10 rays side by side within 0.3-9.9 m; of rectangles, 3 on each of two faces: of
    one face alone nothing tells that it belongs to a box."""
    (hits,) = np.nonzero(np.isfinite(ranges))
    if len(hits) < 10 or ranges[hits].min() < 0.3 or ranges[hits].max() > 9.9:
        return False
    if (np.diff(hits) > 1).any():
        return False
    if kind != RECTANGLE:
        return True
    faces = face_ranges(shape, bearings)[:, hits].argmin(axis=0)
    return (np.bincount(faces, minlength=4) >= 3).sum() == 2
