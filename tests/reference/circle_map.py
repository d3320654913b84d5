"""Semantic circle map in plain numpy: the joint filter of the paper, and a filter per element.

Written from the paper (Sanchez-Lopez et al., sec. V) and the text of `CircleMapConfig`; slow and
obvious. Stacked matrices over the whole state, matrix exponentials, full tables of distances.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from scipy.linalg import expm
from scipy.optimize import linear_sum_assignment
from scipy.stats import chi2, multivariate_normal

from reference.circle_existence import OVER, Arrivals, Existence

H = np.zeros((3, 5))
H[0, 0] = H[1, 1] = H[2, 4] = 1.0
LONGEST_STEP = 0.1
# Rules of the map that are no parameters.
SURE, NO_CHANCE = 5.99, 0.25  # squared velocity in its covariance: begins to move, stands again
STANDS, MOVES = 0.8, 0.4  # probabilities
DEPARTS = 2  # measurements in a row
BIRTH_DENSITY = 1e-4  # [1/m^3]
MOST_VELOCITY_STD, MOST_RADIUS_STD = 3.0, 0.3  # [m/s], [m]
LEAST_RAYS = 4
MOMENT, AWAY, KNOWN_FOR = 0.5, 2.5, 1.0  # [s]
SEE_MARGIN = 0.15  # [m]
OTHER, OTHER_OF_ROUND = 0.05, 0.001  # probabilities
PART, PART_SHARE = 0.03, 0.5  # [m], of the radius
FARTHEST, FASTEST = 0.8, 3.0  # [m], [m/s]
RETURN, HIDDEN = 11.8, 5.0  # squared distance, [s]
ORDER = ["seen through", "returns", "occluded", "out of view"]


def rotation(angle):
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


def level_pose(pose):
    """Position and yaw of the sensor."""
    return pose[:2, 3], np.arctan2(pose[1, 0], pose[0, 0])


def transition(t):
    F = np.eye(5)
    F[0, 2] = F[1, 3] = t
    return F


def white_noise(t, q, q_radius):
    """Van Loan: the integral of F(s) diag(0, 0, q, q, q_r) F(s)' over the step."""
    A = np.zeros((5, 5))
    A[0, 2] = A[1, 3] = 1.0
    block = np.zeros((10, 10))
    block[:5, :5], block[5:, 5:] = -A, A.T
    block[:5, 5:] = np.diag([0, 0, q, q, q_radius])
    E = expm(block * t)
    return E[5:, 5:].T @ E[:5, 5:]


# --- the paper ------------------------------------------------------------------------------------


class JointMap:
    """Eqs 8-33 with the sensor's level frame as the robot's."""

    def __init__(self, config):
        self.config = config
        self.gate = chi2.ppf(config.gate_probability, 3)
        self.x, self.P = np.zeros(0), np.zeros((3, 3))
        self.ids, self.next, self.stamp = [], 0, None

    def update(self, circles, covariance, pose, stamp, doubt):
        """Element of every circle."""
        t, yaw = level_pose(pose)
        self.predict(stamp, doubt)
        z = [self.expected(k, t, yaw) for k in range(len(self.ids))]
        chosen = []
        for circle, R in zip(circles, covariance, strict=True):
            S = [J @ self.P @ J.T + R for _, J in z]
            d2 = [
                (circle - h) @ np.linalg.solve(s, circle - h)
                for (h, _), s in zip(z, S, strict=True)
            ]
            best = int(np.argmin(d2)) if d2 else -1
            chosen.append(best if d2 and d2[best] < self.gate else -1)
        pairs = [(i, k) for i, k in enumerate(chosen) if k >= 0]
        if pairs:
            J = np.vstack([z[k][1] for _, k in pairs])
            y = np.concatenate([circles[i] - z[k][0] for i, k in pairs])
            R = np.zeros((len(y), len(y)))
            for row, (i, _) in enumerate(pairs):
                R[3 * row : 3 * row + 3, 3 * row : 3 * row + 3] = covariance[i]
            K = self.P @ J.T @ np.linalg.inv(J @ self.P @ J.T + R)
            self.x = self.x + (K @ y)[3:]
            self.P = (np.eye(len(self.P)) - K @ J) @ self.P
        elements = [self.ids[k] if k >= 0 else None for k in chosen]
        for i in np.flatnonzero(np.array(chosen, int) < 0):
            self.create(circles[i], covariance[i], t, yaw)
            elements[i] = self.ids[-1]
        self.delete()
        return elements

    def predict(self, stamp, doubt):
        dt = 0.0 if self.stamp is None else (stamp - self.stamp) * 1e-9
        self.stamp = stamp
        n = len(self.ids)
        F = np.kron(np.eye(n), transition(dt))
        Q = np.kron(np.eye(n), self.step_noise())
        self.x = F @ self.x
        P = np.zeros((3 + 5 * n, 3 + 5 * n))
        P[3:, 3:] = F @ self.P[3:, 3:] @ F.T + Q
        if doubt is not None:
            P[:3, :3] = doubt[np.ix_([0, 1, 5], [0, 1, 5])]
        self.P = P

    def step_noise(self):
        return np.diag([0, 0, 1, 1, 0]) * self.config.velocity_step**2

    def expected(self, k, t, yaw):
        """Eqs 16-17 and the Jacobian by all errors."""
        element = self.x[5 * k : 5 * k + 5]
        C = rotation(yaw)
        p = C.T @ (element[:2] - t)
        J = np.zeros((3, len(self.P)))
        J[:2, :2] = -C.T
        J[:2, 2] = [p[1], -p[0]]
        J[:, 3 + 5 * k : 8 + 5 * k] = H
        J[:2, 3 + 5 * k : 5 + 5 * k] = C.T
        return np.r_[p, element[4]], J

    def create(self, z, R, t, yaw):
        """Eqs 18-20, 31-32."""
        C, n = rotation(yaw), len(self.P)
        at = C @ z[:2]
        G = np.zeros((n + 5, n))
        G[:n, :n] = np.eye(n)
        G[n : n + 2, :2] = np.eye(2)
        G[n : n + 2, 2] = [-at[1], at[0]]
        G_z = np.zeros((n + 5, 3))
        G_z[n : n + 2, :2] = C
        G_z[n + 4, 2] = 1.0
        self.P = G @ self.P @ G.T + G_z @ R @ G_z.T
        for axis in (2, 3):
            self.P[n + axis, n + axis] += self.config.initial_speed**2
        self.x = np.r_[self.x, at + t, 0.0, 0.0, z[2]]
        self.ids.append(self.next)
        self.next += 1

    def delete(self):
        kept = [
            k
            for k in range(len(self.ids))
            if np.linalg.eigvalsh(self.P[3 + 5 * k : 8 + 5 * k, 3 + 5 * k : 8 + 5 * k]).max()
            < self.config.max_eigenvalue
            and self.x[5 * k + 4] > 0
        ]
        places = [5 * k + i for k in kept for i in range(5)]
        self.x = self.x[places]
        places = [0, 1, 2, *(3 + place for place in places)]
        self.P = self.P[np.ix_(places, places)]
        self.ids = [self.ids[k] for k in kept]

    def at(self, stamp):
        dt = (stamp - self.stamp) * 1e-9
        F = transition(dt)
        Q = self.step_noise() * (dt != 0)
        return [
            (
                i,
                F @ self.x[5 * k : 5 * k + 5],
                F @ self.P[3 + 5 * k : 8 + 5 * k, 3 + 5 * k : 8 + 5 * k] @ F.T + Q,
            )
            for k, i in enumerate(self.ids)
        ]


# --- a filter per element -------------------------------------------------------------------------


@dataclass
class Element:
    id: int
    x: list
    P: list
    mu: np.ndarray
    existence: Existence
    confirmed: bool = False
    seen: str = "measured"
    hidden: float = 0.0
    away: float = 0.0
    last: int = 0
    count: int = 1
    lost: bool = False
    stands: bool = False
    departs: int = 0
    places: list = field(default_factory=list)
    excess: float = 0.0
    weight: float = 4.0
    sides: tuple = ()
    same: float = 0.0
    lasting: np.ndarray = field(default_factory=lambda: np.zeros((3, 3)))
    share: float = 0.0
    rough: float = 0.0
    waits: int = 0
    waiting: float = 0.0
    known: float = 0.0
    unheard: float = 0.0

    def doubt(self):
        """Probability that it is farther away than the places at which it was looked for."""
        state, P = self.combined()
        asked = 2.0 if self.seen == "seen through" else 0.0
        return np.exp(-0.5 * (asked + state[4] / np.sqrt(np.trace(P[:2, :2]) / 2)) ** 2)

    def look(self, R, pose, spacing):
        """Errors of the sides between rays: evenly spread, the same while the rays are the same."""
        t, yaw = level_pose(pose)
        x, y, radius = self.combined()[0][[0, 1, 4]] - [*t, 0.0]
        d, bearing = np.hypot(x, y), np.arctan2(y, x) - yaw
        half = np.arcsin(min(radius / d, 1.0))
        sides = (bearing - half, bearing + half)
        apart = [
            abs(np.angle(np.exp(1j * (a - b)))) for a, b in zip(sides, self.sides, strict=False)
        ]
        is_same = bool(apart) and max(apart) < 0.3 * spacing
        across = np.array([[-y / d, x / d, sign] for sign in (-1, 1)])
        lasting = R @ (across.T @ across * 12 / (d * spacing) ** 2) @ R
        lasting *= min(1.0, 0.9 * np.trace(R) / np.trace(lasting))
        newest = 0.1 if self.sides else 1.0
        self.lasting = (1 - newest) * self.lasting + newest * lasting
        self.share += newest * (np.trace(lasting) / np.trace(R) - self.share)
        self.same += 0.1 * (is_same - self.same)
        self.sides = sides

    def widened(self, P):
        """What the same rays show again counts once: the rest of P, and the error that lasts."""
        kept = np.array([1.0, 1.0, 0.0, 0.0, 1.0]) * (np.sqrt(1 - self.share * self.same) - 1) + 1
        return P * np.outer(kept, kept) + H.T @ (self.lasting * self.same) @ H

    def of_part(self, z, R):
        """Covariance of a measurement of another part of the body."""
        return R + (PART + PART_SHARE * max(self.combined()[0][4], z[2])) ** 2 * np.eye(3)

    def listen(self, z, R, stamp):
        """Mean excess of minus the products of departures in a row from constant velocity."""
        x, P = self.combined()
        excess = min((z[2] - x[4]) ** 2 - R[2, 2] - P[4, 4], 0.01)
        self.rough += 0.1 * (excess - self.rough)
        self.places = [*self.places[-3:], (stamp * 1e-9, z[:2], np.trace(R[:2, :2]) / 2)]
        if len(self.places) < 4:
            return
        t, place, r = zip(*self.places, strict=True)
        off, weights = [], []
        for i in (0, 1):
            if not (t[i] < t[i + 1] < t[i + 2] and t[i + 2] - t[i] < 0.5):
                return
            k = (t[i + 2] - t[i + 1]) / (t[i + 1] - t[i])
            weights.append(np.array([k, -1 - k, 1.0]))
            off.append(weights[i] @ np.array(place[i : i + 3]))
        if max(r) >= 0.03**2:
            return
        both = np.array([weights[0][1] * weights[1][0], weights[0][2] * weights[1][1]])
        sample = (off[0] @ off[1] / 2 - both @ r[1:3]) / both.sum()
        self.weight = min(self.weight + 1, 30)
        self.excess += (np.clip(sample, -(0.08**2), 0.08**2) - self.excess) / self.weight

    def noisy(self, R):
        rough = max(self.rough - R[2, 2], 0.0)
        return R + max(self.excess, 0.0) * np.diag([1, 1, 0]) + rough * np.diag([0, 0, 1])

    def reported(self):
        """Standing: no velocity; the error of that is in the covariance."""
        x, P = self.combined()
        if self.stands:
            P = P.copy()
            P[2:4, 2:4] += np.outer(x[2:4], x[2:4]) + 1e-6 * np.eye(2)
            x = np.r_[x[:2], 0, 0, x[4]]
        return x, self.widened(P)

    def combined(self):
        return mixture(self.mu, self.x, self.P)

    def visible(self):
        return self.seen not in ("occluded", "out of view")


def mixture(mu, means, covariances):
    """Mean and covariance of a mixture of Gaussians with the weights mu."""
    x = sum(m * mode for m, mode in zip(mu, means, strict=True))
    P = sum(
        m * (P + np.outer(mode - x, mode - x))
        for m, mode, P in zip(mu, means, covariances, strict=True)
    )
    return x, P


class IndependentMap:
    def __init__(self, config):
        self.config = config
        self.arrivals = Arrivals()
        self.gate = chi2.ppf(config.gate_probability, 3)
        self.densities, weights, times = np.array(config.modes).T
        moving = weights / weights.sum()
        n = len(moving)
        among = np.zeros((n, n))
        for i in range(n):
            for j in range(n):
                if i != j:
                    among[i, j] = moving[j] / (1 - moving[i]) / times[i]
        self.stops = config.standing_share > 0
        if self.stops:
            share = config.standing_share
            self.weight = np.r_[share, moving * (1 - share)]
            self.rates = np.zeros((n + 1, n + 1))
            self.rates[1:, 1:] = among
            self.rates[1:, 0] = 1 / config.moving_time
            self.rates[0, 1:] = moving / config.standing_time
        else:
            self.weight, self.rates = moving, among
        self.rates -= np.diag(self.rates.sum(axis=1))
        # Ahead of the newest scan nothing stops or starts.
        self.coasting = self.rates.copy()
        if self.stops:
            self.coasting[0, :] = self.coasting[:, 0] = 0.0
            self.coasting -= np.diag(self.coasting.sum(axis=1))
        self.elements, self.next, self.stamp = [], 0, None

    def speedless(self, j, x, P):
        """Mode j as it goes over to the other kind, standing or moving: any velocity is new."""
        x, P = x.copy(), P.copy()
        x[2:4] = 0.0
        P[2:4] = P[:, 2:4] = 0.0
        if j == 0:
            P[2, 2] = P[3, 3] = self.config.start_speed**2
        return x, P

    def noise(self, j, part):
        config = self.config
        if self.stops and j == 0:
            return part * np.diag([config.standing_noise] * 2 + [0, 0, config.radius_noise])
        return white_noise(part, self.densities[j - self.stops], config.radius_noise)

    def predicted(self, element, dt, rates=None):
        x, P, mu = list(element.x), list(element.P), element.mu
        steps = max(1, int(np.ceil(dt / LONGEST_STEP)))
        part = dt / steps
        M, F = expm((self.rates if rates is None else rates) * part), transition(part)
        for _ in range(steps):
            after = mu @ M
            mixed = []
            for j in range(len(mu)):
                w = mu * M[:, j] / after[j]
                come = [
                    self.speedless(i, x[i], P[i])
                    if self.stops and (i == 0) != (j == 0)
                    else (x[i], P[i])
                    for i in range(len(mu))
                ]
                mean = sum(a * b for a, (b, _) in zip(w, come, strict=True))
                spread = sum(
                    a * (b + np.outer(c - mean, c - mean))
                    for a, (c, b) in zip(w, come, strict=True)
                )
                mixed.append((F @ mean, F @ spread @ F.T + self.noise(j, part)))
            x, P, mu = [m for m, _ in mixed], [c for _, c in mixed], after
        return x, P, mu

    def update(self, circles, covariance, pose, stamp, doubt, look, area, spacing):
        """Element of every circle. `look` tells what the scan says about a circle in the world."""
        dt = 0.0 if self.stamp is None else (stamp - self.stamp) * 1e-9
        self.stamp = stamp
        measurements = [
            in_world(z, R, pose, doubt) for z, R in zip(circles, covariance, strict=True)
        ]
        for element in self.elements:
            if dt:
                element.x, element.P, element.mu = self.predicted(element, dt)
                element.waits, element.waiting = element.waits + 1, element.waiting + dt
                element.existence.predict(dt)
                element.unheard += dt
        wholes = whole_of([z for z, _ in measurements], self.config.merge_gap)
        whole = sum(one == row for row, one in enumerate(wholes))
        density = max(BIRTH_DENSITY, max(whole, 1) / ((area + 1) * 0.5))
        row_of = self.associate(measurements, wholes, density if self.stops else None)
        numbers = [None] * len(measurements)
        for k, element in enumerate(self.elements):
            if k in row_of:
                numbers[row_of[k]] = element.id
                z, R = measurements[row_of[k]]
                self.correct(element, z, R, stamp, (pose, spacing))
                element.seen, element.last, element.count = "measured", stamp, element.count + 1
                element.hidden = element.away = 0.0
            else:
                element.seen = look(*element.combined())
                is_glimpsed = element.seen == "out of view" and self.glimpse(element, look)
                if not element.visible() and not is_glimpsed:
                    element.hidden += dt
            element.existence.see(element.seen, element.doubt())
            if element.seen != "measured" and element.existence() < OVER:
                element.away += dt
        for row, number in enumerate(numbers):
            if number is None and wholes[row] == row:
                numbers[row] = self.create(*measurements[row], stamp)
        self.tidy()
        return [numbers[whole] for whole in wholes]

    def likelihood(self, element, z, R):
        """Of a measurement, or 0 outside all gates."""
        total, inside, R = 0.0, False, element.noisy(R)
        prior = 1.0
        if self.stops:
            x, P = element.combined()
            S, y = H @ P @ H.T + element.of_part(z, R), z - H @ x
            is_known = element.mu[0] > STANDS or np.linalg.eigvalsh(P[:2, :2]).max() < 0.5**2
            time = element.waiting / max(element.waits, 1) if is_known else element.waiting
            if np.hypot(*y[:2]) > max(FARTHEST, FASTEST * time):
                return 0.0
            if element.waits > 1:
                if y[:2] @ np.linalg.solve(S[:2, :2], y[:2]) > RETURN:
                    return 0.0
                prior = np.exp(-element.waiting / HIDDEN)
            if y @ np.linalg.solve(S, y) <= self.gate:
                total = OTHER * multivariate_normal(np.zeros(3), S).pdf(y)
        whole = 0.0
        for x, P, m in zip(element.x, element.P, element.mu, strict=True):
            S = H @ P @ H.T + R
            y = z - H @ x
            inside |= bool(y @ np.linalg.solve(S, y) <= self.gate)
            whole += m * multivariate_normal(np.zeros(3), S).pdf(y)
        return prior * (total + (whole if inside else 0.0))

    def associate(self, measurements, wholes, density):
        n, m = len(self.elements), len(measurements)
        never = 1e9
        cost = np.full((n, m + n), never)
        for k, element in enumerate(self.elements):
            for row, (z, R) in enumerate(measurements):
                p = self.likelihood(element, z, R)
                alike = are_alike(element.combined()[0][4], z[2])
                if p > 0 and alike and wholes[row] == row:
                    cost[k, row] = -2 * np.log(p)
            cost[k, m + k] = -2 * np.log(density or BIRTH_DENSITY)
        chosen = zip(*linear_sum_assignment(cost), strict=True)
        row_of = {int(k): int(row) for k, row in chosen if row < m}
        for row in range(m if density else 0):
            if row in row_of.values() or wholes[row] != row:
                continue
            z, near = measurements[row][0], []
            for k, element in enumerate(self.elements):
                x, P = element.combined()
                known = np.linalg.eigvalsh(P[:2, :2]).max() < 0.5**2
                one = is_one(x[[0, 1, 4]], z, self.config.merge_gap) and are_alike(x[4], z[2])
                apart = np.hypot(*(x[:2] - z[:2]))
                if k not in row_of and known and one and apart <= FARTHEST:
                    near.append((apart, k))
            if near:
                row_of[min(near)[1]] = row
        return row_of

    def correct(self, element, z, R, stamp, view):
        element.listen(z, R, stamp)
        element.known += element.waiting
        element.waits, element.waiting = 0, 0.0
        element.look(R, *view)
        R = element.noisy(R)
        wide = element.of_part(z, R)
        far = []
        for x, P in zip(element.x, element.P, strict=True):
            y = z - H @ x
            far.append((y @ np.linalg.solve(H @ P @ H.T + R, y), y @ y))
        squared, length = min(far)
        if squared > self.gate:
            x, P = element.combined()
            if (z[2] - x[4]) ** 2 > 9.0 * (P[4, 4] + R[2, 2]):
                R = R + length / self.gate * np.eye(3)
            else:
                R = R * squared / self.gate
        scores = []
        for j, (x, P) in enumerate(zip(element.x, element.P, strict=True)):
            y, S = z - H @ x, H @ P @ H.T + R
            likelihood = multivariate_normal(np.zeros(3), S).logpdf(y)
            if self.stops and j == 0:
                S_part = H @ P @ H.T + wide
                part = np.log(OTHER_OF_ROUND) + multivariate_normal(np.zeros(3), S_part).logpdf(y)
                S = S_part if part > likelihood else S
                likelihood = np.logaddexp(likelihood, part)
            K = P @ H.T @ np.linalg.inv(S)
            scores.append(np.log(element.mu[j]) + likelihood)
            element.x[j] = x + K @ y
            element.P[j] = (np.eye(5) - K @ H) @ P
        weight = np.exp(np.array(scores) - max(scores))
        element.mu = weight / weight.sum()

    def glimpse(self, element, look):
        """A few rays that end on what stands: which mode is right, where the moving ones are."""
        if not element.stands or element.known < KNOWN_FOR:
            return False
        place = element.combined()[0][[0, 1, 4]]
        found = look.glimpse(*place)
        if found is None:
            return False
        z, std = np.r_[found[0], place[2]], found[1]
        R = np.diag([std**2, std**2, 1.0])
        scores = []
        for j, (x, P) in enumerate(zip(element.x, element.P, strict=True)):
            y, S = z - H @ x, H @ P @ H.T + R
            scores.append(np.log(element.mu[j]) + multivariate_normal(np.zeros(3), S).logpdf(y))
            if j > 0:
                K = P @ H.T @ np.linalg.inv(S)
                element.x[j], element.P[j] = x + K @ y, (np.eye(5) - K @ H) @ P
        weight = np.exp(np.array(scores) - max(scores))
        element.mu = weight / weight.sum()
        return True

    def create(self, z, R, stamp):
        known, more = 0.002**2, [e.weight - 4.0 for e in self.elements]
        shown = sum(e.excess * w for e, w in zip(self.elements, more, strict=True))
        excess = max(known, (known * 4.0 + shown) / (4.0 + sum(more)))
        modes = len(self.weight)
        existence = Existence(self.arrivals, R[2, 2])
        element = Element(
            self.next, [H.T @ z] * modes, [], self.weight, existence, last=stamp, excess=excess
        )
        element.stands = self.stops
        P = H.T @ element.noisy(R) @ H
        P[2, 2] = P[3, 3] = self.config.initial_speed**2
        still = P * np.outer([1, 1, 0, 0, 1], [1, 1, 0, 0, 1])
        element.P = [still if self.stops and j == 0 else P for j in range(modes)]
        element.listen(z, R, stamp)
        self.elements.append(element)
        self.next += 1
        return element.id

    def tidy(self):
        config = self.config
        k = 0
        while k < len(self.elements):
            one = self.elements[k]
            others, gap = self.elements[k + 1 :], config.merge_gap
            twins = [other for other in others if is_twin(one, other, gap, MOMENT)]
            if not twins:
                k += 1
                continue
            self.elements.remove(twins[0])
            pair = [one, twins[0]]
            if twins[0].confirmed and not one.confirmed:
                pair.reverse()
            self.elements[k] = united(*pair)
        self.elements.sort(key=lambda element: element.id)
        kept = []
        for element in self.elements:
            least = config.report_existence * (0.5 if element.confirmed else 1.0)
            element.confirmed = element.existence() >= least
            if self.stops:
                stood, p = element.stands, element.mu[0]
                x, P = element.combined()
                by_chance = x[2:4] @ np.linalg.solve(P[2:4, 2:4], x[2:4])
                still = (
                    p > STANDS
                    or (stood and p >= MOVES)
                    or by_chance < (SURE if stood else NO_CHANCE)
                )
                if not element.waits:
                    element.departs = 0 if still else element.departs + 1
                element.stands = still or (stood and element.departs < DEPARTS)
            if element.seen == "measured":
                element.existence.moves(element.stands, element.unheard)
                element.unheard = 0.0
            worst = np.linalg.eigvalsh(element.reported()[1][:2, :2]).max()
            most = config.max_position_std
            if element.waits and self.stops:
                most = min(most, 0.5)
            element.lost = worst >= most**2
            vague = False
            if element.seen == "measured":
                x, P = element.combined()
                vague = (
                    x[4] <= 0
                    or np.linalg.eigvalsh(P[:2, :2]).max() >= config.max_position_std**2
                    or np.linalg.eigvalsh(P[2:4, 2:4]).max() >= MOST_VELOCITY_STD**2
                    or P[4, 4] > MOST_RADIUS_STD**2
                )
            most = np.inf if config.max_coast is None else config.max_coast
            was_sure = element.confirmed or element.existence.was >= config.report_existence
            most = most if was_sure else min(most, MOMENT)
            is_long = (not element.visible() and element.hidden > most) or element.away > AWAY
            is_over = element.existence.was * element.existence.anywhere < OVER or is_long or vague
            element.existence.settle(is_over, self.arrivals)
            if not is_over:
                kept.append(element)
        self.elements = kept

    def at(self, stamp):
        """Confirmed elements at a time that is not before the newest scan."""
        found = []
        for element in self.elements:
            if element.confirmed and not element.lost:
                ahead = self.predicted(element, (stamp - self.stamp) * 1e-9, self.coasting)
                x, P = replace(
                    element, **dict(zip(("x", "P", "mu"), ahead, strict=True))
                ).reported()
                found.append((element.id, element.reported()[0] if element.stands else x, P))
        return found


def is_twin(one, other, gap, moment):
    """Both in sight, or measured at most a `moment` before the other."""
    a, b = (element.combined()[0][[0, 1, 4]] for element in (one, other))
    newest = max(one.last, other.last)
    known = [e.visible() or (newest - e.last) * 1e-9 <= moment for e in (one, other)]
    near = np.hypot(*(a - b)[:2]) <= FARTHEST
    return all(known) and near and are_alike(a[2], b[2]) and is_one(a, b, gap)


def are_alike(a, b):
    """Whether the radii may be of one object: what is inside a large one is another."""
    return max(a, b) < 0.5 or min(a, b) >= 0.5 * max(a, b)


def is_one(a, b, gap):
    """Whether two circles are one object: one inside the other, or little between them."""
    apart = np.hypot(*(a - b)[:2])
    inside = apart < max(a[2], b[2])
    touching = gap > 0 and apart < a[2] + b[2] + gap
    return inside or touching


def whole_of(circles, gap):
    """Row of the largest circle that each is a part of, itself if none."""
    wholes, larger = list(range(len(circles))), []
    for row in sorted(wholes, key=lambda row: -circles[row][2]):
        near = [other for other in larger if is_one(circles[row], circles[other], gap)]
        if near:
            wholes[row] = near[0]
        else:
            larger.append(row)
    return wholes


def united(kept, dropped):
    rank = [(element.last, element.count) for element in (kept, dropped)]
    if rank[1] > rank[0]:
        names = "x P mu seen last hidden away stands places excess weight"
        names += " sides same lasting share rough waits waiting known"
        for name in names.split():
            setattr(kept, name, getattr(dropped, name))
    kept.count = max(kept.count, dropped.count)
    if dropped.existence() > kept.existence():
        kept.existence = dropped.existence
    return kept


def in_world(z, R, pose, doubt):
    """A circle of the level frame in the world; the pose's covariance by differences."""
    t, yaw = level_pose(pose)
    C = np.eye(3)
    C[:2, :2] = rotation(yaw)
    at = C @ z + [*t, 0.0]
    R = C @ R @ C.T
    if doubt is not None:
        J = pose_jacobian(pose, at[:2])
        R[:2, :2] += J @ doubt @ J.T
    return at, R


def pose_jacobian(pose, at, step=1e-6):
    """Derivative of the place, seen from above, of a point that the tilted scan saw there."""
    angles = np.array(
        [
            np.arctan2(pose[2, 1], pose[2, 2]),
            np.arcsin(-pose[2, 0]),
            np.arctan2(pose[1, 0], pose[0, 0]),
        ]
    )
    point = np.linalg.solve(pose[:2, :2], at - pose[:2, 3])  # in the plane of the scan
    columns = []
    for parameter in range(6):
        moved = []
        for sign in (1, -1):
            values = np.r_[pose[:3, 3], angles]
            values[parameter] += sign * step
            moved.append(turn(*values[3:])[:2, :2] @ point + values[:2])
        columns.append((moved[0] - moved[1]) / (2 * step))
    return np.array(columns).T


def turn(alpha, beta, gamma):
    X, Y, Z = np.eye(3), np.eye(3), np.eye(3)
    X[1:, 1:] = rotation(alpha)
    Z[:2, :2] = rotation(gamma)
    Y[np.ix_([0, 2], [0, 2])] = rotation(beta).T
    return Z @ Y @ X


def seen(ranges, bearings, limits, config, x, y, radius):
    """What a scan says about a circle of its frame."""
    d, beta = np.hypot(x, y), np.arctan2(y, x)
    if d <= radius or d - radius < limits[0]:
        return "out of view"
    off = (bearings - beta + np.pi) % (2 * np.pi) - np.pi
    meets = np.abs(off) < np.arcsin(radius / d)
    across = d * np.sin(off[meets])
    surface = d * np.cos(off[meets]) - np.sqrt(radius**2 - across**2)
    known = ~np.isnan(ranges[meets]) & (surface <= limits[1] - SEE_MARGIN)
    gap = (ranges[meets] - surface)[known]
    through, before = (gap > SEE_MARGIN).sum(), (gap < -SEE_MARGIN).sum()
    on = len(gap) - through - before
    if len(gap) < LEAST_RAYS:
        return "out of view"
    if through >= LEAST_RAYS and 2 * through >= len(gap):
        return "seen through"
    return "returns" if on >= LEAST_RAYS and on >= before else "occluded"


def looker(ranges, bearings, limits, config, pose):
    """`look` of `IndependentMap.update`: seen through only if that holds wherever it may be."""
    t, yaw = level_pose(pose)

    def look(state, P):
        values, vectors = np.linalg.eigh(P[:2, :2])
        offsets = [np.zeros(2)]
        for value, vector in zip(values, vectors.T, strict=True):
            offsets += [reach * np.sqrt(value) * vector for reach in (-2, -1, 1, 2)]
        places = [rotation(-yaw) @ (state[:2] + offset - t) for offset in offsets]
        answers = [seen(ranges, bearings, limits, config, *place, state[4]) for place in places]
        return answers[0] if answers[0] != "seen through" else max(answers, key=ORDER.index)

    def glimpse(x, y, radius):
        """Centre in the world by the rays that end on a circle, and its deviation; None: none."""
        at = rotation(-yaw) @ (np.array([x, y]) - t)
        d, beta = np.hypot(*at), np.arctan2(at[1], at[0])
        off = (bearings - beta + np.pi) % (2 * np.pi) - np.pi
        meets = (np.abs(off) <= np.arcsin(min(radius / d, 1.0))) & ~np.isnan(ranges)
        across = d * np.sin(off[meets])
        surface = d * np.cos(off[meets]) - np.sqrt(np.maximum(radius**2 - across**2, 0.0))
        on = np.abs(ranges[meets] - surface) <= SEE_MARGIN
        if d <= radius or d - radius < limits[0] or 2 * on.sum() <= len(on):
            return None
        reach, bearing = (ranges[meets] + radius)[on], bearings[meets][on]
        middle = np.array([np.mean(reach * np.cos(bearing)), np.mean(reach * np.sin(bearing))])
        return rotation(yaw) @ middle + t, radius + 0.5 * d * np.diff(bearings).mean()

    look.glimpse = glimpse
    return look


def area_of(ranges, bearings, limits):
    """Area between the sensor and the ends of the rays."""
    reach = np.minimum(ranges[:-1], limits[1])
    return np.nansum(0.5 * reach**2 * np.diff(bearings))
