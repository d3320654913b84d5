"""Scans of a spinning sensor that drives along a street, in the order of firing, without times."""

import numpy as np

PERIOD_NS = 100_000_000
BOXES = np.array(
    [
        [[-30, 11, -2], [60, 11.5, 6]],  # facades and the ground
        [[-30, -9.5, -2], [60, -9, 6]],
        [[-40, -20, -2.5], [80, 20, -1.8]],
        [[-12, 8, -2], [-9, 11, 4]],  # bays of the facades
        [[2, 8.5, -2], [4, 11, 5]],
        [[14, 8, -2], [17, 11, 3]],
        [[26, 7.5, -2], [28, 11, 5]],
        [[-6, -9, -2], [-4, -6.5, 4]],
        [[8, -9, -2], [11, -6, 5]],
        [[20, -9, -2], [22, -7, 3]],
        [[-20, -2, -2], [-19, 2, 4]],
        [[44, -3, -2], [45, 3, 4]],
    ],
    np.float64,
)
PLACES = np.stack(
    [np.arange(-28, 60, 3.7), np.tile([6.2, -6.4, 5.1, -4.8], 6), np.tile([3, 1, 4], 8)], axis=1
)
PILLARS = [[[x, y, -1.8], [x + 0.6, y + 0.6, top]] for x, y, top in PLACES]
FURNISHED = np.concatenate([BOXES, PILLARS])
"""The same street with pillars, as odometry needs them."""


def cast(boxes, origins, directions):
    """Ranges to the nearest of `boxes`; inf without."""
    nearest = np.full(len(origins), np.inf)
    with np.errstate(divide="ignore", invalid="ignore"):
        for low, high in boxes:
            first, second = (low - origins) / directions, (high - origins) / directions
            enter = np.minimum(first, second).max(axis=1)
            leave = np.maximum(first, second).min(axis=1)
            hit = (enter <= leave) & (enter > 0)
            nearest = np.where(hit & (enter < nearest), enter, nearest)
    return nearest


def pose_at(time, *, speed, yaw_rate):
    """Pose of a sensor that drives along x and turns [s, m/s, rad/s]."""
    pose = np.eye(4)
    angle = yaw_rate * time
    pose[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    pose[:3, 3] = [speed * time, 0.3 * speed * time, 0.02 * speed * time]
    return pose


def drive(
    *,
    scans=7,
    turn=1.09,
    speed=6.0,
    yaw_rate=0.0,
    is_moved=False,
    sense=-1,
    sigma=0.01,
    rows=16,
    columns=900,
    boxes=BOXES,
):
    """Scans of a spinning sensor in the order of firing, without times, and their poses.

    `turn`: turns per scan. `is_moved`: a driver has moved the points to the middle of the scan.
    """
    rng, motion = np.random.default_rng(5), {"speed": speed, "yaw_rate": yaw_rate}
    elevations = np.radians(np.linspace(-14, 14, rows))[:, None]
    every, poses = [], []
    for number in range(scans):
        part = np.arange(columns) / columns
        azimuth = 0.4 + sense * 2 * np.pi * turn * (number + part)
        level = np.stack([np.cos(azimuth), np.sin(azimuth), np.zeros(columns)], axis=1)[:, None]
        rays = (np.cos(elevations) * level + np.sin(elevations) * [0, 0, 1]).reshape(-1, 3)
        middle = pose_at((number + 0.5) * 0.1, **motion)
        at = np.stack([pose_at(time, **motion) for time in (number + part) * 0.1])
        at = np.repeat(at, rows, axis=0)
        ranges = cast(boxes, at[:, :3, 3], np.einsum("nij,nj->ni", at[:, :3, :3], rays))
        ranges = ranges + rng.normal(0, sigma, len(ranges))
        sees = ranges < 50
        points = (ranges[:, None] * rays)[sees]
        if is_moved:
            world = np.einsum("nij,nj->ni", at[sees, :3, :3], points) + at[sees, :3, 3]
            points = (world - middle[:3, 3]) @ middle[:3, :3]
        every.append(points.astype(np.float32))
        poses.append(middle)
    return every, poses
