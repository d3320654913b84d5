"""Oracle of the delays of scanners: one target of constant velocity, in plain numpy."""

import numpy as np

PRIOR, MEMORY, LONGEST = 1.0, 300.0, 5.0


class Delays:
    """Weighted means of a prior of zero and of what innovations say; the least one is zero."""

    def __init__(self):
        self.seconds, self.information = {}, {}

    def of(self, source):
        self.information.setdefault(source, PRIOR)
        return self.seconds.setdefault(source, 0.0)

    def learn(self, source, innovation, variances, rates):
        kept = 1 - 1 / MEMORY
        known, old = self.seconds[source], kept * self.information[source]
        # what the innovation says: one estimate per value, known - innovation / rate
        weights = np.append(rates**2 / variances, [old, (1 - kept) * PRIOR])
        moving = rates != 0
        said = np.where(moving, known - innovation / np.where(moving, rates, 1.0), 0.0)
        estimates = np.append(said, [known, 0.0])
        if not (rates**2 / variances).sum() > 0:
            return
        self.information[source] = weights.sum()
        mean = (weights * estimates).sum() / weights.sum()
        self.seconds[source] = float(np.clip(mean, -LONGEST, LONGEST))
        least = min(self.seconds.values())
        self.seconds = {name: min(one - least, LONGEST) for name, one in self.seconds.items()}


def followed(scans, std, *, density, position, speed, hits):
    """States (K, 4) after each scan (time [s], source, place) and delays, of a tracker.

    The track is confirmed with its measurement number `hits`, and tells about delays from then on.
    """
    delays, states = Delays(), []
    time = mean = P = None
    sources = set()
    for number, (stamp, source, place) in enumerate(scans):
        delay = delays.of(source)
        if mean is None:
            mean, time = np.append(place, [0.0, 0.0]), stamp - delay
            P = np.diag([position**2] * 2 + [speed**2] * 2)
        else:
            dt, time = stamp - time, stamp
            F = np.eye(4)
            F[0, 2] = F[1, 3] = dt
            own = density**2 * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
            mean, P = F @ mean, F @ P @ F.T + np.kron(own, np.eye(2))
            H = np.hstack([np.eye(2), -delay * np.eye(2)])
            S = H @ P @ H.T + std[source] ** 2 * np.eye(2)
            innovation, velocity = np.asarray(place) - H @ mean, mean[2:]
            gain = P @ H.T @ np.linalg.inv(S)
            mean, P = mean + gain @ innovation, P - gain @ S @ gain.T
            if number >= hits and len(delays.seconds) > 1 and len(sources | {source}) > 1:
                delays.learn(source, innovation, np.diag(S), velocity)
        sources.add(source)
        states.append(mean)
    return np.array(states), delays.seconds
