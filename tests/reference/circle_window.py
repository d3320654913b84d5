"""What a network is shown of one window: plain numpy, one window at a time."""

import numpy as np

SLOTS = 32


def shown(bearings, ranges, sides, gaps, range_std, beam_half_width, limits):
    """Slots (32, 4), context (21,) and frame: bearing, unit, distance, radius, hits."""
    n_rays = len(ranges)
    hits = np.isfinite(ranges)
    bearings, ranges = bearings[hits], ranges[hits]
    span = np.angle(np.exp(1j * (bearings[-1] - bearings[0])))
    turn = -1.0 if span < 0 or (span == 0 and gaps[0] < 0) else 1.0
    before, after = (max(0.5 * abs(gap) - beam_half_width, 0.05 * abs(gap)) for gap in gaps)
    half = min(max((abs(span) + before + after) / 2, 1e-6), 1.55)
    middle = bearings[0] + turn * (abs(span) + after - before) / 2
    off = turn * np.angle(np.exp(1j * (bearings - middle)))
    unit = np.cos(off) - np.sqrt(np.maximum(np.sin(half) ** 2 - np.sin(off) ** 2, 0))
    distance = (unit @ ranges) / (unit @ unit)
    radius = distance * np.sin(half)
    scale = np.clip(radius, 0.03, 1.0)
    difference = np.clip((ranges - distance * unit) / scale, -4, 4)
    aside = np.clip(np.sin(off) / np.sin(half), -1, 1)
    rows = np.stack([difference, aside, np.sqrt(1 - aside**2), np.ones(len(off))], axis=1)
    count = len(rows)
    slots = np.zeros((SLOTS, 4))
    slot = np.arange(count) * min(count, SLOTS) // count
    for number in range(min(count, SLOTS)):
        slots[number] = rows[slot == number].mean(axis=0)
    noise = max(range_std, 1e-4) / scale
    far = np.clip(limits[1] - ranges[[0, -1]], -0.1, 1.0)
    context = [
        np.log(max(distance, 1e-3)),
        np.log(max(radius, 1e-4)),
        np.log(noise),
        np.log(count),
        np.log(max(np.abs(gaps).mean() * distance / scale, 1e-6)),
        half / (np.pi / 2),
        np.log(max(np.sqrt(np.mean(difference**2)) / noise, 1e-2)),
        beam_half_width * distance / scale,
        1 - count / n_rays,
        *far,
        np.clip((ranges.min() - limits[0]) / 0.3, -0.1, 1.0),
        np.log(noise / np.sqrt(max(count / SLOTS, 1))),
        *np.eye(4)[sides[0]],
        *np.eye(4)[sides[1]],
    ]
    return slots, np.array(context), np.array([middle, scale, distance, radius, count])


def circle(frame, answer):
    """Circle and covariance that an answer means."""
    bearing, scale, distance, radius, _ = frame
    lower = np.diag(np.exp(answer[3:6]))
    lower[1, 0] = answer[6] * lower[1, 1]
    lower[2, 0], lower[2, 1] = answer[7:9] * lower[2, 2]
    turn = np.eye(3)
    turn[:2, :2] = [[np.cos(bearing), -np.sin(bearing)], [np.sin(bearing), np.cos(bearing)]]
    found = turn @ (np.array([distance, 0.0, radius]) + scale * answer[:3])
    found[2] = max(found[2], 1e-3)
    return found, scale**2 * turn @ lower @ lower.T @ turn.T
