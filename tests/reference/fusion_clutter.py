"""Oracle of clutter that stands, of the score of tracks, and of the spread of measurements."""

import numpy as np

from reference.fusion_company import is_beside, is_reported

OLDER_NS, PRIOR = 10_000_000_000, 10
KEPT_NS, MOST_SCANS, MOST_PLACES = 60_000_000_000, 300, 4096
NEW, CREDIBLE, LARGEST = -2.94, 2.94, 6.9
MEMORY, SHARE, NARROWEST = 80, 0.5, 3 / 16


def standing_density(past, stamp, place, half):
    """Density of clutter at a place: `past` has the time and the places of every scan."""
    old = [places for at, places in past if at <= stamp - OLDER_NS]
    inside = [
        (number, seen)
        for number, places in enumerate(old)
        for seen in places
        if np.all(np.abs(seen - place) <= half)
    ]
    if not inside:
        return 0.0
    return len(inside) / ((PRIOR + len(old) - inside[0][0]) * (2 * half) ** 2)


def keep(past, stamp, places):
    """Add a scan to the past of its scanner, unless the last one is too near in time."""
    most = np.clip(MOST_PLACES // max(len(places), 1), 1, MOST_SCANS)
    if not past or stamp - past[-1][0] >= KEPT_NS // most:
        past.append((stamp, places))
        del past[:-MOST_SCANS]


def weigh(track, options, missed, *, decides):
    """Score a track that was measured: `options` are its measurements over clutter."""
    score = track.get("score", NEW) + np.log(missed + sum(options))
    track["score"] = min(score, LARGEST)
    if not decides:
        return
    track["credible"] = track["score"] >= (0.0 if track.get("credible", True) else CREDIBLE)


def measure_spread(config, tracks, places, stamp):
    """Mean of the squares of what lies near each reported track."""
    reported = sorted((one for one in tracks if is_reported(one)), key=lambda one: one["id"])
    offsets = [[] for _ in reported]
    for place in places:
        away = [np.hypot(*(place - one["mean"][:2])) for one in reported]
        if not away or min(away) >= config.birth_distance:
            continue
        nearest = int(np.argmin(away))
        if not is_beside(reported[nearest], stamp, place, config.birth_distance):
            offsets[nearest].append(place - reported[nearest]["mean"][:2])
    for track, own in zip(reported, offsets, strict=True):
        if own:
            count = min(track.get("spread_scans", 0) + 1, MEMORY)
            now = np.mean([np.outer(one, one) for one in own], axis=0)
            before = track.get("spread", np.zeros((2, 2)))
            track["spread"], track["spread_scans"] = before + (now - before) / count, count


def reported_covariance(track):
    """Covariance of the state, and of a place within the target."""
    covariance = track["cov"].copy()
    variances, axes = np.linalg.eigh(SHARE * track.get("spread", np.zeros((2, 2))))
    variances[0] = max(variances[0], NARROWEST * variances[1])
    covariance[:2, :2] += axes @ np.diag(variances) @ axes.T
    return covariance
