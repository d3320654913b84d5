"""Multi-target tracker of Algorithm 2 in plain numpy: paper mode and best mode.

Written from the paper (Vrba et al., sec. III-F) and the text of `TrackerConfig`; slow and obvious.
Process noise comes from the matrix exponential (Van Loan), distances from full tables, assignment
from scipy.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cache

import numpy as np
from scipy.linalg import expm
from scipy.optimize import linear_sum_assignment
from scipy.sparse.csgraph import connected_components
from scipy.spatial.distance import cdist
from scipy.stats import chi2, norm

from reference.stood import LAST, EarlierReturns, Stood, has_speed

EYE = np.eye(3)
H = np.hstack([EYE, np.zeros((3, 6))])
# Of the rules that are no parameters, as the text of `Doubt`, `Hiding`, `Merging` in Rust has them.
UNSEEN_TIME, SIZE_TIME = 0.3, 2.0  # [s]
MOVED, CLEARED = 0.5, 0.3  # [m]
MERGE_SPEED = 1.0  # [m/s]
LARGE, PART_GAP = 0.75, 0.5  # [m]
LOITER_SHARE = 0.5  # of the way that a target may have flown, it is from where it was seen


def cost(pair):
    """-2 ln of the likelihood of a difference, without what all share."""
    y, S = pair
    return y @ np.linalg.solve(S, y) + np.log(np.linalg.det(S))


# Existence: likelihoods of what a set shows, of a target, one that gives no returns for a while,
# something that stands, and what comes and goes; and the other numbers of `existence.rs`.
LIKELIHOOD = {
    "unseen": (1, 1, 1, 1),
    "missed": (0.06, 0.42, 0.10, 0.60),
    "barely missed": (0.20, 0.42, 0.10, 0.60),
    "followed": (0.25, 0.03, 0.55, 0.16),
    "few": (0.04, 0.02, 0.005, 0.015),
    "weak": (0.33, 0.03, 0.15, 0.20),
    "sure": (0.33, 0.02, 0.02, 0.08),
}
HAS_MOVED = (0.9, 0.9, 0.03, 0.6)
NEAREST, NEAR_BOUNDS, NEAR_THIRD = 25.0, (0.4, 2.5), 10.0
IS_FAST = (0.3, 0.3, 1.0, 1.0)
SPEEDS, TIMES = (8.0, 60.0), (0.02, 0.25)  # [m/s], [s]
AMONG_STRAYS = 0.02
NEW_POINTS = 0.3  # weight of the newest scan
SURE, MANY_RAYS, FEW_RAYS = 0.7, 12, 3
DELETED, KEPT = 0.01, 0.5
LIFETIME, VISIBLE, HIDDEN = 30.0, 5.0, 0.3  # [s]
MEMORY, TARGETS, FEWEST = 300, 0.05, 0.02
# Kinds: unknown, flying, ground, static, clutter; likelihoods of what a detection shows, sorts of
# targets: their share, mean and standard deviation of ln(radius) and ln(filled share), and how many
# of them are bodies, whose hits lie side by side.
RECURS = np.array([0.2, 0.02, 1, 1, 1])  # where things came and went before
HANGS = np.array([0.3, 0.1, 0.3, 1, 1])  # beside structure, where it began
STOOD = np.array([6, 0.02, 1, 2, 1])  # where something stood before it began
UNCOVERED = np.array([6, 0.02, 1, 2, 1])  # at an edge that the sensor looks past
FIRST = 3  # so many first detections
OF_TRACK = 0.5  # m
VISIT_REACH, VISITS_HALF = 0.5, 2  # m; visits
VISIT_BEFORE, VISIT, VISITS_KEPT = 10**9, 2 * 10**9, 60 * 10**9  # ns
BESIDE, RAISED, AWAY = 2.0, 1.0, 1.0  # m
KIND_SHARES, LEAST_KIND = (0.03, 0.6, 0.05, 0.07, 0.25), 1e-6
BELOW = {True: (0.8, 1.0, 0.15, 0.4, 1.0), False: (0.7, 0.35, 1.5, 1.0, 0.35)}
NOT_FREE_AT_FIRST = (0.35, 0.08, 1.5, 1.0, 0.08)
OVER_UNSEEN = (0.2, 0.03, 1.5, 1.0, 0.03)
FITS, MOST_SURPRISE, GAIN, MOST_MANOEUVRE = 1.2, 5.0, 0.2, 5.0
HARD_TURN = 9.8  # standard deviation of the acceleration of a hard turn [m/s^2]
FLYING = 1
STEADY, AGILE, KNOWN_SHARE = 1.0, 4.0, 0.95  # [m/s^2], [m/s^2], no unit
AGILE_SHARES, APART, MOST_AGILITY = np.array([0.5, 0.5, 0.02, 0.5, 0.5]), 0.5, 8.0
MOST_SHAPES, SHAPE_NOISE, HALF_WEIGHT = 20, 0.4, 10
SORTS = {
    "flying": [(0.5, (-1.6, 0.35), (-0.65, 0.4), 1), (0.5, (-0.7, 0.6), (-0.65, 0.4), 1)],
    "clutter": [
        (0.35, (-3.0, 0.4), (-0.7, 0.7), 1),
        (0.25, (-1.2, 0.8), (-2.2, 0.6), 0),
        (0.1, (-1.0, 0.8), (-0.7, 0.5), 0),
        (0.3, (-1.6, 1.0), (-1.2, 1.0), 0.5),
    ],
}


def body_and_loose(excess, possible):
    """Densities of the largest coherence of four directions: of a body, of dust."""
    known = possible >= 4
    if not known.any():
        return 1.0, 1.0
    value, most = max(zip(excess[known] / possible[known], possible[known], strict=True))
    chance = 2 / most
    body = norm.pdf(value, 0.6, np.sqrt(0.2**2 + chance))
    return 0.95 * body + 0.05, norm.pdf(value, 0, np.sqrt(0.05**2 + chance))


def weighed(probability, likelihood):
    """Bayes' rule for kinds, of which none gets less probable than `LEAST_KIND`."""
    made = np.asarray(likelihood)
    after = probability * np.maximum(made / made.max(), LEAST_KIND)
    for _ in range(2):
        after = np.maximum(after / after.sum(), LEAST_KIND)
    return after


class Mean:
    """Mean of values, of the last ones more than of the first."""

    def __init__(self):
        self.count, self.weight, self.mean = 0, 0.0, 0.0

    def add(self, value, weight=1.0):
        is_full = self.count == MOST_SHAPES
        self.count += not is_full
        self.weight = self.weight * (1 - is_full / MOST_SHAPES) + weight
        self.mean += (value - self.mean) * weight / self.weight


class MeanLog(Mean):
    """Mean of logarithms; what many points tell has a larger weight."""

    def add(self, value, points):
        if value > 0:
            super().add(np.log(value), points / (points + HALF_WEIGHT))

    def density(self, mean, std):
        if not self.count:
            return 1.0
        return norm.pdf(self.mean, mean, np.hypot(std, SHAPE_NOISE / np.sqrt(self.count)))


USUAL, CLUTTER_BOUNDS = 0.1, (0.5, 1.8)


def surprised(manoeuvre, nis):
    """Factor of the process noise after a measurement at this squared Mahalanobis distance."""
    surprise = min(nis / 3, MOST_SURPRISE) - FITS
    return np.clip(manoeuvre * np.exp(GAIN * surprise), 1, MOST_MANOEUVRE)


def renamed(number, merged):
    for stays, gone in merged:
        number = stays if number == gone else number
    return number


def is_beside(place, occupied):
    """Whether structure is beside a place or above it."""
    away = np.reshape(occupied, (-1, 3)) - place - [0, 0, RAISED]
    return bool((np.linalg.norm(away, axis=1) <= BESIDE).any())


def is_part(one, other):
    """Whether `other` may be a part of `one`, which is large: box beside box."""
    gap = np.abs(other.r - one.r) - (one.size + other.size) / 2
    is_largest = one.size.max() >= max(LARGE, other.size.max())
    return is_largest and np.linalg.norm(np.maximum(gap, 0)) <= PART_GAP


class Births:
    """How often tracks begin without a target."""

    sets = without = 0.0

    def expected(self, tracks):
        """Probability that a new track has a target; clutter over the usual."""
        alive = sum(1 - track.existence() for track in tracks if not track.was_confirmed)
        without = (1 + self.without + alive) / (10 + self.sets)
        prior = TARGETS / (TARGETS + max(without, FEWEST))
        return prior, np.clip(np.sqrt(without / USUAL), *CLUTTER_BOUNDS)


def likelihood(sight, clutter):
    is_free = sight in ("few", "weak", "sure")
    return LIKELIHOOD[sight] * np.array([1, 1, 1, clutter if is_free else 1])


@dataclass
class Track:
    x: np.ndarray
    P: np.ndarray
    aged: np.ndarray
    stamp: int
    born: int
    seen: int
    extent: np.ndarray
    size: np.ndarray
    id: int = -1
    delay: float = 0.0
    n_detections: int = 1
    history: list[bool] = field(default_factory=lambda: [True])
    sight: str = "unseen"
    nis: float = None  # of its newest cluster
    turned: tuple = None  # state and covariance at the newest scan, if its target has turned hard
    n_turns: int = 0  # how often that explained its cluster
    manoeuvre: float = 1.0  # factor of the standard deviations of the process
    shown: str = "sure"  # by the detection that it began with
    before: str = None  # by the one before that, if it began with two
    made_of: list[int] = field(default_factory=list)  # numbers of the tracks of these two
    there: float = 0.25  # probability of a target that gives returns
    hidden: float = 0.0  # of one that gives none
    standing: float = 0.5  # that something stands there, if there is no target
    believed: int = 0
    has_moved: bool = False
    was_confirmed: bool = False
    place: np.ndarray = None
    seen_at: np.ndarray = None
    seen_speed: float = 0.0
    confirmed: bool = False
    left: bool = False  # nothing is where it began
    own: float = 0.0  # points of its clusters
    stray: float = 0.0  # points around it that belong to no track
    points: np.ndarray = None  # of its last cluster
    usual: float = 0.0  # number of points of its clusters, an average
    seen_kinds: np.ndarray = field(default_factory=lambda: np.array(KIND_SHARES))
    free_at_first: bool | None = None
    was_over_unseen: bool = False
    agility: float = 0.0
    radius: MeanLog = field(default_factory=MeanLog)
    least_radius: MeanLog = field(default_factory=MeanLog)
    recurs: Mean = field(default_factory=Mean)
    hangs: Mean = field(default_factory=Mean)
    stood: Mean = field(default_factory=Mean)
    uncovered: Mean = field(default_factory=Mean)
    began_uncovered: bool = False
    places: Stood = None
    filled: MeanLog = field(default_factory=MeanLog)
    coherence: np.ndarray = field(default_factory=lambda: np.zeros((2, 4)))
    # of its first detection: number of points, radius, radius by its points, filled share,
    # coherence, whether free below, whether over unseen space, whether at an edge that the sensor
    # looks past
    shape: tuple = None
    shape_before: tuple = None

    @property
    def r(self):
        return self.x[:3]

    @property
    def kinds(self):
        """Probabilities of the kinds, with what is known of the shape and of the place."""
        radius, hangs = MeanLog(), self.hangs.mean
        radius.count = self.radius.count
        least = self.least_radius if self.least_radius.count else self.radius
        radius.mean = (1 - hangs) * self.radius.mean + hangs * least.mean
        body, loose = body_and_loose(*self.coherence)
        flying, clutter = (
            sum(
                share
                * radius.density(*size)
                * self.filled.density(*filled)
                * (bodies * body + (1 - bodies) * loose)
                for share, size, filled, bodies in sorts
            )
            for sorts in (SORTS["flying"], SORTS["clutter"])
        )
        other = (flying + clutter) / 2
        after = weighed(self.seen_kinds, (other, flying, other, other, clutter))
        after = weighed(after, 1 - AGILE_SHARES + AGILE_SHARES * np.exp(self.agility))
        sways = hangs / (1 + np.exp(self.agility))
        stands = self.stood.mean * min(2 / (1 + np.exp(self.agility)), 1)
        after = weighed(weighed(after, RECURS**self.recurs.mean), HANGS**sways)
        uncovered = 1.0 if self.began_uncovered else self.uncovered.mean
        if self.has_moved:
            uncovered = max(2 * self.uncovered.mean - 1, 0)
        return weighed(weighed(after, UNCOVERED**uncovered), STOOD**stands)

    def feel(self, expected, seconds):
        """Enter its acceleration: likelihood of the measured part if it manoeuvres, over if not."""
        ratio = 0.0
        for value, variance in zip(self.x[6:], np.diag(self.P)[6:], strict=True):
            if 0 < variance < KNOWN_SHARE * expected**2:
                measured = 1 / (1 / variance - 1 / expected**2)
                place, spread = value * measured / variance, np.hypot
                agile = norm.logpdf(place, 0, spread(np.sqrt(measured), AGILE))
                ratio += agile - norm.logpdf(place, 0, spread(np.sqrt(measured), STEADY))
        self.agility += np.clip(seconds / APART, 0, 1) * ratio
        self.agility = np.clip(self.agility, -MOST_AGILITY, MOST_AGILITY)

    def measure(self, shape):
        """Enter the shape of a detection."""
        if shape is None:
            return
        points, radius, least, filled, coherence, is_free_below, is_over_unseen, is_uncovered = (
            shape
        )
        self.began_uncovered |= is_uncovered and self.uncovered.count < FIRST
        self.uncovered.add(float(is_uncovered))
        self.radius.add(radius, points)
        self.least_radius.add(least, points)
        self.filled.add(filled, points)
        self.coherence = 0.95 * self.coherence + coherence
        if is_over_unseen and is_free_below is False:
            if not self.was_over_unseen:
                told = NOT_FREE_AT_FIRST if self.free_at_first is False else np.ones(5)
                self.seen_kinds = weighed(self.seen_kinds, np.divide(OVER_UNSEEN, told))
            self.was_over_unseen = True
        elif is_free_below is not None:
            is_first = self.free_at_first is None and not is_free_below
            shares = NOT_FREE_AT_FIRST if is_first else BELOW[is_free_below]
            self.seen_kinds = weighed(self.seen_kinds, shares)
        if self.free_at_first is None:
            self.free_at_first = is_free_below

    @property
    def kind(self):
        """Number of the kind that outweighs all others; 0, unknown, if there is none."""
        return int(np.argmax(self.kinds)) if self.kinds.max() > 0.5 else 0

    def existence(self, stamp=None):
        """Probability that there is a target, at another time if that is given."""
        there, hidden = self.later(self.believed if stamp is None else stamp)
        odds = AMONG_STRAYS if self.stray > self.own else 1.0
        known = odds * (there + hidden)
        return known / (known + 1 - there - hidden)

    def later(self, stamp):
        dt = max(0.0, (stamp - self.believed) * 1e-9)
        rates = np.array([[-1 / VISIBLE, 1 / HIDDEN], [1 / VISIBLE, -1 / HIDDEN]])
        return expm((rates - EYE[:2, :2] / LIFETIME) * dt) @ (self.there, self.hidden)

    def take(self, likelihood):
        target, hidden, standing, fleeting = likelihood
        mixed = (self.there * target + self.hidden * hidden) / (self.there + self.hidden)
        made = (mixed, mixed, mixed, standing, mixed)
        self.seen_kinds = weighed(self.seen_kinds, made)
        weights = [
            self.there,
            self.hidden,
            (1 - self.there - self.hidden) * self.standing,
            (1 - self.there - self.hidden) * (1 - self.standing),
        ]
        weights = np.multiply(weights, likelihood)
        self.there, self.hidden, standing, fleeting = weights / weights.sum()
        self.standing = standing / (standing + fleeting)


@dataclass
class Events:
    late: bool = False
    corrected: list = field(default_factory=list)
    born: list = field(default_factory=list)
    confirmed: list = field(default_factory=list)
    removed: list = field(default_factory=list)
    merged: list = field(default_factory=list)


class Tracker:
    view = None  # whether a scan could see a place
    center = None  # centre of a target, its covariance, whether it is cut; from its points
    boxes = None  # what tracks have claimed near structure

    def __init__(self, config):
        self.c = config
        self.buffer = []  # (stamp, points)
        self.tracks = []
        self.next_id = 0
        self.births = Births()
        self.visits = []  # time, number of the track, place
        self.earlier = EarlierReturns()
        self.gate = chi2.ppf(config.gate_probability, 3)
        self.alone = -2 * np.log(config.clutter_density) - 3 * np.log(2 * np.pi)

    # --- motion -------------------------------------------------------------------------------

    @cache  # noqa: B019
    def model(self, dt, unseen=False, factor=1.0):
        """Transition and process noise over `dt` >= 0 [s]."""
        tau = self.c.acceleration_time
        if unseen and tau is not None:
            tau = UNSEEN_TIME
        F = np.kron([[0, 1, 0], [0, 0, 1], [0, 0, 0 if tau is None else -1 / tau]], EYE)
        std = factor * np.repeat(self.c.process_std, 3)
        L = np.diag(std**2)
        if self.c.process_noise == "paper":
            return expm(F * dt), L if dt > 0 else np.zeros((9, 9))
        steps = max(1, int(np.ceil(dt * 20)))  # short ones: Van Loan's matrix holds exp(-F' t)
        A, Q = np.eye(9), np.zeros((9, 9))
        h = dt / steps
        van_loan = expm(np.block([[-F, L], [np.zeros((9, 9)), F.T]]) * h)
        Ah = van_loan[9:, 9:].T
        Qh = Ah @ van_loan[:9, 9:]
        for _ in range(steps):
            A, Q = Ah @ A, Ah @ Q @ Ah.T + Qh
        return A, Q

    def predicted(self, x, P, dt, unseen=False, factor=1.0):
        if dt >= 0:
            A, Q = self.model(dt, unseen, factor)
            return A @ x, A @ P @ A.T + Q
        _, Q = self.model(-dt, unseen, factor)
        A = np.eye(9)
        A[:6, 3:] += dt * np.eye(6)
        A[:3, 6:] = dt**2 / 2 * EYE
        return A @ x, A @ (P + Q) @ A.T

    def at(self, track, stamp):
        seconds = (stamp - track.stamp) * 1e-9
        factor = track.manoeuvre if self.c.process_noise == "adaptive" else 1.0
        return self.predicted(track.x, track.P, seconds, track.seen < track.stamp, factor)

    def turned(self, track, stamp):
        """State and covariance if its target has turned hard: its acceleration is anything now."""
        agile = track.kind == FLYING and (track.has_moved or has_speed(track))
        if self.c.process_noise != "adaptive" or not agile:
            return None
        other = replace(track, x=track.x.copy(), P=track.P.copy())
        other.x[6:] = 0
        other.P[6:], other.P[:, 6:] = 0, 0
        other.P[6:, 6:] = HARD_TURN**2 * EYE
        return self.at(other, stamp)

    def move(self, track, stamp):
        track.x, track.P = self.at(track, stamp)
        track.stamp = stamp

    def radius(self, P):
        determinant = np.linalg.det(H @ P @ H.T)
        root = np.cbrt(determinant) if self.c.radius == "paper" else determinant ** (1 / 6)
        return max(self.c.radius_limits[0], self.c.radius_scale * root)

    def reach(self, track):
        r = self.radius(track.P)
        return r if self.c.ageing == "paper" else min(r, self.c.radius_limits[1])

    @staticmethod
    def place_after(delay):
        """Matrix of the place `delay` seconds after the state."""
        return np.hstack([EYE, delay * EYE, delay**2 / 2 * EYE])

    def correct(self, track, z, R, extent, delay=0.0, turned=None):
        H = self.place_after(delay)
        if turned is not None:
            track.x, track.P = turned
            track.n_turns += 1
        S = H @ track.P @ H.T + R
        K = track.P @ H.T @ np.linalg.inv(S)
        y = z - H @ track.x
        track.nis = y @ np.linalg.solve(S, y)
        if track.has_moved and track.kind == FLYING:
            nis = track.nis if turned is None else np.inf
            track.manoeuvre = surprised(track.manoeuvre, nis)
        track.x = track.x + K @ (z - H @ track.x)
        track.P = (np.eye(9) - K @ H) @ track.P
        track.P = (track.P + track.P.T) / 2
        track.aged = track.P
        track.extent = np.asarray(extent, float)
        track.seen = track.stamp
        track.seen_at, track.seen_speed = track.r, np.linalg.norm(track.x[3:6])

    # --- clusters -----------------------------------------------------------------------------

    def clusters(self, points, occupied, delays=None, tracks=()):
        """Place, covariance, extent, mean delay, whether cut, of the acceptable clusters."""
        if len(points) == 0:
            return []
        _, label = connected_components(cdist(points, points) <= self.c.cluster_distance)
        after = np.zeros(len(points)) if delays is None else delays
        whole = [np.flatnonzero(label == name) for name in dict.fromkeys(label)]
        found = []
        divided = [self.parts(cluster, points, after, tracks) for cluster in whole]
        divided = [part for parts in divided for part in parts]
        for rows in self.united(divided, points, after, tracks):
            own = points[rows]
            centroid, extent = own.mean(axis=0), np.ptp(own, axis=0)
            too_large = self.c.max_extent is not None and extent.max() > self.c.max_extent
            near = len(occupied) and np.linalg.norm(occupied - centroid, axis=1).min()
            if too_large:
                continue
            is_claimed = self.boxes is not None and self.boxes.holds(centroid)
            if len(occupied) and near <= self.c.occupied_distance and not is_claimed:
                continue
            R = self.c.measurement_std**2 * EYE
            if self.c.measurement != "paper":
                R = R + (own - centroid).T @ (own - centroid) / len(own) ** 2
            is_cut = True
            if self.c.measurement == "center" and self.center is not None:
                centroid, R, is_cut = self.center(own)
            timed = delays is not None and self.c.measurement != "paper"
            delay = delays[rows].mean() if timed else 0.0
            found.append((centroid, R, extent, delay, is_cut, own))
        return found

    def parts(self, rows, points, delays, tracks):
        """The rows of a cluster, divided among the confirmed tracks that are near and apart."""
        limit = self.c.split_distance
        if limit is None:
            return [rows]

        def from_track(track):
            moved = track.r + delays[rows, None] * track.x[3:6]
            return np.linalg.norm(points[rows] - moved, axis=1)

        owners = []
        for track in tracks:
            if not track.confirmed or from_track(track).min() > limit:
                continue
            K = self.place_after(delays[rows].mean())
            y = [K @ (track.x - other.x) for other in owners]
            S = [K @ (track.P + other.P) @ K.T for other in owners]
            if all(
                np.linalg.norm(a) > limit and a @ np.linalg.solve(b, a) > self.gate
                for a, b in zip(y, S, strict=True)
            ):
                owners.append(track)
        if len(owners) < 2:
            return [rows]
        nearest = np.argmin([from_track(track) for track in owners], axis=0)
        return [rows[nearest == owner] for owner in np.unique(nearest)]

    def united(self, parts, points, delays, tracks):
        """Rows of clusters; those in the box of a large track, and nearest to it, as one."""
        confirmed = [track for track in tracks if track.confirmed]
        for track in [one for one in confirmed if one.size.max() >= LARGE]:
            offset = points - track.r - delays[:, None] * track.x[3:6]

            def is_own(rows, track=track, offset=offset):
                mean = offset[rows].mean(axis=0)
                apart = [np.linalg.norm(mean + track.r - other.r) for other in confirmed]
                in_box = (np.abs(offset[rows]) <= track.size / 2 + PART_GAP).all()
                return in_box and np.linalg.norm(mean) <= min(apart)

            own = [rows for rows in parts if is_own(rows)]
            rest = [rows for rows in parts if not is_own(rows)]
            if self.c.max_extent is None or not own:
                continue
            whole = np.sort(np.concatenate(own))
            sides = [np.ptp(places[whole], axis=0) for places in (offset, points)]
            if (np.stack(sides) <= self.c.max_extent).all():
                parts = [*rest, whole]
        return parts

    def widened(self, R, extent, is_cut, track):
        """Covariance of a cluster of which a part may be hidden."""
        if not is_cut or self.c.hidden_share is None or self.c.association == "paper":
            return R
        is_short = extent < self.c.hidden_share * track.size
        return R + np.diag(np.where(is_short, track.size - extent, 0) ** 2)

    def assign(self, rows, columns, offset):
        """Cheapest one-to-one assignment; column of every row or None."""
        forbidden = 1e9
        costs = np.full((rows, columns + rows), forbidden)
        for row in range(rows):
            costs[row, columns + row] = self.alone
            for column in range(columns):
                pair = offset(row, column)
                if pair is None:
                    continue
                y, S, *least = pair
                squared = y @ np.linalg.solve(S, y)
                if squared <= self.gate:
                    costs[row, column] = max(squared + np.log(np.linalg.det(S)), *least, -forbidden)
        row_of, column_of = linear_sum_assignment(costs)
        chosen = dict(zip(row_of.tolist(), column_of.tolist(), strict=True))
        return [chosen[row] if chosen[row] < columns else None for row in range(rows)]

    # --- Algorithm 2 --------------------------------------------------------------------------

    def update(self, tracks, stamp, points, occupied, delays=None):
        due = [track for track in tracks if track.stamp < stamp]
        elapsed = [(stamp - track.stamp) * 1e-9 for track in due]
        for track in due:
            track.turned = self.turned(track, stamp)
            self.move(track, stamp)
        if self.c.association == "paper":
            found = [self.nearest(track, points, occupied, delays) for track in due]
        else:
            found = self.one_to_one(due, points, occupied, delays)
        for track in due:
            far = np.linalg.norm(track.r - track.place) > MOVED
            gaps = np.linalg.norm(points - track.place, axis=1)
            nothing = (gaps > CLEARED).all()
            is_seen = self.view is None or self.view(track.place, CLEARED) >= FEW_RAYS
            track.left = not track.has_moved and far and nothing and is_seen
        for track, cluster, dt in zip(due, found, elapsed, strict=True):
            track.sight, track.nis = "followed", None
            if cluster is None:
                rays = MANY_RAYS if self.view is None else self.view(track.r, self.reach(track))
                if track.was_confirmed and track.usual and rays >= FEW_RAYS:
                    rays = min(rays, max(FEW_RAYS, int(track.usual + 0.5)))
                names = ["unseen", "barely missed", "missed"]
                track.sight = names[int(rays >= FEW_RAYS) + int(rays >= MANY_RAYS)]
                A, Q = self.model(dt)
                track.aged = A @ track.aged @ A.T + Q
            else:
                z, R, extent, delay, is_cut, track.points = cluster
                newest = len(track.points)
                track.usual += (NEW_POINTS if track.usual else 1.0) * (newest - track.usual)
                wide = self.widened(R, extent, is_cut, track)
                is_turned = self.c.association != "paper" and self.has_turned(
                    track, z, R, wide, delay
                )
                self.correct(track, z, wide, extent, delay, track.turned if is_turned else None)
                if self.c.hidden_share is not None:
                    track.size = extent + np.exp(-dt / SIZE_TIME) * (track.size - extent)
        return [track.id for track, cluster in zip(due, found, strict=True) if cluster is not None]

    def has_turned(self, track, z, R, wide, delay):
        """Whether a cluster that is no part is out of the gate of what may have turned hard."""
        if track.turned is None or (wide != R).any():
            return False
        K = self.place_after(delay)
        y, S = z - K @ track.x, K @ track.P @ K.T + wide
        return y @ np.linalg.solve(S, y) > self.gate

    def inside(self, points, track, margin=0.0):
        return np.linalg.norm(points - track.r, axis=1) <= self.reach(track) + margin

    def nearest(self, track, points, occupied, delays=None):
        own = self.inside(points, track)
        found = self.clusters(points[own], occupied, None if delays is None else delays[own])
        return min(found, key=lambda cluster: np.linalg.norm(cluster[0] - track.r), default=None)

    def one_to_one(self, tracks, points, occupied, delays=None):
        margin = self.c.max_extent or 0.0
        chosen = np.zeros(len(points), bool)
        for track in tracks:
            chosen |= self.inside(points, track, margin)
        found = self.clusters(
            points[chosen], occupied, None if delays is None else delays[chosen], tracks
        )

        def offset(row, column):
            z, R, extent, delay, is_cut, _ = found[column]
            track, K = tracks[row], self.place_after(delay)
            wide = self.widened(R, extent, is_cut, track)
            y, S = z - K @ track.x, K @ track.P @ K.T + wide
            if np.linalg.norm(y) > self.reach(track):
                return None
            if not self.has_turned(track, z, R, wide, delay):
                return y, S
            x, P = track.turned
            least = self.gate + np.log(np.linalg.det(S))  # as on the edge of the gate
            y, S = z - K @ x, K @ P @ K.T + wide
            return (y, S, least) if np.linalg.norm(y) <= self.reach(track) else None

        columns = self.assign(len(tracks), len(found), offset)
        stray = [row for row in range(len(found)) if row not in columns]
        for track, column in zip(tracks, columns, strict=True):
            place = track.r if column is None else found[column][0]
            near = [row for row in stray if np.linalg.norm(found[row][0] - place) <= 2.0]
            own = 0 if column is None else len(found[column][5])
            if not track.confirmed and track.id != -1:
                track.own = 0.8 * track.own + own
                few = [n for n in (len(found[row][5]) for row in near) if n <= 3]
                track.stray = 0.8 * track.stray + sum(few)
        return [None if column is None else found[column] for column in columns]

    def new_point_cloud(self, points, occupied, stamp, delays=None):
        finite = np.isfinite(points).all(axis=1)
        points = points[finite].astype(float)
        delays = None if delays is None else delays[finite]
        events = Events(late=bool(self.buffer) and stamp < self.buffer[-1][0])
        if not events.late:
            events.corrected = self.update(self.tracks, stamp, points, occupied, delays)
            events.removed = self.remove(lambda track: self.is_lost(track, stamp))
            events.merged = self.merge()
            self.visits = [(at, renamed(n, events.merged), place) for at, n, place in self.visits]
        self.buffer.append((stamp, points, delays))
        self.buffer.sort(key=lambda cloud: cloud[0])
        self.buffer = self.buffer[-self.c.buffer_size :]
        return events

    def is_lost(self, track, stamp):
        coasting = (stamp - track.seen) * 1e-9
        too_long = self.c.ageing == "visible" and coasting > self.c.max_coast
        return self.radius(track.aged) > self.c.radius_limits[1] or too_long

    def remove(self, gone):
        ends = [track for track in self.tracks if gone(track)]
        self.births.without += sum(1 - one.existence() for one in ends if not one.was_confirmed)
        removed = [track.id for track in ends]
        self.tracks = [track for track in self.tracks if not gone(track)]
        return removed

    def new_detections(
        self,
        positions,
        occupied,
        stamp,
        covariance=None,
        delay=None,
        confidence=None,
        shape=None,
        extent=None,
    ):
        fresh = []
        for index, z in enumerate(positions):
            P = np.zeros((9, 9))
            P[:3, :3] = self.c.initial_std[0] ** 2 * EYE
            if covariance is not None:
                P[:3, :3] = covariance[index]
                if self.c.measurement == "cluster":
                    P[:3, :3] += self.c.measurement_std**2 * EYE
            P[3:6, 3:6] = self.c.initial_std[1] ** 2 * EYE
            P[6:, 6:] = self.c.initial_std[2] ** 2 * EYE
            late = 0.0 if delay is None or self.c.measurement == "paper" else delay[index]
            J = np.eye(9)
            J[:3, 3:6] = -late * EYE  # r = z - v * delay
            P = J @ P @ J.T
            x = np.r_[z, np.zeros(6)]
            is_sure = confidence is not None and confidence[index] >= SURE
            shown = "sure" if is_sure else "weak"
            size = np.zeros(3) if extent is None else np.asarray(extent[index], float)
            new = Track(x, P, P, stamp, stamp, stamp, size, size, delay=late, shown=shown, place=z)
            new.seen_at, new.shape = z, None if shape is None else shape[index]
            fresh.append(new)
        for time, points, delays in self.buffer:
            if time > stamp:
                self.update(fresh, time, points, occupied, delays)
        fresh = [track for track in fresh if self.radius(track.P) <= self.c.radius_limits[1]]
        known = len(self.tracks)
        fed = self.join_nearest(fresh) if self.c.association == "paper" else self.join(fresh)
        return self.finish(fed, known, stamp, occupied)

    def join_nearest(self, fresh):
        fed = []
        for new in fresh:
            distance = {
                index: np.linalg.norm(track.r - new.r)
                for index, track in enumerate(self.tracks)
                if np.linalg.norm(track.r - new.r) <= self.radius(track.P) + self.radius(new.P)
            }
            if distance:
                index = min(distance, key=distance.get)
                self.tracks[index].n_detections += 1
                fed.append((index, (new.shown, new.shape)))
            else:
                self.tracks.append(new)
        return fed

    def join(self, fresh):
        def offset(row, column):
            new, track = fresh[row], self.tracks[column]
            stamp = max(new.stamp, track.stamp)
            ways = self.ways(self.waiting(track, stamp), *self.measured(new, stamp))
            return min(filter(None, ways), key=cost, default=None)

        fed, known = [], list(self.tracks)
        track_of = self.assign(len(fresh), len(self.tracks), offset)
        for new, index in zip(fresh, track_of, strict=True):
            if index is None:
                if not self.is_seen_twice(new, known):
                    self.tracks.append(new)
                    self.tracks.extend(self.fast_pair(new, known))
                continue
            track = self.tracks[index]
            track.n_detections += 1
            fed.append((index, (new.shown, new.shape)))
            if track.seen < new.born:
                stamp = max(new.stamp, track.stamp)
                waiting = self.waiting(track, stamp)
                z, R, late = self.measured(new, stamp)
                self.move(new, stamp)
                ahead, turned = self.ways(waiting, new.r, new.P[:3, :3])
                track.x, track.P, track.stamp = waiting[0].x, waiting[0].P, stamp
                if turned is not None and (ahead is None or cost(turned) < cost(ahead)):
                    track.x, track.P, track.aged = new.x, new.P, new.aged
                    track.extent, track.seen, track.seen_at = new.extent, new.seen, new.seen_at
                else:
                    self.correct(track, z, R, new.extent, late)
        return fed

    def fast_pair(self, new, known):
        """A new track and the nearest earlier detection from which only a fast target comes."""
        if self.c.report_existence is None or new.stamp != new.born:
            return []
        pairs = []
        for number, track in enumerate(known):
            dt = (new.born - track.born) * 1e-9 + new.delay - track.delay
            if track.n_detections != 1 or track.sight in ("followed", "few") or dt <= 0:
                continue
            speed = np.linalg.norm(new.place - track.place) / dt
            if TIMES[0] <= dt <= TIMES[1] and SPEEDS[0] <= speed <= SPEEDS[1]:
                pairs.append((np.linalg.norm(new.place - track.place), number, dt))
        if not pairs:
            return []
        _, number, dt = min(pairs)
        other = known[number]
        R = new.P[:3, :3] - new.delay**2 * new.P[3, 3] * EYE
        # [r, v] from the two places, the second at `delay` after the stamp
        J = np.array([[new.delay / dt, 1 - new.delay / dt], [-1 / dt, 1 / dt]])
        P = np.zeros((9, 9))
        P[:6, :6] = np.kron(J @ J.T, np.ones((3, 3))) * np.tile(R, (2, 2))
        P[3:6, 3:6] += (self.c.initial_std[2] * dt) ** 2 * EYE
        P[6:, 6:] = self.c.initial_std[2] ** 2 * EYE
        velocity = (new.place - other.place) / dt
        r = new.place - velocity * new.delay
        changes = {"born": other.born, "place": other.place, "seen_at": r, "n_detections": 2}
        changes |= {
            "seen_speed": np.linalg.norm(velocity),
            "before": other.shown,
            "shape_before": other.shape,
            "made_of": [other.id],
        }
        changes |= {"radius": MeanLog(), "least_radius": MeanLog(), "filled": MeanLog()}
        changes |= {"recurs": Mean(), "hangs": Mean(), "stood": Mean(), "uncovered": Mean()}
        changes |= {"began_uncovered": False, "coherence": np.zeros((2, 4))}
        x = np.r_[r, velocity, np.zeros(3)]
        return [replace(new, x=x, P=P, aged=P, history=[True], **changes)]

    def measured(self, new, stamp):
        """Place and covariance of a hypothesis, and the time after `stamp` when it is there [s]."""
        if new.stamp == new.born == stamp:
            return new.place, new.P[:3, :3] - new.delay**2 * new.P[3, 3] * EYE, new.delay
        x, P = self.at(new, stamp)
        return x[:3], P[:3, :3], 0.0

    def ways(self, waiting, z, R, late=0.0):
        """Offsets of a detection from where its target would be: ahead, or where it turned."""
        track, reach, strayed = waiting
        H = np.hstack([EYE, late * EYE, late**2 / 2 * EYE])
        ahead = z - H @ track.x, R + H @ track.P @ H.T
        turned = z - track.seen_at, R + (strayed or 0.0) ** 2 * EYE
        return [
            ahead if np.linalg.norm(ahead[0]) <= reach else None,
            turned if strayed is not None and np.linalg.norm(turned[0]) <= reach else None,
        ]

    def waiting(self, track, stamp):
        """A track as it waits for detections, how far it looks for them, how far it strayed."""
        x, P = self.at(track, stamp)
        waiting = replace(track, x=x, P=P, stamp=stamp)
        acceleration = self.c.rejoin_acceleration
        is_lost = bool(self.buffer) and track.seen < self.buffer[-1][0]
        if acceleration is None or not track.was_confirmed or not is_lost:
            return waiting, self.reach(track), None
        dt = (stamp - track.seen) * 1e-9
        strayed = np.kron([dt**2 / 2, dt, 1.0], EYE) * acceleration
        waiting.P = P + strayed.T @ strayed
        waiting.P[:3, :3] += self.c.initial_std[0] ** 2 * EYE
        strayed = self.c.initial_std[0] + LOITER_SHARE * track.seen_speed * dt
        return waiting, self.c.radius_limits[1], strayed

    def is_seen_twice(self, new, known):
        late = new.delay if new.stamp == new.born else 0.0
        states = [self.at(track, new.stamp)[0] for track in known]
        expected = [x[:3] + late * x[3:6] + late**2 / 2 * x[6:] for x in states]
        gaps = [np.linalg.norm(place - new.r) for place in expected]
        is_near = min(gaps, default=np.inf) <= self.c.cluster_distance
        large = [track for track in known if track.confirmed and track.stamp == new.stamp]
        is_seen = self.c.merge_distance is not None and any(is_part(one, new) for one in large)
        return is_near or is_seen

    def finish(self, fed, known, stamp, occupied):
        events = Events()
        for track in self.tracks[known:]:
            track.id = self.next_id
            self.next_id += 1
            if track.before is not None:
                track.made_of = [*track.made_of, events.born[-1]]
            events.born.append(track.id)
        shown = dict(fed)
        self.births.sets = (1 - 1 / MEMORY) * self.births.sets + 1
        self.births.without *= 1 - 1 / MEMORY
        around = self.births.expected(self.tracks[:known])
        for index, track in enumerate(self.tracks):
            if index < known:
                track.history.append(index in shown)
            showed, shape = shown.get(index, (None, None))
            self.believe(track, index >= known, showed, shape, stamp, *around)
            if track.places is None:
                is_new = index >= known
                at = (track.place, track.born) if is_new else (track.r, stamp)
                track.places = self.earlier.around(*at)
            if showed or index >= known:
                std = np.sqrt(np.trace(track.P[:3, :3]) / 3)
                stays = np.linalg.norm(track.r - track.place) <= AWAY + 2 * std
                track.recurs.add(self.visited(track))
                is_at = track.places is not None and track.places.is_beside
                is_at = is_at or is_beside(track.r, occupied)
                track.hangs.add(float(stays and is_at))
                stands = track.places is not None and not (
                    has_speed(track) or (track.has_moved and not track.places.is_beside)
                )
                track.stood.count = track.stood.weight = min(track.stood.count, LAST - 1)
                track.stood.add(track.places.at(track.r) if stands else 0.0)
            report = self.c.report_existence
            if report is None:
                hits = sum(track.history[-self.c.confirm_window :])
                is_confirmed = track.confirmed or hits >= self.c.confirm_hits
            else:
                is_confirmed = track.existence() >= report * (KEPT if track.confirmed else 1)
            if is_confirmed and not track.confirmed:
                events.confirmed.append(track.id)
            track.confirmed = is_confirmed
            track.was_confirmed |= is_confirmed
        numbers = [self.tracks[index].id for index, _ in fed]
        explained = self.explain(events)
        events.removed = self.remove(self.is_gone)
        events.merged = explained + self.merge()
        self.visits = [(at, renamed(n, events.merged), place) for at, n, place in self.visits]
        for number in sorted({renamed(n, events.merged) for n in (*numbers, *events.born)}):
            self.remember(number, stamp)
        return events

    def look(self, stamp, places):
        """Remember returns of unknown class that are not on a flying track."""
        for track in [one for one in self.tracks if one.confirmed and one.kind == 1]:
            reach = np.linalg.norm(track.extent) / 2 + OF_TRACK
            places = [at for at in places if np.linalg.norm(at - track.r) > reach]
        self.earlier.add(stamp, places)

    def visited(self, track):
        """How often something else was at the place of a track, long before it began."""
        visits = {
            time
            for time, number, place in self.visits
            if number != track.id
            and time <= track.born - VISIT_BEFORE
            and np.linalg.norm(place - track.r) <= VISIT_REACH
        }
        count = sum(np.diff(sorted(visits)) >= VISIT) + bool(visits)
        return count / (count + VISITS_HALF)

    def remember(self, number, stamp):
        """Remember a detection that fed a track, unless its target flies or is on the ground."""
        for track in [track for track in self.tracks if track.id == number]:
            if track.kind == 1 and track.confirmed:
                self.visits = [visit for visit in self.visits if visit[1] != number]
            elif track.kind != 2:
                self.visits.append((stamp, number, track.r.copy()))
                self.visits = [v for v in self.visits if v[0] >= stamp - VISITS_KEPT]

    def explain(self, events):
        """A confirmed track of a fast target ends those of the single detections it was made of."""
        merged = []
        for fast in [track for track in self.tracks if track.confirmed and track.made_of]:
            parts = [t for t in self.tracks if t.id in fast.made_of and t.n_detections == 1]
            own, fast.made_of = fast.id, []
            reported = [part.id for part in parts if part.was_confirmed]
            if reported and own in events.born:
                fast.id = min(reported)
            numbers = {part.id for part in parts}
            self.tracks = [one for one in self.tracks if one is fast or one.id not in numbers]
            gone = numbers | ({own} if fast.id != own else set())
            events.confirmed = [number for number in events.confirmed if number not in gone]
            merged += [[fast.id, number] for number in sorted(gone - {fast.id})]
        self.tracks.sort(key=lambda track: track.id)
        return merged

    def is_gone(self, track):
        if self.c.report_existence is None:
            return not track.confirmed and not any(track.history[-self.c.confirm_window :])
        return track.existence() < DELETED

    def believe(self, track, is_new, shown, shape, stamp, prior, clutter):
        if is_new:
            track.there, track.hidden, track.believed = prior, 0.0, stamp
            first = ((track.before, track.shape_before), (track.shown, track.shape))
            for sight, of_first in first:
                if sight is not None:
                    track.take(likelihood(sight, clutter))
                    track.measure(of_first)
            if track.before is not None:
                track.take(IS_FAST)
            return
        track.there, track.hidden = track.later(stamp)
        is_clear = shown in ("weak", "sure")
        is_found_again = is_clear and track.was_confirmed and not track.confirmed
        if is_found_again and track.there + track.hidden < prior:
            track.there, track.hidden = prior, 0.0
        since = (stamp - track.believed) * 1e-9
        track.believed = max(stamp, track.believed)
        sight, nis = shown or track.sight, track.nis
        track.sight, track.nis = "unseen", None
        is_free = sight in ("few", "weak", "sure")
        std = np.sqrt(np.trace(track.P[:3, :3]) / 3)
        is_far = np.linalg.norm(track.r - track.place) > MOVED + 2 * std
        if is_free and track.left and is_far and not track.has_moved:
            track.has_moved = True
            track.take(HAS_MOVED)
            track.standing = 0.0
        if sight != ("followed" if track.has_moved else "few"):
            track.take(likelihood(sight, clutter))
            if nis is not None and shown:
                most = NEAR_THIRD if track.before and track.n_detections == 3 else NEAR_BOUNDS[1]
                near = np.clip(NEAREST * np.exp(-nis / 2), NEAR_BOUNDS[0], most)
                track.take((near, near, near, 1))
        if shown:
            track.measure(shape)
            track.feel(self.c.initial_std[2], since)

    def merge(self):
        if self.c.merge_distance is None:
            return []
        merged, index = [], 0
        while index < len(self.tracks):
            one = self.tracks[index]
            twins = [
                other
                for other in self.tracks[index + 1 :]
                if other.stamp == one.stamp
                and (
                    np.linalg.norm(other.r - one.r) <= self.c.merge_distance
                    or is_part(one, other)
                    or is_part(other, one)
                )
                and np.linalg.norm((other.x - one.x)[3:6]) <= MERGE_SPEED
            ]
            if not twins:
                index += 1
                continue
            other = twins[0]
            kept, gone = (other, one) if other.confirmed and not one.confirmed else (one, other)
            merged.append([kept.id, gone.id])
            is_larger = kept.size.max() < LARGE <= gone.size.max()
            state = gone if gone.seen > kept.seen or is_larger else kept
            size = max(len(kept.history), len(gone.history))
            padded = [[False] * (size - len(one.history)) + one.history for one in (kept, gone)]
            best = gone if gone.there + gone.hidden > kept.there + kept.hidden else kept

            self.tracks[index] = replace(
                state,
                id=kept.id,
                born=kept.born,
                confirmed=kept.confirmed,
                n_detections=max(kept.n_detections, gone.n_detections),
                history=[a or b for a, b in zip(*padded, strict=True)],
                was_confirmed=kept.was_confirmed or gone.was_confirmed,
                there=best.there,
                hidden=best.hidden,
                standing=best.standing,
                believed=best.believed,
                has_moved=best.has_moved,
                seen_kinds=best.seen_kinds,
                free_at_first=best.free_at_first,
                agility=best.agility,
                radius=best.radius,
                filled=best.filled,
                coherence=best.coherence,
                uncovered=best.uncovered,
                began_uncovered=best.began_uncovered,
            )
            self.tracks = [track for track in self.tracks if track is not other]
        self.tracks.sort(key=lambda track: track.id)
        return merged
