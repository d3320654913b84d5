"""Slow reference: the motion during a scan of a spinning sensor without times of points.

The points are in the order of firing. Their azimuth tells the turn of the sensor, and the two ends
of a cloud of more than a turn tell whether the points were moved to one time already.
"""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

MOST_PER_SCAN, MOST, ENOUGH, PER_VOTE = 2.0, 10.0, 4.6, 0.35


def parts_of_scan(points: Array) -> tuple[NDArray[np.int64], Array, float, float] | None:
    """Block of every point, part of the scan over at each block, turn [rad], sense of turning."""
    block = int(np.clip(len(points) // 1024, 64, 256))
    count = len(points) // block
    azimuths = []
    for number in range(count):
        x, y = points[number * block : (number + 1) * block, :2].T
        length = np.hypot(x, y)
        sees = np.isfinite(length) & (length > 0.3)
        if not sees.any():
            azimuths.append(np.nan)
            continue
        along, across = np.sum(x[sees] / length[sees]), np.sum(y[sees] / length[sees])
        azimuths.append(np.arctan2(across, along))
    known = np.flatnonzero(np.isfinite(azimuths))
    if len(known) < 2:
        return None
    unwrapped = np.unwrap(np.array(azimuths)[known])
    steps = np.diff(unwrapped)
    sense = np.sign(unwrapped[-1] - unwrapped[0])
    per_block = abs(unwrapped[-1] - unwrapped[0]) / (known[-1] - known[0])
    turn = per_block * len(points) / block
    back = -np.minimum(sense * steps, 0).sum()
    if not 0.8 * 2 * np.pi <= turn <= 2.2 * 2 * np.pi:
        return None
    if back > 0.02 * turn or np.abs(steps).max() >= 2:
        return None
    angle = sense * unwrapped - sense * unwrapped[0] + per_block * (known[0] + 0.5)
    numbers = np.arange(count)
    angles = np.interp(numbers, known, angle)
    early, late = numbers < known[0], numbers > known[-1]
    angles[early] = angle[0] - per_block * (known[0] - numbers[early])
    angles[late] = angle[-1] + per_block * (numbers[late] - known[-1])
    of_point = np.minimum(np.arange(len(points)) // block, count - 1)
    return of_point, angles / turn, turn, sense


def part_of(motion: Array, part: float) -> Array:
    """Part of a motion (4, 4): on a straight line, and about one axis."""
    cosine = np.clip((np.trace(motion[:3, :3]) - 1) / 2, -1, 1)
    angle = np.arccos(cosine)
    found = np.eye(4)
    found[:3, 3] = part * motion[:3, 3]
    if angle > 1e-9:
        skew = (motion[:3, :3] - motion[:3, :3].T) / (2 * np.sin(angle))
        turn = part * angle
        found[:3, :3] += np.sin(turn) * skew + (1 - np.cos(turn)) * skew @ skew
    return found


def moved(points: Array, of_point: NDArray[np.int64], parts: Array, motion: Array) -> Array:
    """Points at the middle of the scan, in the frame of the sensor at that time."""
    poses = np.stack([part_of(motion, part - 0.5) for part in parts])[of_point]
    return np.einsum("nij,nj->ni", poses[:, :3, :3], points) + poses[:, :3, 3]


def distance(point: Array, others: Array) -> tuple[float, float]:
    """Distance of a point from the surface around it, and roughness of that surface [m].

    They are NaN if the points near it are few or no surface, as between rows.
    """
    apart = others - point
    squares = np.sum(apart**2, axis=1)
    wide = max(0.5, 0.06 * float(np.linalg.norm(point)))
    for reach in (0.5, wide):  # the larger one is for sensors with few rows
        near = apart[squares <= reach**2]
        if len(near) < 6:
            continue
        values, vectors = np.linalg.eigh(np.cov(near.T, bias=True))
        if values[0] <= 0.1 * values[1] and values[1] >= 0.1 * values[2]:
            return abs(vectors[:, 0] @ near.mean(0)), max(0.02, np.sqrt(max(0.0, values[0])))
    return np.nan, np.nan


def vote(as_given: tuple[float, float], with_motion: tuple[float, float]) -> int:
    """1 if the motion fits better, -1 if the points as given do, 0 if neither is clear."""
    (given, rough), (later, rough_later) = as_given, with_motion
    if np.isnan(given) or np.isnan(later):
        return 0
    difference, nearer = given - later, min(given, later)
    roughness = rough_later if difference > 0 else rough
    if abs(difference) <= max(0.05, 3 * roughness) or nearer > 2 * roughness:
        return 0
    return int(np.sign(difference))


def evidence_of(points: Array, motion: Array) -> float:
    """Evidence of one scan that its points have to be moved (logarithm of odds)."""
    found = parts_of_scan(points)
    if found is None:
        return 0.0
    of_point, parts, turn, sense = found
    overlap = turn - 2 * np.pi
    if overlap < 0.035:
        return 0.0
    later = moved(points, of_point, parts, motion)
    poses = np.stack([part_of(motion, part - 0.5) for part in parts])
    yaw = np.arctan2(poses[:, 1, 0], poses[:, 0, 0])
    angle = (parts * turn)[of_point]
    ranges = np.linalg.norm(points, axis=1)
    is_near = (ranges >= 3) & (ranges <= 60)
    head = np.flatnonzero(is_near & (angle < overlap + 0.35))
    tail = np.flatnonzero(is_near & (angle >= 2 * np.pi))
    step = max(1, -(-len(tail) // 200))
    if not len(head):
        return 0.0
    ends = angle[head].max(), (angle + sense * yaw[of_point])[head].max()
    votes, compared = 0, 0
    for row in tail[::step]:
        at = angle[row] - 2 * np.pi
        turned = np.arctan2(*later[row, 1::-1]) - np.arctan2(*points[row, 1::-1])
        turned = (turned + np.pi) % (2 * np.pi) - np.pi
        angles = at, at + sense * turned
        if any(not 0 <= one <= end for one, end in zip(angles, ends, strict=True)):
            continue
        both = distance(points[row], points[head]), distance(later[row], later[head])
        compared += not np.isnan(both).any()
        votes += vote(*both)
    if abs(votes) < max(3, 0.05 * compared):
        return 0.0
    return float(np.clip(PER_VOTE * votes, -MOST_PER_SCAN, MOST_PER_SCAN))


def is_estimated(scans: list[Array], poses: list[Array]) -> list[bool]:
    """Whether the points of each scan are moved, in a sequence without gaps."""
    total, found = 0.0, [False]
    for before, pose, points in zip(poses, poses[1:], scans[1:], strict=False):
        motion = np.linalg.inv(before) @ pose
        turned = np.linalg.norm(motion[:2, :3] - np.eye(3)[:2], axis=1).max()
        shift = max(np.linalg.norm(motion[:3, 3]), 10 * turned)
        if shift < 0.02:
            found.append(False)
            continue
        evidence = evidence_of(points, motion) if shift >= 0.15 else 0.0
        found.append(total + evidence > ENOUGH and parts_of_scan(points) is not None)
        was_enough, total = total > ENOUGH, float(np.clip(total + evidence, -MOST, MOST))
        if total > ENOUGH and not was_enough:
            total = MOST
    return found
