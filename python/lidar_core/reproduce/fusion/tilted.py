"""The flights of `fusion-fig4` in space: a drone that also rolls and climbs, and a level one."""

import numpy as np
from numpy.typing import NDArray

from lidar_core.fusion import FusionConfig, Measurement, run
from lidar_core.sim import Overflown

ROLL, ROLL_PERIOD = 0.2, 4.0
"""Greatest roll [rad], and its period [s]."""
CLIMB, CLIMB_PERIOD = 1.0, 6.0
"""Greatest climb [m/s], up and down, and its period [s]."""
ARM = (0.2, 0.0, 0.0)
"""From the drone's origin to the sensors, its axes [m]."""


def config_in_space(*, tilted: bool) -> FusionConfig:
    """Default configuration in space; the sensors of a tilted drone are off its origin."""
    return FusionConfig(model="ctrv-3d", lever_arm=ARM if tilted else (0.0, 0.0, 0.0))


def follow_in_space(
    made: Overflown, *, tilted: bool, seed: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Errors (K, 3) [m] of a filter in space and their covariances (K, 3, 3).

    Range and angles are measured in the axes of the drone: the elevation is the angle of the
    swivel. Roll and pitch are known as well as the pitch of the flight.
    """
    poses, seen = _measured(made, tilted=tilted, rng=np.random.default_rng([20261126, seed]))
    both = [one for pair in zip(poses, seen, strict=True) for one in pair]
    found = run(both, config_in_space(tilted=tilted))
    return found.states[1::2, :3] - made.position, found.covariances[1::2, :3, :3]


def _measured(
    made: Overflown, *, tilted: bool, rng: np.random.Generator
) -> tuple[list[Measurement], list[Measurement]]:
    config = made.config
    attitude, body, drone, own = _motion(made, tilted=tilted)
    R, arm = _rotations(attitude), np.array(ARM) * tilted
    into = np.swapaxes(R, 1, 2)
    place = (into @ (made.position - drone)[:, :, None])[..., 0] - arm
    speed = (into @ (made.velocity - own)[:, :, None])[..., 0] - np.cross(body, arm)
    far, flat = np.linalg.norm(place, axis=1), np.hypot(place[:, 0], place[:, 1])
    polar = np.stack(
        [
            far,
            np.arctan2(place[:, 1], place[:, 0]),
            np.arctan2(place[:, 2], flat),
            (place * speed).sum(axis=1) / far,
        ],
        axis=1,
    )
    stds = _stds(made, far)
    polar += rng.normal(size=polar.shape) * stds
    known = attitude + rng.normal(size=attitude.shape) * [
        config.angle_std[1],
        config.angle_std[1],
        0,
    ]
    gyro = body + rng.normal(size=body.shape) * config.gyro_std
    spread = np.diag(
        [1e-12, 1e-12, 1e-12, config.angle_std[1] ** 2, config.angle_std[1] ** 2, 1e-12]
    )
    told = np.hstack([drone, known, own, gyro])
    stamps = made.stamps_ns.tolist()
    poses = [Measurement(t, "pose-3d", row, spread) for t, row in zip(stamps, told, strict=True)]
    rows = zip(stamps, polar, stds, made.is_lidar.tolist(), strict=True)
    return poses, [_sensed(*row) for row in rows]


def _motion(made: Overflown, *, tilted: bool) -> tuple[NDArray[np.float64], ...]:
    """Return attitude, turn rates about the body's axes, position and velocity of the drone."""
    seconds = (made.stamps_ns * 1e-9).astype(np.float64)
    roll, roll_rate = _swing(seconds, ROLL * tilted, ROLL_PERIOD)
    climb = CLIMB * tilted * np.cos(2 * np.pi / CLIMB_PERIOD * seconds)
    height, _ = _swing(seconds, CLIMB * tilted * CLIMB_PERIOD / (2 * np.pi), CLIMB_PERIOD)
    attitude = np.stack([roll, made.true_pitch, made.yaw], axis=1)
    rates = np.stack([roll_rate, np.gradient(made.true_pitch, seconds), made.yaw_rate], axis=1)
    body = _body_rates(attitude, rates)
    up = np.array([0.0, 0.0, 1.0])
    drone = made.drone + height[:, None] * up
    own = made.drone_velocity + climb[:, None] * up
    return attitude, body, drone, own


def _sensed(
    stamp_ns: int, polar: NDArray[np.float64], stds: NDArray[np.float64], is_lidar: bool
) -> Measurement:
    if not is_lidar:
        return Measurement(stamp_ns, "radar", polar, np.diag(stds**2))
    far, (c, s), (ce, se) = polar[0], *((np.cos(a), np.sin(a)) for a in polar[1:3])
    T = np.array([[c * ce, -far * s * ce, -far * c * se], [s * ce, far * c * ce, -far * s * se]])
    T = np.vstack([T, [se, 0.0, far * ce]])
    place = far * np.array([c * ce, s * ce, se])
    return Measurement(stamp_ns, "lidar", place, T @ np.diag(stds[:3] ** 2) @ T.T)


def _stds(made: Overflown, far: NDArray[np.float64]) -> NDArray[np.float64]:
    """Standard deviations of range [m], bearing, elevation [rad] and range rate [m/s], (K, 4).

    That of a range rate of the LiDAR has no meaning.
    """
    config, swivel = made.config, np.full(len(far), made.config.angle_std[0])
    level = np.full(len(far), config.lidar_std)
    lidar = np.stack([level, level / far, swivel, level], axis=1)
    far_std, bearing_std, rate_std = (np.full(len(far), value) for value in config.radar_std)
    radar = np.stack([far_std, bearing_std, swivel, rate_std], axis=1)
    return np.where(made.is_lidar[:, None], lidar, radar)


def _swing(
    seconds: NDArray[np.float64], most: float, period: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Value and rate of a sine with amplitude `most` and `period` [s] at the times `seconds`."""
    turns = 2 * np.pi / period
    return most * np.sin(turns * seconds), most * turns * np.cos(turns * seconds)


def _body_rates(attitude: NDArray[np.float64], rates: NDArray[np.float64]) -> NDArray[np.float64]:
    """Convert rates of roll, pitch and yaw into turn rates about the axes of the body [rad/s]."""
    (cr, cp, _), (sr, sp, _) = np.cos(attitude).T, np.sin(attitude).T
    roll, pitch, yaw = rates.T
    return np.stack(
        [roll - yaw * sp, pitch * cr + yaw * cp * sr, yaw * cp * cr - pitch * sr], axis=1
    )


def _rotations(attitude: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rotations from body axes to world axes, (K, 3, 3): yaw, then pitch, then roll."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(attitude).T, np.sin(attitude).T
    rows = [
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ]
    return np.moveaxis(np.array(rows), 2, 0)
