"""Least standard deviations of a shape that scans allow (Cramer and Rao), by brute force."""

import numpy as np

from reference.circle_shapes import ELLIPSE, ellipse_ranges, face_ranges

STEP = 1e-5
STEEPEST = 20.0  # change of a range by a parameter beside an edge [m/m]
PRIOR = (1.0, 1.0, 10.0, 10.0, 10.0)  # information that keeps what nothing tells finite
CORNERS = np.array([(1, 1, -1, -1), (1, -1, 1, -1)])


def ranges_of(kind, shape, bearings):
    """Ranges to an ellipse or a rectangle, in the frame of the scanner."""
    if kind == ELLIPSE:
        return ellipse_ranges(shape, bearings)
    return face_ranges(shape, bearings).min(axis=0)


def sides(kind, shape):
    """Bearings between which a shape is seen."""
    x, y, first, second, heading = shape
    around = np.linspace(0, 2 * np.pi, 721)
    unit = np.array([np.cos(around), np.sin(around)]) if kind == ELLIPSE else 0.5 * CORNERS
    along, aside = unit * np.array([[first], [second]])
    cosine, sine = np.cos(heading), np.sin(heading)
    bearings = np.arctan2(y + sine * along + cosine * aside, x + cosine * along - sine * aside)
    return np.array([bearings.min(), bearings.max()])


def information(kind, shape, bearings, std):
    """Fisher's information (5, 5) of one scan: of its ranges, and of the rays beside the shape.

    A side is spread evenly between the last hit and the first ray beside it.
    """
    hits = np.isfinite(ranges_of(kind, shape, bearings))
    ranges, edges = [], []
    for entry in range(5):
        moved = np.array([shape, shape], float)
        moved[:, entry] += STEP, -STEP
        with np.errstate(invalid="ignore"):
            one, two = (ranges_of(kind, way, bearings)[hits] for way in moved)
            slope = (one - two) / (2 * STEP)
        ranges.append(np.where(np.isfinite(slope), np.clip(slope, -STEEPEST, STEEPEST), 0.0))
        one, two = (sides(kind, way) for way in moved)
        edges.append((one - two) / (2 * STEP))
    ranges, edges = np.array(ranges), np.array(edges)
    gap = bearings[1] - bearings[0]
    return ranges @ ranges.T / std**2 + edges @ edges.T * 12 / gap**2


def centre_bound(kind, shape, places, bearings, std):
    """Least standard deviation of the centre [m] after a scan from every place (x, y, yaw)."""
    total = np.diag(PRIOR)
    x, y, *size, heading = shape
    for from_x, from_y, yaw in places:
        cosine, sine = np.cos(yaw), np.sin(yaw)
        turn = np.eye(5)
        turn[:2, :2] = [[cosine, sine], [-sine, cosine]]
        level = turn[:2, :2] @ [x - from_x, y - from_y]
        there = information(kind, (*level, *size, heading - yaw), bearings, std)
        total = total + turn.T @ there @ turn
    return float(np.sqrt(np.trace(np.linalg.inv(total)[:2, :2])))
