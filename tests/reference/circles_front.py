"""A 2D scan before its circles are fitted, written out: eqs 4-6, and a scanner to make scans."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
FREE, OCCLUDED, FIELD_EDGE, RANGE_CUT = range(4)


def rotation(yaw: float, pitch: float, roll: float) -> Array:
    """Rz(yaw) Ry(pitch) Rx(roll)."""
    about_z = [[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]]
    about_y = [[np.cos(pitch), 0, np.sin(pitch)], [0, 1, 0], [-np.sin(pitch), 0, np.cos(pitch)]]
    about_x = [[1, 0, 0], [0, np.cos(roll), -np.sin(roll)], [0, np.sin(roll), np.cos(roll)]]
    return np.array(about_z) @ np.array(about_y) @ np.array(about_x)


def pose(position=(0.0, 0.0, 0.0), yaw=0.0, pitch=0.0, roll=0.0) -> Array:
    """`world_from_lidar` as a matrix (4, 4)."""
    matrix = np.eye(4)
    matrix[:3, :3] = rotation(yaw, pitch, roll)
    matrix[:3, 3] = position
    return matrix


def cylinder_ranges(bearings: Array, world_from_lidar: Array, circles: Array) -> Array:
    """Noise-free ranges to upright cylinders (x, y, radius), one pose or one per ray."""
    poses = np.broadcast_to(world_from_lidar, (len(bearings), 4, 4))
    directions = np.stack([np.cos(bearings), np.sin(bearings), np.zeros(len(bearings))], axis=1)
    directions = np.einsum("nij,nj->ni", poses[:, :3, :3], directions)[:, :2]
    ranges = np.full(len(bearings), np.inf)
    for x, y, radius in np.atleast_2d(circles):
        offset = poses[:, :2, 3] - (x, y)
        a = (directions**2).sum(axis=1)
        b = (directions * offset).sum(axis=1)
        root = b**2 - a * ((offset**2).sum(axis=1) - radius**2)
        hit = (root >= 0) & (a > 0)
        distance = (-b[hit] - np.sqrt(root[hit])) / a[hit]
        ranges[hit] = np.where(distance > 0, np.minimum(ranges[hit], distance), ranges[hit])
    return ranges


def limit_range(ranges: Array, bearings: Array, world_from_lidar: Array, planes: Array) -> Array:
    """Eq. 4, by walking along every ray that ends outside."""
    limited = ranges.copy()
    for ray in np.flatnonzero(np.isfinite(ranges)):
        direction = world_from_lidar[:3, :3] @ (np.cos(bearings[ray]), np.sin(bearings[ray]), 0)

        def inside(distance, direction=direction):
            points = world_from_lidar[:3, 3] + np.multiply.outer(distance, direction)
            return (points @ planes[:, :3].T <= planes[:, 3]).all(axis=-1)

        if not inside(ranges[ray]):
            beyond = inside(np.linspace(ranges[ray], ranges[ray] + 50, 20001))
            limited[ray] = np.nan if beyond.any() else np.inf
    return limited


def project(ranges: Array, bearings: Array, world_from_lidar: Array) -> tuple[Array, Array, Array]:
    """The formulas of the exact projection with roll and pitch, bearings within +-pi."""
    r = world_from_lidar[:3, :3]
    pitch, roll = -np.arcsin(np.clip(r[2, 0], -1, 1)), np.arctan2(r[2, 1], r[2, 2])
    ct, st, cf, sf = np.cos(pitch), np.sin(pitch), np.cos(roll), np.sin(roll)
    c, s = np.cos(bearings), np.sin(bearings)
    x, y, z = ct * c + st * sf * s, cf * s, -st * c + ct * sf * s
    hit = np.isfinite(ranges)
    return (
        np.where(hit, np.where(hit, ranges, 0) * np.hypot(x, y), ranges),
        np.arctan2(y, x),
        np.where(hit, np.where(hit, ranges, 0) * z, np.nan),
    )


def segment(ranges, bearings, *, incidence, slack, max_gap, corner, min_points, limits, margins):
    """Eq. 6 with the adaptive bound in both spaces, without the second pass, by plain loops.

    Returns labels and the sides of every segment.
    """
    count = len(ranges)
    wraps = count > 2 and 2 * np.pi - abs(_turns(bearings)) <= 1.5 * abs(_turns(bearings)) / (
        count - 1
    )
    hits = [int(ray) for ray in np.flatnonzero(np.isfinite(ranges))]

    def joins(a, b):
        steps = (b - a) % count
        angle = abs(_wrapped(bearings[b] - bearings[a]))
        step = angle / steps
        near = min(ranges[a], ranges[b])
        bent = min(step, incidence / 4)
        bound = near * np.sin(bent) / np.sin(incidence - bent) + near * (angle - step)
        points = [ranges[i] * np.exp(1j * bearings[i]) for i in (a, b)]
        return steps <= max_gap + 1 and abs(points[1] - points[0]) <= bound + slack

    groups: list[list[int]] = []
    for previous, ray in zip([None, *hits], hits, strict=False):
        if previous is not None and joins(previous, ray):
            groups[-1].append(ray)
        else:
            groups.append([ray])
    if wraps and len(groups) > 1 and joins(hits[-1], hits[0]):
        groups.append(groups.pop() + groups.pop(0))
    points = np.where(np.isfinite(ranges), ranges, 0) * np.exp(1j * bearings)
    surfaces = [surface for group in groups for surface in _surfaces(points, group, corner)]
    firsts = {group[0] for group in groups}
    lasts = {group[-1] for group in groups}
    groups = [surface for surface in surfaces if len(surface) >= min_points]

    def side(ray, step):
        beyond = ray + step
        if ray not in (firsts if step < 0 else lasts):
            return OCCLUDED  # another surface begins in a corner
        if not wraps and not 0 <= beyond < count:
            return FIELD_EDGE
        beyond_range = ranges[beyond % count]
        if np.isnan(beyond_range) or beyond_range <= ranges[ray]:
            return OCCLUDED
        cut = ranges[ray] > limits[1] - margins[1] or ranges[ray] < limits[0] + margins[0]
        return RANGE_CUT if cut and np.isinf(beyond_range) else FREE

    return groups, [[side(group[0], -1), side(group[-1], 1)] for group in groups]


def _surfaces(points, group, corner):
    """Cut a group at the hit deepest behind the chord, or round the sensor at the farthest one."""
    depth, width = corner
    if depth == 0 or len(group) < 2:
        return [group] if group else []
    chord = points[group[-1]] - points[group[0]]
    turned = abs(np.angle(points[group[1:]] / points[group[:-1]]).sum())
    if turned >= 0.9 * np.pi:
        quarter = len(group) // 4
        middle = group[quarter : len(group) - quarter]
        cut = quarter + len(middle) - 1 - int(np.argmax(abs(points[middle])[::-1]))
    elif abs(chord) < width:
        return [group]
    else:
        across = ((points[group] - points[group[0]]) / chord).imag * abs(chord)
        across *= np.sign((-points[group[0]] / chord).imag) * -1
        cut = len(group) - 1 - int(np.argmax(across[::-1]))
        if across[cut] < depth or cut + 1 == len(group):
            return [group]
    parts = group[: max(cut - 1, 0)], group[cut + 2 :]  # what is next to the corner is unclear
    return [surface for part in parts for surface in _surfaces(points, part, corner)]


def _wrapped(angle):
    return (angle + np.pi) % (2 * np.pi) - np.pi


def _turns(bearings):
    return _wrapped(np.diff(bearings)).sum()
