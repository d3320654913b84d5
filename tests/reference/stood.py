"""Places that gave returns again and again before a track began there: plain loops."""

import numpy as np

CELL, AROUND, OTHER = 0.3, 2.5, 0.8  # m
WINDOW, FRESH, LONG = 4_000_000_000, 300_000_000, 1_500_000_000  # ns
STEPS, FEWEST = 64, 5
SHARES = (0.35, 0.6)
HAS_SPEED = 21.1  # squared Mahalanobis distance of a velocity from none
LAST = 5  # detections


def cell_of(place):
    return tuple(np.floor(np.asarray(place, float) / CELL).astype(int).tolist())


def has_speed(track):
    velocity, P = track.x[3:6], track.P[3:6, 3:6]
    return velocity @ np.linalg.solve(P, velocity) >= HAS_SPEED


class EarlierReturns:
    """Steps of time: when each began, and the cells with returns."""

    def __init__(self):
        self.steps = []

    def add(self, stamp, places):
        if not self.steps or stamp - self.steps[-1][0] >= WINDOW // (STEPS - 4):
            self.steps = [*self.steps, (stamp, set())][-STEPS:]
        self.steps[-1][1].update(cell_of(place) for place in places)

    def around(self, place, born):
        """Scans before a track, with their returns around it; None if too few are known."""
        window = [step for step in self.steps if born - WINDOW <= step[0] <= born - FRESH]
        if len(window) < FEWEST:
            return None
        low, high = cell_of(np.subtract(place, AROUND)), cell_of(np.add(place, AROUND))
        scans = [
            {cell for cell in cells if np.all((np.array(low) <= cell) & (np.array(cell) <= high))}
            for _, cells in window
        ]
        stood = Stood(scans)
        if born - window[0][0] >= LONG:
            middles = [(np.array(cell) + 0.5) * CELL for cell in set().union(*scans)]
            far = [at for at in middles if np.linalg.norm(at - place) > OTHER]
            stood.is_beside = any(stood.at(at) >= 1 for at in far)
        return stood


class Stood:
    def __init__(self, scans):
        self.scans, self.is_beside = scans, False

    def at(self, place):
        offsets = np.array(list(np.ndindex(3, 3, 3))) - 1
        near = {tuple((np.array(cell_of(place)) + offset).tolist()) for offset in offsets}
        share = sum(bool(cells & near) for cells in self.scans) / len(self.scans)
        return float(np.clip((share - SHARES[0]) / (SHARES[1] - SHARES[0]), 0, 1))
