"""Oracle of the kinds of fused tracks: motions with full matrices, plain probabilities."""

import numpy as np

SHARES = np.array([0.02, 0.3, 0.3, 0.33, 0.05])
STATIC, CLUTTER = 3, 4
KEPT, TOLD, ALIKE = 12, 1.0, 0.9
WANDERS, SPEEDS, SLOWEST, RESTS = 0.05, (1.0, 0.3, 0.1, 0.03), 0.1, 0.3
CHANGES, STANDS, KEEPS, MOST = 10.0, 300.0, 30.0, 3.0
CLIMBS, LEVEL, SLOPES, CRUISES, FEWEST_OF_CLIMB, MOST_OF_CLIMB = 1.0, 0.1, 0.1, 0.5, 6, 5.0
LEAST, FEWEST = 1e-6, 6
NODES, WEIGHTS = np.polynomial.legendre.leggauss(40)
BEGINS = np.array([RESTS, *[(1 - RESTS) / len(SPEEDS)] * len(SPEEDS)])
"""Shares of the motions of what moves."""


def line(seen):
    """Velocity, variance of a place, freedom, squares of times; `seen`: time, place, variances."""
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
    return velocity, (TOLD * told + left) / freedom * (1 + alike) / (1 - alike), freedom, spread


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


def united(parts):
    """One normal distribution for several (weight, mean (2,), covariance (2, 2))."""
    weights = np.array([weight for weight, _, _ in parts]) / sum(weight for weight, _, _ in parts)
    mean = sum(w * m for w, (_, m, _) in zip(weights, parts, strict=True))
    away = [np.outer(m - mean, m - mean) for _, m, _ in parts]
    spread = sum(w * (c + a) for w, (_, _, c), a in zip(weights, parts, away, strict=True))
    return mean, spread


class Motions:
    """Stands for good, rests, moves at four speeds: each has its Kalman filter, axis by axis."""

    def __init__(self, place, told, speed):
        self.odds = np.array([SHARES[STATIC], *((1 - SHARES[STATIC]) * BEGINS)])
        self.states = [
            [self.drawn((x, variance), deviation) for x, variance in zip(place, told, strict=True)]
            for deviation in self.deviations(speed)
        ]

    @staticmethod
    def deviations(speed):
        return [WANDERS, WANDERS, *(max(share * speed, SLOWEST) for share in SPEEDS)]

    @staticmethod
    def drawn(place, deviation):
        """At a place with its variance, with a velocity that is zero on average."""
        return np.array([place[0], 0.0]), np.diag([place[1], deviation**2])

    def renew(self, dt, speed):
        changes, ends = 1 - np.exp(-dt / CHANGES), 1 - np.exp(-dt / STANDS)
        stands, moves = self.odds[0], self.odds[1:]
        moves_on = [1 - ends, *[(1 - changes) * (1 - ends)] * 5]
        from_moving = [ends, *(changes * (1 - ends) * BEGINS)]
        from_standing = [0.0, *(ends * BEGINS)]
        before, places = self.states, []
        for axis in (0, 1):
            movers = [(p, *one[axis]) for p, one in zip(moves, before[1:], strict=True)]
            ways = united(movers), before[0][axis]
            places.append([(mean[0], spread[0, 0]) for mean, spread in ways])
        for motion, deviation in enumerate(self.deviations(speed)):
            own = []
            for axis in (0, 1):
                moved, stood = (self.drawn(place, deviation) for place in places[axis])
                parts = [
                    (moves_on[motion] * self.odds[motion], *before[motion][axis]),
                    (from_moving[motion] * moves.sum(), *moved),
                    (from_standing[motion] * stands, *stood),
                ]
                own.append(united(parts))
            self.states = [*self.states[:motion], own, *self.states[motion + 1 :]]
        self.odds = moves_on * self.odds + np.multiply(from_moving, moves.sum())
        self.odds += np.multiply(from_standing, stands)

    def see(self, dt, place, noise, freedom, speed):
        self.renew(dt, speed)
        kept = np.exp(-dt / KEEPS)
        step = np.array([[1.0, KEEPS * (1 - kept)], [0.0, kept]])
        # Integrals of the response of place and velocity to a push, over the time since the push.
        since, weights = (NODES + 1) * dt / 2, WEIGHTS * dt / 2
        response = np.array([KEEPS * (1 - np.exp(-since / KEEPS)), np.exp(-since / KEEPS)])
        pushes = (response * weights) @ response.T
        log = np.zeros(6)
        for motion, deviation in enumerate(self.deviations(speed)):
            for axis in (0, 1):
                mean, spread = self.states[motion][axis]
                mean = step @ mean
                spread = step @ spread @ step.T + 2 * deviation**2 / KEEPS * pushes
                variance = spread[0, 0] + noise[axis]
                gain, away = spread[:, 0] / variance, place[axis] - mean[0]
                log[motion] += np.log(density(away, variance, freedom))
                spread = spread - np.outer(gain, spread[0])
                self.states[motion][axis] = mean + gain * away, spread
        odds = self.odds * np.exp(np.maximum(log - log.max(), -MOST))
        odds = np.maximum(odds / odds.sum(), LEAST)
        self.odds = odds / odds.sum()


def see(track, stamp, place, told, speed, *, in_space=False):
    """Take in a place (3,) of a track with its told variances (3,)."""
    past = track.setdefault("places", [])
    past.append((stamp * 1e-9, *place, *told))
    del past[:-KEPT]
    seen = np.array(past)
    found = line(seen) if len(past) > 2 else None
    if "motions" not in track:
        if len(past) >= FEWEST:
            noise = seen[:, 4:6].mean(axis=0) if found is None else found[1][:2]
            track["motions"] = Motions(place[:2], noise, speed)
        return
    motions, dt = track["motions"], past[-1][0] - past[-2][0]
    if dt <= 0:
        return
    velocity, noise, freedom, spread = found
    motions.see(dt, place[:2], noise[:2], freedom, speed)
    if in_space and len(past) >= FEWEST_OF_CLIMB:
        level = LEVEL**2 + (SLOPES * np.hypot(*velocity[:2])) ** 2
        climb = velocity[2], noise[2] / spread
        ratio = density(climb[0], climb[1] + level + CLIMBS**2, freedom) / density(
            climb[0], climb[1] + level, freedom
        )
        climbs = np.clip(np.log((1 - CRUISES) * ratio + CRUISES), 0, MOST_OF_CLIMB)
        flies = np.exp(climbs / len(past))
        before = track.get("climbs", SHARES / SHARES.sum())
        track["climbs"] = weighed(before, [np.sqrt(flies), flies, 1.0, 1.0, 1.0])


def probabilities(track, clutter=None):
    """Of the kinds; `clutter` is that of clutter where the association tells it."""
    belief = track.get("climbs", SHARES / SHARES.sum())
    if "motions" in track:
        stands = track["motions"].odds[0]
        by_motion = np.full(5, (1 - stands) / (1 - SHARES[STATIC]))
        by_motion[STATIC] = stands / SHARES[STATIC]
        belief = weighed(belief, by_motion)
    if clutter is None:
        return belief
    told = np.append(belief[:CLUTTER] * (1 - clutter) / (1 - belief[CLUTTER]), clutter)
    return weighed(np.full(5, 0.2), told)
