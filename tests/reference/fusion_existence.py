"""Oracle of the tracker with probabilities of existence: constant velocity, positions, every event.

It follows Musicki & Evans, "Joint integrated probabilistic data association: JIPDA", 2004, with
joint events that are counted one by one: for every set of tracks that exist, and of those every
assignment of measurements.
"""

import numpy as np

from reference.fusion_many import gaussian_step

CERTAIN, DOUBTFUL, MOST = 0.9, 0.5, 1 - 1e-9
SHARE, LIFETIME, DELETED = 0.05, 30.0, 1e-3
MEMORY, FIRST_SCANS, SPEEDS = 300, 5, 50
PRIORS = {"clutter": 1.0, "detection": 5.0, "share": 20.0, "end": 0.5}


def joint_events(existence, detection, ratios):
    """Probability of existence of each track, and of each pair: it exists and was measured so.

    `ratios` (T, M) are densities of measurements over that of clutter, 0 outside the gate. Tracks
    without common measurements are independent.
    """
    exists, pair = np.zeros(len(ratios)), np.zeros(ratios.shape)
    for rows in groups(ratios > 0):
        exists[rows], pair[rows] = events_of_group(existence[rows], detection, ratios[rows])
    return exists, pair


def groups(linked):
    """Rows that share columns, also through others."""
    open_rows, found = set(range(len(linked))), []
    while open_rows:
        group, columns = {open_rows.pop()}, set()
        while True:
            columns = {column for row in group for column in np.flatnonzero(linked[row])}
            more = {row for row in open_rows if any(linked[row][column] for column in columns)}
            if not more:
                break
            group |= more
            open_rows -= more
        found.append(sorted(group))
    return found


def events_of_group(existence, detection, ratios):
    """The same for one group: every track was measured as something, or was not measured."""
    unseen = 1 - existence * detection  # no target, or missed
    pair, events = np.zeros(ratios.shape), [((), 1.0)]
    for row in range(len(ratios)):
        seen = existence[row] * detection * ratios[row]
        options = [(-1, unseen[row]), *((column, seen[column]) for column in np.flatnonzero(seen))]
        events = [
            ((*event, column), weight * own)
            for event, weight in events
            for column, own in options
            if column < 0 or column not in event
        ]
    total = sum(weight for _, weight in events)
    for event, weight in events:
        for row, column in enumerate(event):
            if column >= 0:
                pair[row, column] += weight / total
    missed = existence * (1 - detection) / unseen
    return pair.sum(axis=1) + (1 - pair.sum(axis=1)) * missed, pair


class Learnt:
    """What a scanner does: exponentially fading counts beside the configured values."""

    def __init__(self, config):
        self.config = config
        self.low, self.high = np.full(2, np.inf), np.full(2, -np.inf)
        self.scans = self.clutter = self.looks = self.hits = self.arrivals = 0.0

    def density(self):
        area = np.prod(np.maximum(self.high - self.low, 0)) if self.low[0] < np.inf else 0.0
        exposure = PRIORS["clutter"] / self.config.clutter[0]
        return (PRIORS["clutter"] + self.clutter) / (exposure + self.scans * area)

    def detection(self):
        looks = PRIORS["detection"]
        told = looks * self.config.detection_probability
        return float(np.clip((told + self.hits) / (looks + self.looks), 0.05, 0.99))

    def share(self):
        told = PRIORS["share"] * SHARE
        return (told + self.arrivals) / (PRIORS["share"] + self.clutter + self.arrivals)


class IntegratedTargets:
    """As `lidar_core.fusion.MultiTargetTracker` with `kf`, `cv` and LiDAR measurements."""

    def __init__(self, config, *, gate):
        self.config, self.gate = config, gate
        self.noise = np.diag(np.square(config.target.lidar_std))
        self.tracks, self.next_id, self.scanners = [], 0, {}
        self.stayed = self.ends = self.squared = self.speeds = 0.0

    def process(self, stamp, places, source):
        self.stamp, self.places, self.source = stamp, places, source
        scanner = self.scanners.setdefault(source, Learnt(self.config))
        for place in places:
            scanner.low = np.minimum(scanner.low, place)
            scanner.high = np.maximum(scanner.high, place)
        density, detection, share = scanner.density(), scanner.detection(), scanner.share()
        is_settled = scanner.scans >= FIRST_SCANS
        self.age()
        existence = np.array([track["p"] for track in self.tracks])
        nis, ratios = self.compared(density)
        after, pair = joint_events(existence, detection, ratios)
        for row, track in enumerate(self.tracks):
            if source not in track["sources"]:  # this scanner may not see the place
                after[row] = pair[row].sum() + (1 - pair[row].sum()) * existence[row]
        after = np.minimum(after, MOST)
        left = 1 - pair.sum(axis=0)
        self.learn(scanner, existence, after, pair, left)
        numbers, measured = self.update(nis, after, pair, left)
        self.start(left * share, measured, numbers, is_settled)
        self.unite()
        self.judge(scanner)
        return numbers

    def age(self):
        lifetime = PRIORS["end"] * LIFETIME + self.stayed
        lifetime /= PRIORS["end"] + self.ends
        for track in self.tracks:
            dt = (self.stamp - track["stamp"]) * 1e-9
            density = self.config.target.acceleration_noise**2
            track["mean"], track["cov"] = gaussian_step(track["mean"], track["cov"], dt, density)
            if track["was_certain"]:
                self.stayed += track["p"] * dt
            track["p"] *= np.exp(-dt / lifetime)
            track["stamp"] = self.stamp

    def compared(self, density):
        nis = np.full((len(self.tracks), len(self.places)), np.inf)
        ratios = np.zeros(nis.shape)
        for row, track in enumerate(self.tracks):
            spread = track["cov"][:2, :2] + self.noise
            for column, place in enumerate(self.places):
                error = place - track["mean"][:2]
                nis[row, column] = error @ np.linalg.inv(spread) @ error
                if nis[row, column] <= self.gate:
                    peak = 1 / np.sqrt(np.linalg.det(2 * np.pi * spread))
                    ratios[row, column] = peak * np.exp(-nis[row, column] / 2) / density
        return np.where(ratios > 0, nis, np.inf), ratios

    def learn(self, scanner, before, after, pair, left):
        if scanner.low[0] == np.inf:
            return
        for name in ("scans", "clutter", "looks", "hits", "arrivals"):
            setattr(scanner, name, getattr(scanner, name) * (1 - 1 / MEMORY))
        scanner.scans += 1
        scanner.clutter += left.sum()
        for row, track in enumerate(self.tracks):
            if self.source in track["sources"] and before[row] > CERTAIN:
                scanner.looks += after[row]
                scanner.hits += pair[row].sum()

    def update(self, nis, after, pair, left):
        """A young track is divided by its measurements; an older one is blended."""
        numbers, best = [-1] * len(self.places), np.zeros(len(self.places))
        divided, measured = [], []
        for row, track in enumerate(self.tracks):
            own = np.flatnonzero(np.isfinite(nis[row]))
            if track["hits"] < 2:
                parts = self.divide(track, own, pair[row], after[row])
            else:
                parts = []
                self.blend(track, own, nis[row], pair[row], after[row])
            for option, column in enumerate(own):
                if left[column] < 0.5 and pair[row, column] > best[column]:
                    best[column] = pair[row, column]
                    numbers[column] = (parts[option] if parts else track)["id"]
            if pair[row].sum() > 0.5:
                likeliest = max(parts, key=lambda part: part["p"]) if parts else track
                measured.append(likeliest["mean"][:2])
            divided += parts
        self.tracks += divided
        return numbers, measured

    def divide(self, track, own, pair, after):
        parts = []
        for column in own:
            part = {**track, "id": self.next_id, "p": pair[column]}
            self.next_id += 1
            self.correct(part, np.eye(len(self.places))[column])
            self.see(part, column)
            parts.append(part)
        track["p"] = max(after - pair.sum(), 0.0)
        if parts:
            likeliest = max(parts, key=lambda part: part["p"])
            if likeliest["p"] > track["p"]:
                likeliest["id"], track["id"] = track["id"], likeliest["id"]
        return parts

    def blend(self, track, own, nis, pair, after):
        track["p"] = after
        if not len(own):
            return
        self.correct(track, pair / after)
        if pair.sum() / after > 0.5:
            self.see(track, own[np.argmin(nis[own])])  # of one track: the least NIS
        else:
            self.remember(track, own[np.argmin(nis[own])])

    def correct(self, track, shares):
        spread = track["cov"][:2, :2] + self.noise
        gain = track["cov"][:, :2] @ np.linalg.inv(spread)
        errors = np.array(self.places) - track["mean"][:2]
        mean = shares @ errors
        apart = (errors.T * shares) @ errors - np.outer(mean, mean)
        track["mean"] = track["mean"] + gain @ mean
        track["cov"] = track["cov"] + gain @ (apart - shares.sum() * spread) @ gain.T

    def see(self, track, column):
        track["sources"] = track["sources"] | {self.source}
        track["hits"] += 1
        self.remember(track, column)

    def remember(self, track, column):
        track["last"] = ((self.stamp, self.source, int(column)), track["last"][0])

    def start(self, probability, measured, numbers, is_settled):
        config = self.config
        for column, place in enumerate(self.places):
            near = any(np.hypot(*(at - place)) < config.birth_distance for at in measured)
            if near or probability[column] < DELETED:
                continue
            covariance = np.zeros((4, 4))
            covariance[:2, :2] = self.noise
            told = config.target.initial_speed**2
            speed = max((told + self.squared) / (1 + self.speeds), told / 9)
            covariance[2:, 2:] = np.eye(2) * speed
            track = {
                "id": self.next_id,
                "mean": np.array([*place, 0.0, 0.0]),
                "cov": covariance,
                "p": probability[column],
                "start": place,
                "born": self.stamp,
                "stamp": self.stamp,
                "sources": {self.source},
                "hits": 1,
                "last": ((self.stamp, self.source, column), None),
                "confirmed": False,
                "was_certain": False,
                "is_doubtful": False,
                "will_arrive": is_settled,
            }
            self.tracks.append(track)
            self.next_id += 1
            if numbers[column] < 0:
                numbers[column] = track["id"]

    def unite(self):
        """Histories that end with the same two measurements are of one target."""
        of_last, gone = {}, []
        for track in self.tracks:
            if track["last"][1] is None:
                continue
            other = of_last.setdefault(track["last"], track)
            if other is track or min(other["p"], track["p"]) > 0.5:
                continue
            likelier, less = (track, other) if track["p"] > other["p"] else (other, track)
            likelier["p"] = min(track["p"] + other["p"], MOST)
            gone.append(less["id"])
            of_last[track["last"]] = likelier
        self.tracks = [track for track in self.tracks if track["id"] not in gone]

    def judge(self, scanner):
        config = self.config
        widest = config.max_position_std**2
        self.tracks = [
            track
            for track in self.tracks
            if track["p"] >= DELETED
            and (track["hits"] < 2 or np.diag(track["cov"])[:2].max() <= widest)
        ]
        for track in self.tracks:
            kept = track["confirmed"] and track["p"] >= config.report_existence / 2
            track["confirmed"] = bool(kept or track["p"] >= config.report_existence)
            if track["p"] > CERTAIN and not track["was_certain"] and self.stamp > track["born"]:
                away = (track["mean"][:2] - track["start"]) / (self.stamp - track["born"]) * 1e9
                self.squared = self.squared * (1 - 1 / SPEEDS) + away @ away / 2
                self.speeds = self.speeds * (1 - 1 / SPEEDS) + 1
            track["was_certain"] |= bool(track["p"] > CERTAIN)
            doubts = track["p"] < (CERTAIN if track["is_doubtful"] else DOUBTFUL)
            if track["was_certain"] and doubts != track["is_doubtful"]:
                self.ends += 1 if doubts else -1
                track["is_doubtful"] = doubts
            if track["p"] > CERTAIN and track["will_arrive"]:
                track["will_arrive"] = False
                scanner.arrivals += 1
