"""Oracle of which tracks are left out: those that stand, and parts of long objects."""

import numpy as np


def velocity(way, stamp, place, span, least):
    """Mean over the last `span` seconds; None if less than `least` is known."""
    since, start = next((one for one in way if one[0] >= stamp - span * 1e9), (stamp, place))
    elapsed = (stamp - since) * 1e-9
    return (place - start) / elapsed if stamp - since >= least * 1e9 else None


def is_part(one, other, distance):
    """Whether `other` goes along with `one`, ahead or astern."""
    if one["velocity"] is None or other["velocity"] is None:
        return False
    if np.linalg.norm(one["velocity"] - other["velocity"]) > 3.0:
        return False
    away = offset(one["velocity"], other["mean"][:2] - one["mean"][:2])
    return away is not None and bool((np.abs(away) <= np.multiply([1.5, 0.6], distance)).all())


def offset(velocity, away):
    """How far ahead and to the right; None for what hardly moves."""
    if velocity is None or np.linalg.norm(velocity) < 0.3:
        return None
    x, y = velocity / np.linalg.norm(velocity)
    return np.array([away @ [x, y], away @ [y, -x]])


def holds(track, stamp, place, distance):
    """Whether a place may be of the body of a track."""
    own = track["mean"][:2]
    away = offset(velocity(track.get("way", []), stamp, own, 5, 2), place - own)
    is_abeam = away is not None and abs(away[1]) > 0.5 * distance
    return np.hypot(*(place - own)) < distance and not is_abeam


def is_beside(track, stamp, place, distance):
    """Whether a place is too far abeam to be on a track's body."""
    own = track["mean"][:2]
    away = offset(velocity(track.get("way", []), stamp, own, 5, 2), place - own)
    return away is not None and abs(away[1]) > 0.25 * distance


def keep_company(config, stamp, tracks):
    """Set `left_out` of all confirmed tracks."""
    if config.report_speed <= 0 and config.birth_distance <= 0:
        return
    moving = []
    for track in tracks:
        place, way = track["mean"][:2].copy(), track.setdefault("way", [])
        if not way or stamp - way[-1][0] >= 1e9:
            way.append((stamp, place))
        way[:] = [one for one in way if stamp - one[0] <= 15e9]
        if not track["confirmed"]:
            continue
        mean = velocity(way, stamp, place, 15, 5)
        track["stands"] = mean is not None and bool(np.linalg.norm(mean) < config.report_speed)
        track["velocity"] = velocity(way, stamp, place, 5, 2)
        if not track["stands"]:
            moving.append(track)
    leads = []
    for track in sorted(moving, key=lambda one: (-one["hits"], one["born"], one["id"])):
        along = any(is_part(one, track, config.birth_distance) for one in leads)
        before = track.get("together", 0)
        track["together"] = min(before + 1, 10) if along else max(before - 1, 0)
        track["part"] = along and track["together"] > 5
        if not along:
            leads.append(track)


def is_reported(track):
    """Whether a track is confirmed and not left out."""
    is_left_out = track.get("part", False) or track.get("stands", False)
    return track["confirmed"] and not is_left_out and track.get("credible", True)
