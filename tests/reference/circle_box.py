"""The box that follows what is not round and moves, in plain numpy.

State of every mode: centre, velocity, half length along the heading and across it.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import expm
from scipy.stats import multivariate_normal

from reference.circle_map import IndependentMap, mixture

TURN, LENGTHS = 0.05, 1e-5  # [rad^2/s], [m^2/s]
FACING, CORNER, UNSEEN = 0.02, 0.04, 100.0  # standard deviations of sides [m]
GRAZING, OPEN = 0.2, 0.7  # cosines
DEPTH, DOUBT, LEAST, MIDDLE = 1.5, 1.0, 0.03, 0.4
GAP = 0.3  # [m]
SPEED, SURE, SLIP = 0.3, 0.5, 0.1  # [m/s], share, [rad]
FAR = 16.0
LONGEST_STEP = 0.1  # [s]
ROUND, SURELY_ROUND, LATEST = 0.15, 0.7, 0.03
STILL_SPEED = 1e-3  # [m/s]
DIRECTIONS = np.arange(16) * np.pi / 8


def axes_of(heading):
    c, s = np.cos(heading), np.sin(heading)
    return np.array([[c, s], [-s, c]])


def matrix(axes):
    """Low and high end along the first axis, then along the second, from the state."""
    rows = np.zeros((4, 6))
    for side in range(4):
        rows[side, :2] = axes[side // 2]
        rows[side, 4 + side // 2] = 1.0 if side % 2 else -1.0
    return rows


def hull(points):
    """Of some points, those that reach farthest in 16 directions."""
    ways = np.stack([np.cos(DIRECTIONS), np.sin(DIRECTIONS)])
    return points[(points @ ways).argmax(axis=0)]


def ends(points, axis):
    along = points @ axis
    return along.min(), along.max()


class Box:
    """One body, from its first scan on."""

    def __init__(self, config):
        self.model = IndependentMap(config)
        self.start_speed, self.speed = config.start_speed, config.initial_speed
        self.standing_noise = config.standing_noise
        self.x = None
        self.heading, self.spread, self.has_moved = 0.0, 1.0, False
        self.unround = None

    def doubt(self):
        """How doubtful it is that the body is round."""
        return np.clip((self.unround - ROUND) / (1 - SURELY_ROUND - ROUND), 0, 1)

    def see(self, points, is_round, *, covered, is_in_free, place, spacing):
        """Take in one scan that measured the body."""
        if self.unround is None:
            self.unround = 0.0 if is_round else 1.0
        else:
            self.unround += LATEST * ((not is_round) - self.unround)
        if not self.doubt():
            self.x = None
        elif self.x is not None:
            self.correct(hull(points), covered, is_in_free, place, spacing)
        elif not covered:
            self.start(hull(points), place)
        if self.x is not None and (self.combined()[0][4:] <= 0).any():
            self.x = None

    def start(self, points, place):
        """At rest; along the sight it ends 1.5 half widths, give or take one, behind its face."""
        ahead = (points.min(axis=0) + points.max(axis=0)) / 2 - place
        self.heading = np.arctan2(ahead[1], ahead[0])
        self.spread, self.has_moved = 1.0, False
        along, across = axes_of(self.heading)
        near, far = ends(points, along)
        left, right = ends(points, across)
        width = max(0.5 * (right - left), LEAST)
        depth = max(DEPTH * width, 0.5 * (far - near))
        center = along * (near + depth) + across * (0.5 * (left + right))
        # Errors: of the near side, of the depth (centre and half length alike), of the width.
        P = np.diag([FACING**2] * 2 + [self.speed**2] * 2 + [0, FACING**2])
        of_depth = np.r_[along, 0, 0, 1, 0]
        P += (DOUBT * width) ** 2 * np.outer(of_depth, of_depth)
        x = np.r_[center, 0, 0, depth, width]
        self.mu = np.array(self.model.weight)
        self.x, self.P = [x] * len(self.mu), [P] * len(self.mu)
        if self.model.stops:
            self.P[0] = P * np.outer([1, 1, 0, 0, 1, 1], [1, 1, 0, 0, 1, 1])

    def speedless(self, j):
        x, P = self.x[j].copy(), self.P[j].copy()
        x[2:4] = 0
        P[2:4] = P[:, 2:4] = 0
        if j == 0:
            P[2, 2] = P[3, 3] = self.start_speed**2
        return x, P

    def noise(self, j, t):
        Q = np.diag([0, 0, 0, 0, LENGTHS * t, LENGTHS * t])
        if self.model.stops and j == 0:
            return Q + np.diag([self.standing_noise * t] * 2 + [0] * 4)
        q = self.model.densities[j - self.model.stops]
        for axis in (0, 1):
            both = np.ix_([axis, axis + 2], [axis, axis + 2])
            Q[both] += q * np.array([[t**3 / 3, t**2 / 2], [t**2 / 2, t]])
        return Q

    def predict(self, dt):
        if self.x is None:
            return
        self.spread += TURN * dt
        steps = max(1, int(np.ceil(dt / LONGEST_STEP)))
        t, F = dt / steps, np.eye(6)
        F[0, 2] = F[1, 3] = t
        M = expm(self.model.rates * t)
        for _ in range(steps):
            after, mixed = self.mu @ M, []
            for j in range(len(self.mu)):
                w = self.mu * M[:, j] / after[j]
                come = [
                    self.speedless(i)
                    if self.model.stops and (i == 0) != (j == 0)
                    else (self.x[i], self.P[i])
                    for i in range(len(self.mu))
                ]
                mean = sum(a * b for a, (b, _) in zip(w, come, strict=True))
                spread = sum(
                    a * (c + np.outer(b - mean, b - mean))
                    for a, (b, c) in zip(w, come, strict=True)
                )
                mixed.append((F @ mean, F @ spread @ F.T + self.noise(j, t)))
            self.x, self.P, self.mu = [m for m, _ in mixed], [c for _, c in mixed], after

    def combined(self):
        return mixture(self.mu, self.x, self.P)

    def turn(self):
        """Heading from the velocity, once that is known."""
        x, P = self.combined()
        speed, std = np.hypot(*x[2:4]), np.sqrt((P[2, 2] + P[3, 3]) / 2)
        if speed < SPEED or std > SURE * speed:
            return
        motion = np.arctan2(x[3], x[2])
        if not self.has_moved:
            quarters = np.round((motion - self.heading) / (np.pi / 2))
            if quarters % 2:
                order = [0, 1, 2, 3, 5, 4]
                self.x = [one[order] for one in self.x]
                self.P = [one[np.ix_(order, order)] for one in self.P]
            self.heading += quarters * np.pi / 2
            self.has_moved = True
        off = motion - self.heading
        off -= np.pi * np.round(off / np.pi)
        gain = self.spread / (self.spread + (std / speed) ** 2 + SLIP**2)
        self.heading += gain * off
        self.spread *= 1 - gain

    def correct(self, points, covered, is_in_free, place, spacing):
        if is_in_free:
            self.turn()
        x, P = self.combined()
        axes = axes_of(self.heading)
        z, R = self.sides(points, x, axes, covered, place, spacing)
        H = matrix(axes)
        y, S = z - H @ x, H @ P @ H.T + np.diag(R)
        R = R + np.where(y**2 > FAR * np.diag(S), y**2 / FAR, 0)
        scores = []
        for j, (x, P) in enumerate(zip(self.x, self.P, strict=True)):
            y, S = z - H @ x, H @ P @ H.T + np.diag(R)
            scores.append(np.log(self.mu[j]) + multivariate_normal(np.zeros(4), S).logpdf(y))
            K = P @ H.T @ np.linalg.inv(S)
            self.x[j], self.P[j] = x + K @ y, (np.eye(6) - K @ H) @ P
        weight = np.exp(np.array(scores) - max(scores))
        self.mu = weight / weight.sum()

    def sides(self, points, x, axes, covered, place, spacing):
        """Position and variance of the four sides."""
        sight = place - x[:2]
        distance = np.hypot(*sight)
        sines = axes @ sight / distance
        z, R = np.zeros(4), np.full(4, UNSEEN**2)
        for side in range(4):
            number, sign = side // 2, 1 if side % 2 else -1
            z[side] = axes[number] @ x[:2] + sign * x[4 + number]
            end = ends(points, axes[number])[side % 2]
            openly = abs(sines[1 - number])
            gap = min(spacing * distance / max(openly, 0.1), GAP)
            if sign * sines[number] > 0:  # it faces the scanner
                beyond, std = (0.0 if abs(sines[number]) > GRAZING else gap), FACING
            elif openly >= OPEN and not covered:
                beyond, std = gap, CORNER
            elif sign * (end - z[side]) > 0:
                beyond, std = 0.0, CORNER
            else:
                continue
            z[side] = end + sign * beyond / 2
            R[side] = std**2 + beyond**2 / 12
        return z, R

    def reported(self, *, stands):
        """Centre, velocity, radius, and their covariance."""
        x, P = self.combined()
        J = np.zeros((5, 6))
        J[:4, :4] = np.eye(4)
        J[4, 4:] = 0.5
        C = J @ P @ J.T
        for half, axis in zip(x[4:], axes_of(self.heading), strict=True):
            C[:2, :2] += np.outer(axis, axis) * (MIDDLE * half) ** 2
        x = J @ x
        if stands:
            C[2:4, 2:4] += np.outer(x[2:4], x[2:4]) + STILL_SPEED**2 * np.eye(2)
            x[2:4] = 0
        return x, C
