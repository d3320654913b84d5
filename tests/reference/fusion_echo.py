"""Oracle of which tracks are echoes of nearer targets: from all that was seen of them."""

import numpy as np

APART, DRIFTS = np.radians(6.0), (np.radians(4.0), 15.0)
SPEED, RESTS, SHARE, FEWEST, LEAST_RATIO, MOVED = 3.0, 0.3, 0.2, 3, 1.8, 3.0
ACROSS = 5.0  # of the part that reflects [m]
FARTHEST = 5.0 * APART  # at the begin of a comparison
PATIENCE = 10.0  # [s]


def density(value, std):
    """Logarithm of the density of a normal distribution."""
    return -0.5 * (value / std) ** 2 - np.log(std * np.sqrt(2 * np.pi))


def log_odds(seconds, own, target, *, stands):
    """Of an echo: times (K,), and bearings and ranges (K, 2) of a track and of a nearer target."""
    if own[:, 1].mean() < LEAST_RATIO * target[:, 1].mean():
        return -np.inf
    apart = (own[:, 0] - target[:, 0] + np.pi) % (2 * np.pi) - np.pi
    drift = np.angle(np.exp(1j * (apart - apart[0])))
    beyond, turned = own[:, 1] - 2 * target[:, 1], np.unwrap(own[:, 0])
    most = [np.abs(v - v[0]).max() for v in (drift, beyond, turned, own[:, 1])]
    way = SPEED * (seconds[-1] - seconds[0])
    free = [np.hypot(way / own[:, 1].mean(), DRIFTS[0]), np.hypot(way, DRIFTS[1])]
    near = ACROSS / target[:, 1].mean()
    follows = density(most[0], np.hypot(DRIFTS[0], near)) + density(most[1], DRIFTS[1])
    moves = density(most[2], free[0]) + density(most[3], free[1])
    rests = density(most[2], DRIFTS[0]) + density(most[3], DRIFTS[1])
    alone = np.logaddexp(np.log(1 - RESTS) + moves, np.log(RESTS) + rests)
    if stands and seconds[-1] - seconds[0] > PATIENCE and follows - rests < MOVED:
        return -np.inf
    prior = np.log(SHARE / (1 - SHARE)) + np.log(2 * np.pi)
    return prior + density(apart.mean(), np.hypot(APART, near)) + follows - alone


class Echoes:
    """Follows the tracks of a tracker that tells of all but echoes."""

    def __init__(self, *, stands=False):
        self.seen, self.denied, self.stands = {}, set(), stands

    def echoes(self, stamp, tracks, radar):
        """Ids of the echoes among `tracks`: id, place, time of the last measurement of each.

        Without the place of a radar the scan is of another scanner.
        """
        if radar is None:
            self.denied |= {number for number, _, seen in tracks if seen == stamp}
            return set()
        sights = {}
        for number, place, seen in tracks:
            x, y = np.subtract(place, radar)
            sights[number] = (np.arctan2(y, x), np.hypot(x, y), seen == stamp)
        found, targets = set(), []
        for number in sorted(sights, key=lambda one: (sights[one][1], one)):
            bearing, far, is_measured = sights[number]
            for other in [] if number in self.denied else targets:
                apart = np.angle(np.exp(1j * (bearing - sights[other][0])))
                far_enough = far >= LEAST_RATIO * sights[other][1] and abs(apart) < FARTHEST
                rows = self.seen.setdefault((number, other), [])
                if is_measured and (rows or far_enough):
                    rows.append((stamp * 1e-9, bearing, far, *sights[other][:2]))
                if len(rows) >= FEWEST:
                    values = np.array(rows)
                    if (
                        log_odds(values[:, 0], values[:, 1:3], values[:, 3:], stands=self.stands)
                        > 0
                    ):
                        found.add(number)
            if number not in found:
                targets.append(number)
        return found
