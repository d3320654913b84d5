"""A line of the map from all that was ever seen of it at once: least squares in plain numpy."""

import numpy as np


def walls_of_room(low, high):
    """Normals (away from the inside), distances and ends of the four walls of a rectangle."""
    (x, y), (to_x, to_y) = low, high
    return [
        (0.0, to_x, (to_x, y), (to_x, to_y)),
        (np.pi / 2, to_y, (to_x, to_y), (x, to_y)),
        (np.pi, -x, (x, to_y), (x, y)),
        (-np.pi / 2, -y, (x, y), (to_x, y)),
    ]


def room_ranges(bearings, position, yaw, low, high):
    """Ranges from inside a rectangle to its walls."""
    angle = bearings + yaw
    with np.errstate(divide="ignore"):
        across = np.where(np.cos(angle) > 0, high[0] - position[0], low[0] - position[0])
        along = np.where(np.sin(angle) > 0, high[1] - position[1], low[1] - position[1])
        return np.minimum(across / np.cos(angle), along / np.sin(angle))


def placed(parameters, covariance, pose):
    """Angle, place across the middle and covariance of a line of the level frame; its ends."""
    angle, distance, start, end, _ = parameters
    position, yaw = pose[:2, 3], np.arctan2(pose[1, 0], pose[0, 0])
    normal = np.array([np.cos(angle + yaw), np.sin(angle + yaw)])
    tangent = np.array([-normal[1], normal[0]])
    ends = [position + distance * normal + along * tangent for along in (start, end)]
    to_middle = np.array([[1.0, 0.0], [-(start + end) / 2, 1.0]])
    return angle + yaw, to_middle @ covariance[:2, :2] @ to_middle.T, np.array(ends)


def line_of(seen, std):
    """Normal's bearing, point of the line and covariance at it, extent, from `placed` of all scans.

    Unknown are the bearing and the shift of the line across the first middle.
    """
    angle, _, ends = seen[0]
    anchor = ends.mean(axis=0)
    unknown = np.array([angle, 0.0])
    for _ in range(5):
        normal = np.array([np.cos(unknown[0]), np.sin(unknown[0])])
        tangent = np.array([-normal[1], normal[0]])
        information, right = np.zeros((2, 2)), np.zeros(2)
        for angle, R, ends in seen:
            half = max(np.linalg.norm(ends[1] - ends[0]) / 2, 0.25)
            away = ends.mean(axis=0) - anchor
            J = np.array([[1.0, 0.0], [-tangent @ away, 1.0]])
            turned = (angle - unknown[0] + np.pi) % (2 * np.pi) - np.pi
            residual = np.array([turned, normal @ away - unknown[1]])
            weight = np.linalg.inv(R + np.diag([(std / half) ** 2, std**2]))
            information += J.T @ weight @ J
            right += J.T @ weight @ residual
        unknown += np.linalg.solve(information, right)
    along = np.array([tangent @ (end - anchor) for *_, ends in seen for end in ends])
    extent = anchor + normal * unknown[1] + np.outer([along.min(), along.max()], tangent)
    J = np.array([[1.0, 0.0], [-(along.min() + along.max()) / 2, 1.0]])
    return unknown[0], J @ np.linalg.inv(information) @ J.T, extent
