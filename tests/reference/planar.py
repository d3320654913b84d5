"""A 2D scanner in a world of upright cylinders, ray by ray: school formulas in numpy."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def swinging_pose(seconds: float, height: float) -> Array:
    """Pose of the moving, tilting sensor: 0.5 m along x, yaw 0.3 rad, pitch 15, roll 10 deg."""
    yaw = 0.3 * np.sin(0.5 * seconds)
    pitch = np.deg2rad(15) * np.sin(2 * np.pi * seconds / 4)
    roll = np.deg2rad(10) * np.sin(2 * np.pi * seconds / 5)
    (cy, sy), (cp, sp), (cr, sr) = ((np.cos(a), np.sin(a)) for a in (yaw, pitch, roll))
    turn_z = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    turn_y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    turn_x = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    pose = np.eye(4)
    pose[:3, :3] = turn_z @ turn_y @ turn_x
    pose[:3, 3] = [0.5 * np.sin(0.8 * seconds), 0, height]
    return pose


def range_to_cylinder(pose: Array, bearing: float, center: Array, radius: float) -> float:
    """Range of a ray of the LiDAR at `pose` to an endless upright cylinder; +inf if it misses.

    In the world's (x, y) plane the ray is a line whose speed is the horizontal part of its
    direction: the distance to the circle there, divided by that part, is the range.
    """
    direction = pose[:3, :3] @ [np.cos(bearing), np.sin(bearing), 0.0]
    flat = float(np.hypot(direction[0], direction[1]))
    ahead, left = direction[:2] / flat, np.array([-direction[1], direction[0]]) / flat
    way = np.asarray(center) - pose[:2, 3]
    aside = float(left @ way)
    if abs(aside) >= radius or ahead @ way <= 0:
        return float("inf")
    return float(ahead @ way - np.sqrt(radius**2 - aside**2)) / flat


def ellipse_range(
    origin: Array, bearing: float, center: Array, turn: float, half_axes: tuple[float, float]
) -> float:
    """Range of a level ray to an ellipse turned by `turn`; +inf if it misses."""
    cosine, sine = np.cos(turn), np.sin(turn)
    to_axes = np.array([[cosine, sine], [-sine, cosine]]) / np.array(half_axes)[:, None]
    start = to_axes @ (np.asarray(origin) - center)
    step = to_axes @ [np.cos(bearing), np.sin(bearing)]
    a, b, c = step @ step, start @ step, start @ start - 1
    if b * b < a * c or b > 0:
        return float("inf")
    return float((-b - np.sqrt(b * b - a * c)) / a)
