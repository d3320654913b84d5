"""Oracle of the kinds of fused tracks: lines through all places, plain probabilities."""

import numpy as np

SHARES = np.array([0.02, 0.3, 0.3, 0.33, 0.05])
KEPT, TOLD, ALIKE = 12, 1.0, 0.9
WANDERS, SPEEDS, RESTS, REST, MOST = 0.05, (1.0, 0.3, 0.1, 0.03), 0.3, 10.0, 5.0
STANDS = 0.95
CLIMBS, LEVEL, SLOPES, CRUISES, FEWEST_OF_CLIMB = 1.0, 0.1, 0.1, 0.5, 6
LEAST = 1e-6


def slopes(seen):
    """Velocity, variance, degrees of freedom; `seen` has rows of time, x, y, z and variances."""
    count = len(seen)
    if count < 3:
        return None
    t, place, told = seen[:, 0], seen[:, 1:4], seen[:, 4:].mean(axis=0)
    away, mean = t - t.mean(), place.mean(axis=0)
    spread = away @ away
    velocity = away @ (place - mean) / spread
    errors = place - mean - np.outer(away, velocity)
    left, steps = np.square(errors).sum(axis=0), np.square(np.diff(errors, axis=0)).sum(axis=0)
    alike = 1 - (steps + 2 * TOLD * told) / np.maximum(2 * (left + TOLD * told), 1e-300)
    alike = np.clip(alike, 0, ALIKE)
    freedom = TOLD + count - 2
    variance = (TOLD * told + left) / freedom / spread * (1 + alike) / (1 - alike)
    return velocity, variance, freedom, count


def density(velocity, variance, freedom):
    """Student's t, up to a constant."""
    return (1 + velocity**2 / (freedom * variance)) ** (-(freedom + 1) / 2) / np.sqrt(variance)


def weighed(belief, likelihood):
    """By the rule of Bayes; no kind falls below `LEAST`."""
    likelihood = np.maximum(np.array(likelihood) / max(likelihood), LEAST)
    for _ in range(2):
        belief = belief * likelihood
        belief, likelihood = np.maximum(belief / belief.sum(), LEAST), 1.0
    return belief


def see(track, stamp, place, told, speed, *, in_space=False):
    """Take in a place (3,) of a track with its told variances (3,)."""
    past = track.setdefault("places", [])
    past.append((stamp * 1e-9, *place, *told))
    del past[:-KEPT]
    if len(past) < 2 or past[-1][0] <= past[-2][0]:
        return
    found = slopes(np.array(past))
    if found is None:
        return
    velocity, variance, freedom, count = found

    def both(more):
        return density(velocity[:2], variance[:2] + more, freedom).prod()

    ratio = np.mean([both((share * speed) ** 2) for share in SPEEDS]) / both(WANDERS**2)
    moves = np.log((1 - RESTS) * ratio + RESTS)
    dt = past[-1][0] - past[-2][0]
    belief = track.get("kinds", SHARES / SHARES.sum())
    rest = min(1 / count, dt / REST) if belief[3] < STANDS else 0.0
    moves = np.exp(min(moves, MOST) / count if moves > 0 else moves * rest)
    belief = weighed(belief, [np.sqrt(moves), moves, moves, 1.0, moves])
    if in_space and count >= FEWEST_OF_CLIMB:
        level = LEVEL**2 + (SLOPES * np.hypot(*velocity[:2])) ** 2
        climb = velocity[2], variance[2]
        ratio = density(climb[0], climb[1] + level + CLIMBS**2, freedom) / density(
            climb[0], climb[1] + level, freedom
        )
        climbs = np.clip(np.log((1 - CRUISES) * ratio + CRUISES), 0, MOST)
        flies = np.exp(climbs / count)
        belief = weighed(belief, [np.sqrt(flies), flies, 1.0, 1.0, 1.0])
    track["kinds"] = belief


def probabilities(track, clutter=None):
    """Of the kinds; `clutter` is that of clutter where the association tells it."""
    belief = track.get("kinds", SHARES / SHARES.sum())
    if clutter is None:
        return belief
    told = np.append(belief[:4] * (1 - clutter) / (1 - belief[4]), clutter)
    return weighed(np.full(5, 0.2), told)
