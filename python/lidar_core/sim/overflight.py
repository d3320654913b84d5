"""A drone with LiDAR and radar above a target on the ground: measurements and ground truth.

Both sensors swivel so that their plane meets the target, and report the angle.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from lidar_core.config import Config
from lidar_core.io.tables.long_table import write_long_table

COLUMNS: dict[str, type] = {
    "t_ns": int,
    **dict.fromkeys(
        (
            "x",
            "y",
            "z",
            "vx",
            "vy",
            "vz",
            "drone_x",
            "drone_y",
            "drone_z",
            "drone_yaw",
            "drone_pitch",
        ),
        float,
    ),
}


YAW_PERIOD = 8.0
"""Period of the drone's yaw [s]."""
RATE = 20.0
"""Measurements per second [Hz]; LiDAR and radar measure alternately."""
PITCH_PERIOD = 3.0
"""Period of the drone's pitch [s]."""
TURN_PERIOD = 12.0
"""Period of the target's turns [s]."""
Std = Annotated[float, Field(ge=0, le=100)]
NonNegative = Annotated[float, Field(ge=0, le=3.2)]


class Overflight(Config):
    """A drone that flies straight on, with periodic yaw and pitch, above a target on level ground.

    The target starts ahead of the drone by 4/3 of `height`. The default speeds and height fit a
    walking person. Source: Remote Sens. 2023, 15, 3396, Figs 3-5.
    """

    removed: ClassVar[Mapping[str, str]] = {
        "yaw_period": "turns repeat after 8 s",
        "pitch_period": "pitch has a period of 3 s",
        "target_turn_period": "turns of the target repeat after 12 s",
        "rate": "there are 20 rows per second",
        "target_start": "the target starts ahead of the drone by 4/3 of `height`",
        "swivel_std": "`angle_std` has it, and then that of the pitch",
        "pitch_std": "`angle_std` has it after that of the swivel",
    }
    seconds: float = Field(default=30.0, gt=0, le=3600, description="Duration [s].")
    height: float = Field(
        default=6.0, gt=0, le=1000, description="Height of the sensors above the target [m]."
    )
    speed: float = Field(default=1.2, ge=0, le=100, description="Speed of the drone along x [m/s].")
    yaw_rate: float = Field(
        default=0.5, ge=0, le=10, description="Largest yaw rate of the drone [rad/s]."
    )
    pitch_deg: float = Field(
        default=5.0, ge=0, le=45, description="Largest pitch of the drone [deg]."
    )
    target_speed: float = Field(default=1.4, ge=0, le=100, description="Speed of the target [m/s].")
    target_turn_rate: float = Field(
        default=0.3, ge=0, le=10, description="Largest turn rate of the target [rad/s]."
    )
    lidar_std: float = Field(
        default=0.05,
        ge=0,
        le=10,
        description="Standard deviation of x and y in the LiDAR's plane [m].",
    )
    radar_std: tuple[Std, Std, Std] = Field(
        default=(0.2, 0.02, 0.15),
        description="Standard deviations of range [m], bearing [rad] and range rate [m/s] of the"
        " radar.",
    )
    angle_std: tuple[NonNegative, NonNegative] = Field(
        default=(0.01, 0.005),
        description="Standard deviations of the measured angles of swivel and pitch [rad].",
    )
    gyro_std: float = Field(
        default=0.01,
        ge=0,
        le=10,
        description="Standard deviation of the measured turn rate [rad/s].",
    )


@dataclass(frozen=True, slots=True)
class Overflown:
    """Measurements and ground truth; one row per measurement.

    Attributes
    ----------
    stamps_ns : ndarray, shape (K,), int64
        Times [ns].
    is_lidar : ndarray, shape (K,), bool
        True for rows of the LiDAR, false for rows of the radar.
    values : ndarray, shape (K, 3)
        LiDAR rows: x and y in the swivelled plane [m], then zero. Radar rows: range [m],
        bearing in that plane [rad], range rate [m/s].
    swivel, pitch : ndarray, shape (K,)
        Measured angles [rad]: of the sensor plane above the plane of the drone's body, and of the
        pitch of the body, positive with the nose down.
    gyro : ndarray, shape (K,)
        Measured turn rate [rad/s].
    drone : ndarray, shape (K, 3)
        True position of the sensors, world [m].
    yaw, yaw_rate : ndarray, shape (K,)
        True heading [rad] and turn rate [rad/s].
    drone_velocity : ndarray, shape (K, 3)
        True velocity of the drone in the world [m/s].
    true_pitch : ndarray, shape (K,)
        True pitch of the body, positive with the nose down [rad].
    position, velocity : ndarray, shape (K, 3)
        True position [m] and velocity [m/s] of the target in the world.
    config : Overflight
        Configuration of the simulation.
    """

    stamps_ns: NDArray[np.int64]
    is_lidar: NDArray[np.bool_]
    values: NDArray[np.float64]
    swivel: NDArray[np.float64]
    pitch: NDArray[np.float64]
    gyro: NDArray[np.float64]
    drone: NDArray[np.float64]
    yaw: NDArray[np.float64]
    yaw_rate: NDArray[np.float64]
    drone_velocity: NDArray[np.float64]
    true_pitch: NDArray[np.float64]
    position: NDArray[np.float64]
    velocity: NDArray[np.float64]
    config: Overflight

    def write_truth(self, path: str | Path) -> None:
        """Write true states of target and drone as CSV, in the world: t_ns, m, m/s, rad."""
        angles = np.stack([self.yaw, self.true_pitch], axis=1)
        rows = np.hstack([self.position, self.velocity, self.drone, angles]).tolist()
        stamps = self.stamps_ns.tolist()
        write_long_table(
            path, COLUMNS, [[stamp, *row] for stamp, row in zip(stamps, rows, strict=True)]
        )


def overfly(config: Overflight, *, seed: int) -> Overflown:
    """Simulate LiDAR and radar of a drone above a target.

    Parameters
    ----------
    config : Overflight
    seed : int
        Seed of all measurement errors, >= 0.

    Returns
    -------
    Overflown

    Examples
    --------
    >>> made = overfly(Overflight(seconds=1.0), seed=0)
    >>> made.values.shape, made.position[0].tolist()
    ((20, 3), [8.0, 0.0, 0.0])
    """
    rng = np.random.default_rng([20230703, seed])
    seconds = np.arange(max(2, round(config.seconds * RATE))) / RATE
    swings = 2 * np.pi / YAW_PERIOD
    yaw = config.yaw_rate / swings * np.sin(swings * seconds)
    yaw_rate = config.yaw_rate * np.cos(swings * seconds)
    pitch = np.deg2rad(config.pitch_deg) * np.sin(2 * np.pi * seconds / PITCH_PERIOD)
    position, velocity = _walk(config, seconds)
    own = np.array([config.speed, 0.0, 0.0])
    drone = seconds[:, None] * own + np.array([0.0, 0.0, config.height])
    polar, swivel = _swivel(position - drone, velocity - own, yaw, pitch)
    is_lidar = np.asarray(np.arange(len(seconds)) % 2 == 0)
    return Overflown(
        stamps_ns=np.round(seconds * 1e9).astype(np.int64),
        is_lidar=is_lidar,
        values=_measure(polar, is_lidar, config, rng),
        swivel=swivel + config.angle_std[0] * rng.normal(size=len(yaw)),
        pitch=pitch + config.angle_std[1] * rng.normal(size=len(yaw)),
        gyro=yaw_rate + config.gyro_std * rng.normal(size=len(yaw)),
        drone=drone,
        yaw=yaw,
        yaw_rate=yaw_rate,
        drone_velocity=np.tile(own, (len(yaw), 1)),
        true_pitch=pitch,
        position=position,
        velocity=velocity,
        config=config,
    )


def _walk(
    config: Overflight, seconds: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Position [m] and velocity [m/s] (K, 3) of the target, on arcs between measurements."""
    swings = 2 * np.pi / TURN_PERIOD
    heading = config.target_turn_rate / swings * np.sin(swings * seconds)
    flat = np.stack([np.cos(heading), np.sin(heading), 0 * heading], axis=1)
    turns = np.diff(heading)
    middle = heading[:-1] + turns / 2
    chords = config.target_speed / RATE * np.sinc(turns / 2 / np.pi)
    steps = chords[:, None] * np.stack([np.cos(middle), np.sin(middle), 0 * middle], axis=1)
    start = np.array([[4 * config.height / 3, 0.0, 0.0]])
    return np.cumsum(np.vstack([start, steps]), axis=0), config.target_speed * flat


def _swivel(
    sight: NDArray[np.float64],
    relative: NDArray[np.float64],
    yaw: NDArray[np.float64],
    pitch: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Range [m], bearing [rad], range rate [m/s] (K, 3) in the swivelled plane; its angle [rad]."""
    c, s, cp, sp = np.cos(yaw), np.sin(yaw), np.cos(pitch), np.sin(pitch)
    x, y, z = c * sight[:, 0] + s * sight[:, 1], c * sight[:, 1] - s * sight[:, 0], sight[:, 2]
    ahead, up = cp * x - sp * z, sp * x + cp * z
    far = np.linalg.norm(sight, axis=1)
    rate = (sight * relative).sum(axis=1) / far
    return np.stack([far, np.arctan2(y, ahead), rate], axis=1), np.arcsin(up / far)


def _measure(
    polar: NDArray[np.float64], is_lidar: NDArray[np.bool_], config: Overflight, rng: Any
) -> NDArray[np.float64]:
    far, bearing, _ = polar.T
    radar = polar + rng.normal(size=polar.shape) * config.radar_std
    lidar = np.stack([far * np.cos(bearing), far * np.sin(bearing), 0 * far], axis=1)
    lidar[:, :2] += config.lidar_std * rng.normal(size=(len(far), 2))
    return np.where(is_lidar[:, None], lidar, radar)
