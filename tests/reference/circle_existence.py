"""Existence of elements of the circle map in plain Python: odds, and what is learnt."""

from __future__ import annotations

import numpy as np

LIFETIME, LIFETIME_STANDING, CHANCE, SPEAKS = 60.0, 600.0, 0.2, 0.1  # [s]
KINDS = {"unknown": 0.05, "flying": 1e-3, "ground": 0.3, "static": 0.6, "clutter": 0.05}
MOVING, RESTING, LONGEST = -6.0, -0.1, 0.5  # [1/s], [1/s], [s]
TWICE, COVERED, GONE = 0.4, 0.15, (0.02, 0.3)
RATES = {"seen through": 40.0, "returns": 18.0}  # [1/s]
OVER, SURE, MOST = 0.05, 0.99, 1 - 1e-6
PRIOR, WEIGHT, MEMORY = {"revealed": 0.85, "piece": 0.5}, 5.0, 100.0


def bayes(p, ratio):
    return min(ratio * p / (ratio * p + 1 - p), MOST)


class Arrivals:
    """Share of objects among what began, by sort."""

    def __init__(self):
        self.ends = {sort: [] for sort in PRIOR}

    def share(self, sort):
        ends = self.ends[sort]
        weight = (1 - 1 / MEMORY) ** np.arange(len(ends))[::-1]
        share = (PRIOR[sort] * WEIGHT + weight @ np.array(ends)) / (WEIGHT + weight.sum())
        return min(share, 0.94)


class Existence:
    """Probability that one element was an object, and is still there."""

    def __init__(self, arrivals, variance):
        self.sort = "piece" if variance > 0.1**2 else "revealed"
        self.was, self.there = arrivals.share(self.sort), 1.0
        self.since, self.once, self.in_sight, self.told = 0.0, True, True, False
        self.anywhere, self.missed = 1.0, 1.0
        self.kinds = dict(KINDS)

    def __call__(self):
        return self.was * self.there

    def predict(self, dt):
        static = self.kinds["static"] / sum(self.kinds.values())
        stays = np.exp(-dt * (static / LIFETIME_STANDING + (1 - static) / LIFETIME))
        self.there, self.anywhere = stays * self.there, stays * self.anywhere
        self.since += dt

    def moves(self, stands, dt):
        """What stands is rarely something that moves; what moves is nothing that stands."""
        dt = min(max(dt, 0.0), LONGEST)
        for kind in self.kinds:
            if kind == "static" and not stands:
                self.kinds[kind] *= np.exp(MOVING * dt)
            if kind not in ("static", "unknown") and stands:
                self.kinds[kind] *= np.exp(RESTING * dt)

    def see(self, what, doubt=0.0):
        spoken = min(self.since, SPEAKS)
        if what == "measured":
            self.was = bayes(self.was, np.exp(spoken / CHANCE) / (TWICE if self.once else 1.0))
            self.there, self.once, self.anywhere, self.missed = 1.0, False, 1.0, 1.0
        elif what in RATES:
            miss = np.exp(-RATES[what] * spoken)
            self.there = bayes(self.there, miss)
            missed = min(max(self.missed * miss, doubt), self.missed)
            self.anywhere, self.missed = bayes(self.anywhere, missed / self.missed), missed
        elif what == "occluded" and self.in_sight and self.once:
            self.was = bayes(self.was, COVERED)
        if what == "measured" or what in RATES:
            self.since = 0.0
        self.in_sight = what == "measured"

    def settle(self, over, arrivals):
        if not self.told and (over or self.was > SURE):
            ratio = GONE[0 if self.once else 1] if self.there < 0.5 else 1.0
            arrivals.ends[self.sort].append(bayes(self.was, ratio))
            self.told = True
