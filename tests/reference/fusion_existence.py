"""Oracle of the tracker with probabilities of existence: constant velocity, positions, every event.

It follows Musicki & Evans, "Joint integrated probabilistic data association: JIPDA", 2004, with
joint events that are counted one by one: for every set of tracks that exist, and of those every
assignment of measurements. A target that exists is observable or hidden: Markov chain two of
Musicki, Evans & Stankovic, "Integrated probabilistic data association", 1994.
"""

import numpy as np

from reference.fusion_clutter import measure_spread
from reference.fusion_company import keep_company
from reference.fusion_many import gaussian_step
from reference.fusion_scanner import Learnt, last_places

CERTAIN, DOUBTFUL, MOST = 0.9, 0.5, 1 - 1e-9
LIFETIME, DELETED = 30.0, 1e-3
FIRST_SCANS, SPEEDS = 5, 50
VISIBLE, HIDDEN = 100.0, 1.5
FOREIGN, CERTAINLY_OWN, LOST = 0.02, 1e-3, 2.0
PRIORS = {"end": 0.5, "hiding": 0.1}


def chain(lifetime, visible, dt):
    """Transitions within `dt` of what is always seen, came back, is hidden; columns sum to < 1.

    By many short steps, as a check of closed forms.
    """
    leave, hide, show = 1 / lifetime, 1 / visible, 1 / HIDDEN
    rates = np.array([[-hide, 0, 0], [0, -hide, show], [hide, hide, -show]]) - leave * np.eye(3)
    step = rates * dt / 2**16
    short = np.eye(3) + step + step @ step / 2
    return np.linalg.matrix_power(short, 2**16)


def joint_events(existence, detection, ratios, hidden=None):
    """Probability of existence of each track, and of each pair: it exists and was measured so.

    Also that it exists and is `hidden`. `ratios` (T, M) are densities of measurements over that of
    clutter, 0 outside the gate. Tracks without common measurements are independent.
    """
    hidden = np.zeros(len(ratios)) if hidden is None else hidden
    observable, pair = existence - hidden, np.zeros(ratios.shape)
    for rows in groups(ratios > 0):
        pair[rows] = events_of_group(observable[rows], detection, ratios[rows])
    unmeasured = (1 - pair.sum(axis=1)) / (1 - observable * detection)
    missed = observable * (1 - detection) + hidden
    return pair.sum(axis=1) + unmeasured * missed, pair, unmeasured * hidden


def least_tail(track):
    """Probability of a measurement or one further off, below which it is of another target."""
    least = FOREIGN * (track["hidden"] + track["returned"]) / track["p"]
    return least if least > CERTAINLY_OWN else 0.0


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


def events_of_group(observable, detection, ratios):
    """Pairs of one group: every track was measured as something, or was not measured."""
    unseen = 1 - observable * detection  # no target, hidden, or missed
    pair, events = np.zeros(ratios.shape), [((), 1.0)]
    for row in range(len(ratios)):
        seen = observable[row] * detection * ratios[row]
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
    return pair


class IntegratedTargets:
    """As `lidar_core.fusion.MultiTargetTracker` with `kf`, `cv` and LiDAR measurements."""

    def __init__(self, config, *, gate):
        self.config, self.gate = config, gate
        self.noise = np.diag(np.square(config.target.lidar_std))
        self.tracks, self.next_id, self.scanners = [], 0, {}
        self.stayed = self.ends = self.squared = self.speeds = 0.0
        self.visible = self.returns = 0.0

    def process(self, stamp, places, source):
        self.stamp, self.places, self.source = stamp, places, source
        scanner = self.scanners.setdefault(source, Learnt(self.config))
        scanner.all = last_places(scanner.all, places)
        detection, share = scanner.detection(), scanner.share()
        largest = LOST / scanner.density(self.config.clutter[0]) if scanner.all else np.inf
        is_settled = scanner.scans >= FIRST_SCANS
        least = [least_tail(track) for track in self.tracks]
        self.age()
        existence, hidden, returned = (
            np.array([track[name] for track in self.tracks]) for name in ("p", "hidden", "returned")
        )
        observable = existence - hidden
        nis, ratios = self.compared(scanner, least)
        after, pair, hidden_after = joint_events(existence, detection, ratios, hidden)
        measured = pair.sum(axis=1)
        for row, track in enumerate(self.tracks):
            miss = (1 - detection) / (1 - detection * observable[row])
            if source not in track["sources"]:  # this scanner may not see the place
                miss = 1.0
                after[row] = measured[row] + (1 - measured[row]) * existence[row]
                hidden_after[row] = (1 - measured[row]) * hidden[row]
            if track["was_certain"]:
                self.returns += measured[row] * returned[row] / observable[row]
            track["hidden"] = hidden_after[row]
            track["returned"] = (1 - measured[row]) * miss * returned[row]
        after = np.minimum(after, MOST)
        alone = detection * observable[:, None] * ratios
        likely = alone > (1 - detection * observable)[:, None]
        left = 1 - pair.sum(axis=0)
        self.learn(scanner, existence, after, pair, left)
        numbers, measured = self.update(nis, after, pair, left, likely)
        self.start(left * share, measured, numbers, is_settled)
        self.unite()
        self.judge(scanner, largest)
        keep_company(self.config, self.stamp, self.tracks)
        measure_spread(self.config, self.tracks, places, self.stamp)
        return numbers

    def age(self):
        lifetime = PRIORS["end"] * LIFETIME + self.stayed
        lifetime /= PRIORS["end"] + self.ends
        visible = PRIORS["hiding"] * VISIBLE + self.visible
        visible /= PRIORS["hiding"] + self.returns
        for track in self.tracks:
            dt = (self.stamp - track["stamp"]) * 1e-9
            density = self.config.target.acceleration_noise**2
            track["mean"], track["cov"] = gaussian_step(track["mean"], track["cov"], dt, density)
            if track["was_certain"]:
                self.stayed += track["p"] * dt
                self.visible += (track["p"] - track["hidden"]) * dt
            always = track["p"] - track["hidden"] - track["returned"]
            state = np.array([always, track["returned"], track["hidden"]])
            state = chain(lifetime, visible, dt) @ state
            track["p"], track["returned"], track["hidden"] = state.sum(), state[1], state[2]
            track["stamp"] = self.stamp

    def compared(self, scanner, least):
        nis = np.full((len(self.tracks), len(self.places)), np.inf)
        ratios, gates = np.zeros(nis.shape), []
        for row, track in enumerate(self.tracks):
            spread = track["cov"][:2, :2] + self.noise
            for column, place in enumerate(self.places):
                error = place - track["mean"][:2]
                nis[row, column] = error @ np.linalg.inv(spread) @ error
                is_own = np.exp(-nis[row, column] / 2) >= least[row]  # 2 degrees of freedom
                if nis[row, column] <= self.gate and is_own:
                    peak = 1 / np.sqrt(np.linalg.det(2 * np.pi * spread))
                    ratios[row, column] = peak * np.exp(-nis[row, column] / 2)
                    if track["hits"] < 2:
                        gates.append(np.pi * self.gate * np.sqrt(np.linalg.det(spread)))
        # No denser than all measurements in the smallest gate of a young track.
        most = len(self.places) / min(gates) if gates else np.inf
        if scanner.area() > 0:  # nor less dense than the others where the scanner sees
            most = max(most, (len(self.places) - 1) / scanner.area())
        ratios /= scanner.density(min(self.config.clutter[0], most))
        return np.where(ratios > 0, nis, np.inf), ratios

    def learn(self, scanner, before, after, pair, left):
        if not scanner.all:
            return
        scanner.count(left, self.places)
        own = [track["origin"] == self.source for track in self.tracks]
        scanner.first = after[own].sum() if own else 0.0
        for row, track in enumerate(self.tracks):
            if self.source in track["sources"] and before[row] > CERTAIN:
                scanner.looks += after[row] - track["hidden"]
                scanner.hits += pair[row].sum()

    def update(self, nis, after, pair, left, likely):
        """A young track is divided by its measurements; an older one is blended."""
        numbers, best = [-1] * len(self.places), np.zeros(len(self.places))
        divided, measured = [], []
        for row, track in enumerate(self.tracks):
            own = np.flatnonzero(np.isfinite(nis[row]))
            if track["hits"] < 2:
                parts = self.divide(track, own, pair[row], after[row])
            else:
                parts = []
                own_likely = np.where(likely[row], nis[row], np.inf)
                self.blend(track, own_likely, own, pair[row], after[row])
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
            part = {**track, "id": self.next_id, "p": pair[column], "hidden": 0.0, "returned": 0.0}
            self.next_id += 1
            self.correct(part, np.eye(len(self.places))[column])
            self.see(part)
            self.remember(part, column)
            parts.append(part)
        track["p"] = max(after - pair.sum(), 0.0)
        if parts:
            likeliest = max(parts, key=lambda part: part["p"])
            if likeliest["p"] > track["p"]:
                likeliest["id"], track["id"] = track["id"], likeliest["id"]
        return parts

    def blend(self, track, likely, own, pair, after):
        track["p"] = after
        if not len(own):
            return
        self.correct(track, pair / after)
        if pair.sum() / after > 0.5:
            self.see(track)
        is_hidden = track["hidden"] + track["returned"] >= track["p"] / 2
        if np.isfinite(likely).any() and not is_hidden:
            self.remember(track, np.argmin(likely))  # of one track: the least NIS

    def correct(self, track, shares):
        spread = track["cov"][:2, :2] + self.noise
        gain = track["cov"][:, :2] @ np.linalg.inv(spread)
        errors = np.array(self.places) - track["mean"][:2]
        mean = shares @ errors
        apart = (errors.T * shares) @ errors - np.outer(mean, mean)
        track["mean"] = track["mean"] + gain @ mean
        track["cov"] = track["cov"] + gain @ (apart - shares.sum() * spread) @ gain.T

    def see(self, track):
        track["sources"] = track["sources"] | {self.source}
        track["hits"] += 1

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
                "hidden": 0.0,
                "returned": 0.0,
                "start": place,
                "origin": self.source,
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
            total = track["p"] + other["p"]
            for name in ("p", "hidden", "returned"):
                likelier[name] = (track[name] + other[name]) * min(1, MOST / total)
            gone.append(less["id"])
            of_last[track["last"]] = likelier
        self.tracks = [track for track in self.tracks if track["id"] not in gone]

    def judge(self, scanner, largest):
        config = self.config
        widest = config.max_position_std**2
        self.tracks = [
            track
            for track in self.tracks
            if track["p"] >= DELETED
            and (
                track["hits"] <= 2
                or 2 * np.pi * np.sqrt(np.linalg.det(track["cov"][:2, :2])) <= largest
            )
            and (not track["was_certain"] or np.diag(track["cov"])[:2].max() <= widest)
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
