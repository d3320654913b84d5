"""Oracle of the tracker of many targets: constant velocity, positions only, brute force."""

from itertools import permutations, product

import numpy as np

from reference.fusion_clutter import NEW, keep, measure_spread, standing_density, weigh
from reference.fusion_company import holds, keep_company
from reference.fusion_kinds import probabilities, see
from reference.fusion_scanner import Learnt, last_places


def gaussian_step(mean, covariance, dt, density):
    """Constant velocity [x, y, vx, vy] under white acceleration."""
    move = np.eye(4)
    move[0, 2] = move[1, 3] = dt
    noise = np.zeros((4, 4))
    for axis in range(2):
        rows = [axis, axis + 2]
        noise[np.ix_(rows, rows)] = density * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
    return move @ mean, move @ covariance @ move.T + noise


def cheapest(cost):
    """Column of every row, or -1: as many pairs as possible, of those the cheapest sum."""
    rows, columns = cost.shape
    padded = np.hstack([cost, np.full((rows, rows), 1e6)])
    best, least = [], np.inf
    for chosen in permutations(range(columns + rows), rows):
        total = sum(padded[row, column] for row, column in enumerate(chosen))
        if total < least:
            best, least = chosen, total
    return [column if column < columns else -1 for column in best]


class ManyTargets:
    """As `lidar_core.fusion.MultiTargetTracker`, with `kf`, `cv` and LiDAR measurements."""

    def __init__(self, config, *, gate):
        self.config, self.gate = config, gate
        self.tracks, self.next_id, self.stamp = [], 0, None
        self.past, self.standing = {}, []

    def process(self, stamp, places, source):
        target = self.config.target
        numbers = [-1] * len(places)
        self.nis = [np.nan] * len(places)
        for track in self.tracks:
            dt = (stamp - track["stamp"]) * 1e-9
            track["mean"], track["cov"] = gaussian_step(
                track["mean"], track["cov"], dt, target.acceleration_noise**2
            )
            track["stamp"] = stamp
            if source in track["sources"]:
                track["history"].append(0)
        self.take_in(stamp, places, source)
        for confirmed in (True, False):
            self.associate(
                [t for t in self.tracks if t["confirmed"] is confirmed],
                stamp,
                places,
                source,
                numbers,
            )
        distance = self.config.birth_distance
        bodies = [dict(one) for one in self.tracks if one["seen"] == stamp]
        for one in bodies:
            one["way"] = list(one.get("way", []))
        for track in self.tracks:
            self.judge(track)
        ended = [track for track in self.tracks if not self.stays(track, stamp)]
        self.tracks = [track for track in self.tracks if self.stays(track, stamp)]
        self.learn(places, ended, source)
        keep_company(self.config, stamp, self.tracks)
        measure_spread(self.config, self.tracks, places, stamp)
        for column, place in enumerate(places):
            near = any(holds(one, stamp, place, distance) for one in bodies)
            if numbers[column] >= 0 or near:
                continue
            spread = np.repeat([target.initial_position**2, target.initial_speed**2], 2)
            track = {
                "id": self.next_id,
                "mean": np.array([*place, 0.0, 0.0]),
                "cov": np.diag(spread),
                "history": [1],
                "sources": {source},
                "origin": source,
                "seen": stamp,
                "born": stamp,
                "stamp": stamp,
                "confirmed": False,
                "hits": 1,
            }
            self.judge(track)
            self.tracks.append(track)
            numbers[column] = self.next_id
            self.next_id += 1
        for track in self.tracks:
            own = [at for at, number in zip(places, numbers, strict=True) if number == track["id"]]
            if track["seen"] == stamp:
                track["clutter"] = self.clutter(track)
            if own and track["seen"] == stamp:
                told = [*np.square(target.lidar_std), 0.0]
                see(track, stamp, [*np.mean(own, axis=0), 0.0], told, target.initial_speed)
        return numbers

    def clutter(self, track):
        """Probability that the measurements of a track are clutter; None: nothing tells."""

    def learn(self, places, ended, source):
        """Learn about the scanner; nothing where no density is needed."""

    def kinds(self, track):
        """Probabilities of the kinds of a track."""
        return probabilities(track, track["clutter"])

    def take_in(self, stamp, places, source):
        """Density of what stands at every place, from what was seen before."""
        past = self.past.setdefault(source, [])
        half = np.sqrt(np.prod(self.config.target.lidar_std))
        self.standing = [
            standing_density(past, stamp, place, half) if self.config.report_speed > 0 else 0.0
            for place in places
        ]
        keep(past, stamp, places)

    def associate(self, tracks, stamp, places, source, numbers):
        noise = np.diag(np.square(self.config.target.lidar_std))
        cost = np.full((len(tracks), len(places)), 2e6)
        for row, track in enumerate(tracks):
            spread = track["cov"][:2, :2] + noise
            for column, place in enumerate(places):
                nis = self.distance(track, place, noise)
                if numbers[column] < 0 and nis <= self.gate:
                    cost[row, column] = nis + np.log(np.linalg.det(spread))
        for track, column in zip(tracks, cheapest(cost), strict=True):
            if column < 0:
                continue
            self.nis[column] = self.distance(track, places[column], noise)
            gain = track["cov"][:, :2] @ np.linalg.inv(track["cov"][:2, :2] + noise)
            track["mean"] = track["mean"] + gain @ (places[column] - track["mean"][:2])
            track["cov"] = track["cov"] - gain @ track["cov"][:2]
            self.see(track, stamp, source)
            numbers[column] = track["id"]

    def distance(self, track, place, noise):
        error = place - track["mean"][:2]
        return error @ np.linalg.inv(track["cov"][:2, :2] + noise) @ error

    def see(self, track, stamp, source):
        if source not in track["sources"]:
            track["history"].append(0)
        track["history"][-1] = 1
        track["sources"].add(source)
        track["seen"], track["hits"] = stamp, track["hits"] + 1

    def judge(self, track):
        recent = track["history"][-self.config.confirm_window :]
        track["confirmed"] = track["confirmed"] or sum(recent) >= self.config.confirm_hits

    def stays(self, track, stamp):
        recent = track["history"][-self.config.confirm_window :]
        misses = self.config.confirm_window - self.config.confirm_hits
        alive = track["confirmed"] or len(recent) - sum(recent) <= misses
        spread = np.sqrt(np.diag(track["cov"])[:2].max())
        return (
            alive
            and (stamp - track["seen"]) * 1e-9 <= self.config.max_coast
            and spread <= self.config.max_position_std
        )


class JointTargets(ManyTargets):
    """The same with `association="joint"`: every joint event, one by one."""

    def __init__(self, config, *, gate):
        super().__init__(config, gate=gate)
        self.scanners = {}

    def take_in(self, stamp, places, source):
        super().take_in(stamp, places, source)
        anywhere = told = self.config.clutter[0]
        if source in self.scanners:
            anywhere = max(told, self.scanners[source].density(told))
        self.density = [max(anywhere, here) for here in self.standing]

    def learn(self, places, ended, source):
        scanner = self.scanners.setdefault(source, Learnt(self.config))
        if len(places) or scanner.all:
            scanner.all = last_places(scanner.all, list(places))
            scanner.count([], [])
        for track in ended:
            if not track["confirmed"]:
                self.scanners[track["origin"]].clutter += track["hits"]

    def associate(self, tracks, stamp, places, source, numbers):
        config, noise = self.config, np.diag(np.square(self.config.target.lidar_std))
        free = [column for column, number in enumerate(numbers) if number < 0]
        options = []
        for track in tracks:
            spread, inside = track["cov"][:2, :2] + noise, {}
            for column in free:
                nis = self.distance(track, places[column], noise)
                if nis <= self.gate:
                    density = np.exp(-nis / 2) / np.sqrt(np.linalg.det(2 * np.pi * spread))
                    inside[column] = config.detection_probability * density / self.density[column]
            options.append({-1: 1 - config.detection_probability, **inside})
        weights = np.zeros((len(tracks), len(places)))
        total = 0.0
        for event in product(*options):
            used = [column for column in event if column >= 0]
            if len(used) > len(set(used)):
                continue
            weight = np.prod([some[column] for some, column in zip(options, event, strict=True)])
            total += weight
            for row, column in enumerate(event):
                if column >= 0:
                    weights[row, column] += weight
        weights /= total
        for column in free:
            if tracks and weights[:, column].sum() > 0.5:
                best = tracks[int(np.argmax(weights[:, column]))]
                numbers[column] = best["id"]
                self.nis[column] = self.distance(best, places[column], noise)
        for track, shares, inside in zip(tracks, weights, options, strict=True):
            if len(inside) > 1:
                self.absorb(track, shares, places, noise)
            if shares.sum() > 0.5:
                self.see(track, stamp, source)
                missed = 1 - config.detection_probability
                weigh(track, list(inside.values())[1:], missed, decides=config.report_speed > 0)

    def clutter(self, track):
        return 1 / (1 + np.exp(track.get("score", NEW)))

    def absorb(self, track, shares, places, noise):
        spread = track["cov"][:2, :2] + noise
        gain = track["cov"][:, :2] @ np.linalg.inv(spread)
        errors = np.array(places) - track["mean"][:2]
        mean = shares @ errors
        apart = (errors.T * shares) @ errors - np.outer(mean, mean)
        track["mean"] = track["mean"] + gain @ mean
        track["cov"] = track["cov"] + gain @ (apart - shares.sum() * spread) @ gain.T
