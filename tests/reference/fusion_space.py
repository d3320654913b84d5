"""Oracle of the filters in space: models, sensors with a pose, EKF and UKF in plain numpy."""

import numpy as np

from reference import fusion as plane


def cv(s, dt):
    return np.concatenate([s[:3] + s[3:6] * dt, s[3:6]])


def ca(s, dt):
    p, v, a = s[:3], s[3:6], s[6:9]
    return np.concatenate([p + v * dt + a * dt**2 / 2, v + a * dt, a])


def ctrv(s, dt):
    x, y, v, heading, rate = plane.ctrv(np.array([s[0], s[1], s[3], s[4], s[5]]), dt)
    return np.array([x, y, s[2] + s[6] * dt, v, heading, rate, s[6]])


MODELS = {"cv-3d": cv, "ca-3d": ca, "ctrv-3d": ctrv}
NOISE = {  # states that white noise enters: a for acceleration, j for jerk, t for turn
    "cv-3d": [(3, "a"), (4, "a"), (5, "a")],
    "ca-3d": [(6, "j"), (7, "j"), (8, "j")],
    "ctrv-3d": [(3, "a"), (5, "t"), (6, "a")],
}
ANGLES = (1, 2)
"""Of range, bearing, elevation and range rate."""


def velocity(model, s):
    if model == "ctrv-3d":
        return np.array([s[3] * np.cos(s[4]), s[3] * np.sin(s[4]), s[6]])
    return s[3:6]


def rotation(attitude):
    """From the axes of a body with this roll, pitch and yaw into those of the world."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(attitude), np.sin(attitude)
    about_x = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    about_y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    about_z = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    return about_z @ about_y @ about_x


def seen(model, s, pose, lever):
    """Position and velocity in the frame of a sensor on a body at a pose of twelve numbers."""
    R = rotation(pose[3:6])
    place = R.T @ (s[:3] - pose[:3]) - lever
    return place, R.T @ (velocity(model, s) - pose[6:9]) - np.cross(pose[9:12], lever)


def polar(p, v):
    far, flat = np.linalg.norm(p), np.hypot(p[0], p[1])
    return np.array([far, np.arctan2(p[1], p[0]), np.arctan2(p[2], flat), p @ v / far])


def measured(model, s, pose, lever, chosen):
    """What a sensor gives: x, y, z for `chosen` None, else those of the four polar values."""
    p, v = seen(model, s, pose, lever)
    return p if chosen is None else polar(p, v)[list(chosen)]


def difference(a, b, chosen):
    y = a - b
    for row, place in enumerate(chosen or ()):
        if place in ANGLES:
            y[row] = plane.wrap(y[row])
    return y


def noise(model, s, dt, strengths):
    f, total = MODELS[model], np.zeros((len(s), len(s)))
    nodes, weights = plane.gauss(3)
    for node, weight in zip(nodes, weights, strict=True):
        t = dt * (node + 1) / 2
        after = plane.jacobian(lambda state: f(state, dt - t), f(s, t))  # noqa: B023
        for state, name in NOISE[model]:
            column = after[:, state] * strengths[name]
            total += weight * dt / 2 * np.outer(column, column)
    return total


def pose_noise(model, s, pose, lever, chosen, spread):
    h = lambda at: measured(model, s, np.concatenate([at, pose[6:]]), lever, chosen)  # noqa: E731
    J = plane.jacobian(h, pose[:6])
    return J @ spread @ J.T


def ekf_step(model, s, P, dt, z, R, strengths, pose, lever, chosen, spread):
    """State, covariance and NIS after a step and a measurement."""
    f = MODELS[model]
    F = plane.jacobian(lambda state: f(state, dt), s)
    P = F @ P @ F.T + noise(model, s, dt, strengths)
    s = f(s, dt)
    R = R + pose_noise(model, s, pose, lever, chosen, spread)
    H = plane.jacobian(lambda state: measured(model, state, pose, lever, chosen), s)
    y = difference(z, measured(model, s, pose, lever, chosen), chosen)
    S = H @ P @ H.T + R
    K = P @ H.T @ np.linalg.inv(S)
    left = np.eye(len(s)) - K @ H
    return s + K @ y, left @ P @ left.T + K @ R @ K.T, y @ np.linalg.solve(S, y)


def sigma_points(s, P, spread):
    root = np.linalg.cholesky(P * spread)
    points = np.vstack([s, s + root.T, s - root.T])
    weights = np.full(len(points), 0.5 / spread)
    weights[0] = 1 - len(s) / spread
    return points, weights


def ukf_step(model, s, P, dt, z, R, strengths, pose, lever, chosen, spread, reach):
    """The same by sigma points, drawn anew after the prediction."""
    f = MODELS[model]
    points, weights = sigma_points(s, P, reach)
    moved = np.array([f(point, dt) for point in points])
    mean = weights @ moved
    apart = moved - mean
    P = (weights * apart.T) @ apart + noise(model, s, dt, strengths)
    R = R + pose_noise(model, mean, pose, lever, chosen, spread)
    points, weights = sigma_points(mean, P, reach)
    images = np.array([measured(model, point, pose, lever, chosen) for point in points])
    off = np.array([difference(image, images[0], chosen) for image in images])
    shift = weights @ off
    apart = points - mean
    S = (weights * (off - shift).T) @ (off - shift) + R
    K = (weights * apart.T) @ (off - shift) @ np.linalg.inv(S)
    y = difference(z, images[0] + shift, chosen)
    return mean + K @ y, P - K @ S @ K.T, y @ np.linalg.solve(S, y)
