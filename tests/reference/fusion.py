"""Oracle of the fusion filters: the same equations, one measurement at a time, in plain numpy."""

from functools import cache

import numpy as np

gauss = cache(np.polynomial.legendre.leggauss)
"""Nodes and weights of the rule of Gauss."""


def wrap(angle):
    return angle - 2 * np.pi * np.round(angle / (2 * np.pi))


def integrals(theta, w, dt, k):
    """Integrals of t^k cos(theta + w t) and t^k sin(theta + w t), by the rule of Gauss."""
    nodes, weights = gauss(24)
    t = dt * (nodes + 1) / 2
    weights = weights * dt / 2
    angle = theta + w * t
    return (weights * t**k * np.cos(angle)).sum(), (weights * t**k * np.sin(angle)).sum()


def cv(s, dt):
    return np.array([s[0] + s[2] * dt, s[1] + s[3] * dt, s[2], s[3]])


def ca(s, dt):
    p, v, a = s[0:2], s[2:4], s[4:6]
    return np.concatenate([p + v * dt + a * dt**2 / 2, v + a * dt, a])


def ct(s, dt):
    c, q = integrals(0.0, s[4], dt, 0)
    turn = np.array(
        [[np.cos(s[4] * dt), -np.sin(s[4] * dt)], [np.sin(s[4] * dt), np.cos(s[4] * dt)]]
    )
    p = s[0:2] + np.array([[c, -q], [q, c]]) @ s[2:4]
    return np.concatenate([p, turn @ s[2:4], s[4:]])


def ctrv(s, dt):
    a, b = integrals(s[3], s[4], dt, 0)
    return np.array([s[0] + s[2] * a, s[1] + s[2] * b, s[2], s[3] + s[4] * dt, s[4]])


def ctra(s, dt):
    a, b = integrals(s[3], s[4], dt, 0)
    c, d = integrals(s[3], s[4], dt, 1)
    return np.array(
        [
            s[0] + s[2] * a + s[5] * c,
            s[1] + s[2] * b + s[5] * d,
            s[2] + s[5] * dt,
            s[3] + s[4] * dt,
            s[4],
            s[5],
        ]
    )


def drone(s, dt, rate, u, lever):
    """The target moves over ground, then the sensor's frame moves: position and angle of it."""
    a, b = integrals(s[3], s[4], dt, 0)
    ground = s[0:2] + lever + s[2] * np.array([a, b])
    c, q = integrals(0.0, rate, dt, 0)
    moved = np.array([[c, -q], [q, c]]) @ u
    turn = rate * dt
    back = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    p = back @ (ground - moved) - lever
    return np.concatenate([p, [s[2], s[3] + (s[4] - rate) * dt, s[4]]])


MODELS = {"cv": cv, "ca": ca, "ct": ct, "ctrv": ctrv, "ctra": ctra}
NOISE = {  # states that white noise enters: a for acceleration, j for jerk, t for turn
    "cv": [(2, "a"), (3, "a")],
    "ca": [(4, "j"), (5, "j")],
    "ct": [(2, "a"), (3, "a"), (4, "t")],
    "ctrv": [(2, "a"), (4, "t")],
    "ctra": [(5, "j"), (4, "t")],
}


def jacobian(f, s):
    columns = []
    for k in range(len(s)):
        step = np.zeros(len(s))
        step[k] = 1e-5 * max(1.0, abs(s[k]))
        columns.append((f(s + step) - f(s - step)) / (2 * step[k]))
    return np.stack(columns, axis=1)


def continuous_noise(model, s, dt, strengths):
    f = MODELS[model]
    nodes, weights = gauss(3)
    total = np.zeros((len(s), len(s)))
    for node, weight in zip(nodes, weights, strict=True):
        t = dt * (node + 1) / 2
        after = jacobian(lambda state: f(state, dt - t), f(s, t))  # noqa: B023
        for state, name in NOISE[model]:
            column = after[:, state] * strengths[name]
            total += weight * dt / 2 * np.outer(column, column)
    return total


def velocity(model, s):
    if model in ("ctrv", "ctra"):
        return s[2] * np.array([np.cos(s[3]), np.sin(s[3])])
    return s[2:4]


def radar(model, s):
    v = velocity(model, s)
    rho = np.hypot(s[0], s[1])
    return np.array([rho, np.arctan2(s[1], s[0]), (s[0] * v[0] + s[1] * v[1]) / rho])


def seen_from(model, s, sensor, pose, lever):
    """What a sensor says of a state in the world: platform at x, y, yaw, with vx, vy and rate."""
    turn = np.array([[np.cos(pose[2]), -np.sin(pose[2])], [np.sin(pose[2]), np.cos(pose[2])]])
    arm = turn @ lever
    p = turn.T @ (s[:2] - pose[:2] - arm)
    if sensor == "lidar":
        return p
    v = turn.T @ (velocity(model, s) - pose[3:5] - pose[5] * np.array([-arm[1], arm[0]]))
    return np.array([np.hypot(*p), np.arctan2(p[1], p[0]), p @ v / np.hypot(*p)])


def ekf_step(model, s, P, dt, sensor, z, R, strengths, platform=None):
    """State, covariance, innovation and NIS after one measurement.

    A platform is a pose of six numbers, the covariance of the first three, and a lever.
    """
    f = MODELS[model]
    F = jacobian(lambda state: f(state, dt), s)
    P = F @ P @ F.T + continuous_noise(model, s, dt, strengths)
    s = f(s, dt)
    h = (lambda state: state[:2]) if sensor == "lidar" else (lambda state: radar(model, state))
    if platform is not None:
        pose, spread, lever = platform
        h = lambda state: seen_from(model, state, sensor, pose, lever)  # noqa: E731
        J = jacobian(lambda pose: seen_from(model, s, sensor, pose, lever), pose)[:, :3]
        R = R + J @ spread @ J.T
    H = jacobian(h, s)
    y = z - h(s)
    if sensor == "radar":
        y[1] = wrap(y[1])
    S = H @ P @ H.T + R
    K = P @ H.T @ np.linalg.inv(S)
    IKH = np.eye(len(s)) - K @ H
    return s + K @ y, IKH @ P @ IKH.T + K @ R @ K.T, y, y @ np.linalg.solve(S, y)


def rts(model, states, covariances, dt, strengths):
    """States given all measurements, from those of the filter."""
    f = MODELS[model]
    means, smoothed = [states[-1]], [covariances[-1]]
    for s, P in zip(states[-2::-1], covariances[-2::-1], strict=True):
        F = jacobian(lambda state: f(state, dt), s)
        predicted = F @ P @ F.T + continuous_noise(model, s, dt, strengths)
        G = P @ F.T @ np.linalg.inv(predicted)
        change = means[0] - f(s, dt)
        if model in ("ctrv", "ctra"):
            change[3] = wrap(change[3])
        means.insert(0, s + G @ change)
        smoothed.insert(0, P + G @ (smoothed[0] - predicted) @ G.T)
    return np.array(means), np.array(smoothed)


def paper_step(
    s,
    P,
    dt,
    sensor,
    z,
    std,
    *,
    alpha="literal",
    straight_y="literal",
    platform_column="literal",
    speed=0.0,
    elevation=0.0,
    reading="a",
):
    """Eqs 7-28 of the paper, reading A or B of the radar, states moved by eqs 8 and 9."""
    v, theta, w = s[2:5]
    cp, sp = np.cos(elevation), np.sin(elevation)
    v_dx, v_dy = speed * cp * np.cos(theta), speed * cp * np.sin(theta)
    sa, sw, sd = std
    moved = s.copy()
    phi = np.eye(6)
    if abs(w) < 1e-4:
        moved[:2] += v * dt * np.array([np.cos(theta), np.sin(theta)])
        moved[0] -= v_dx * np.cos(theta) * cp * dt
        moved[1] -= (v_dx if straight_y == "literal" else v_dy) * np.cos(theta) * sp * dt
        phi[0, 2:4] = np.cos(theta) * dt, -v * np.sin(theta) * dt
        phi[1, 2:4] = np.sin(theta) * dt, v * np.cos(theta) * dt
    else:
        turned = theta + w * dt
        moved[0] += v / w * (np.sin(turned) - np.sin(theta))
        moved[1] += v / w * (np.cos(theta) - np.cos(turned))
        moved[0] -= v_dx * np.cos(theta) * cp * dt
        moved[1] -= v_dy * np.cos(theta) * sp * dt
        moved[3] = turned
        a = theta + (dt if alpha == "literal" else w * dt)
        beta, chi = np.sin(a) - np.sin(theta), np.cos(a) - np.cos(theta)
        phi[0, 2:5] = beta / w, v / w * chi, dt * v / w * (np.cos(a) - v / w**2 * beta)
        phi[1, 2:5] = -chi / w, v / w * beta, dt * v / w * (np.sin(a) + v / w**2 * chi)
        phi[2, 3] = dt
    if platform_column == "literal":
        phi[0, 5] = -speed * np.sin(theta) * cp
        phi[1, 5] = speed * np.cos(theta) * sp
    c, q = np.cos(theta), np.sin(theta)
    Q, d2 = np.zeros((6, 6)), (dt * sd) ** 2
    Q[0, 0] = (dt**2 / 2 * sa * c) ** 2 + d2 * (c * cp) ** 2
    Q[0, 1] = dt**4 / 4 * sa**2 * q * c + d2 * c**2 * cp * sp
    Q[0, 2] = dt**3 / 4 * sa**2 * q * c
    Q[1, 0] = (dt**2 / 2 * sa * q) ** 2 + d2 * c**2 * cp * sp
    Q[1, 1] = dt**4 / 4 * sa**2 * q * c + d2 * (c * sp) ** 2
    Q[1, 2] = dt**3 / 2 * sa**2 * q
    Q[2, :3] = dt**3 / 2 * sa**2 * c, dt**3 / 2 * sa**2 * q, dt**2 * sa**2
    Q[4, 4] = dt**2 / 2 * sw
    Q[0, 5] = Q[5, 0] = -d2 * c * cp
    Q[1, 5], Q[5, 1] = -d2 * q * sp, -d2 * c * sp
    Q[5, 5] = -d2
    M = phi @ P @ phi.T + Q
    if sensor == "lidar":
        H, R, measured = np.eye(6)[:2], 0.0222 * np.eye(2), z
    else:
        H, R = np.eye(6)[:5], np.diag([0.088, 0.00088, 0.088, 0.0088, 0.08])
        turn = z[2] if reading == "b" else 0.0
        measured = np.array([z[0] * np.cos(z[1]), z[0] * np.sin(z[1]), z[2], z[1], turn])
    residual = measured - H @ moved
    if sensor == "radar":
        residual[3] = wrap(residual[3])
    K = M @ H.T @ np.linalg.inv(H @ M @ H.T + R)
    return moved + K @ residual, (np.eye(6) - K @ H) @ M
