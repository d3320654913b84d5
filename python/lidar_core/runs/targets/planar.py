"""Targets in the plane as MCAP, for viewers, and as columns of tables."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_core.fusion import Measurement
from lidar_core.io import McapWriter
from lidar_core.io.poses.posed import WORLD_FRAME
from lidar_core.messages import Pose, Scan
from lidar_core.objects import Boxes
from lidar_core.run_folder import RunFolder
from lidar_core.runs.result import MCAP

SENSOR_FRAME, MEASUREMENTS_TOPIC = "sensor", "/measurements"
YAWS = {"pose": 2, "pose-3d": 5}
"""Place of the yaw among the values of a pose."""


@dataclass(frozen=True, slots=True)
class PlanarStep:
    """Measurements and tracks at one time, in the plane.

    Attributes
    ----------
    stamp_ns : int
        Time [ns].
    places : ndarray, shape (M, 2)
        Measured positions in the frame of the sensor [m].
    sensor : ndarray, shape (3,)
        x, y [m] and yaw [rad] of the sensor in the world.
    id : ndarray, shape (T,), int64
        Numbers of the tracks.
    planar_position, planar_velocity : ndarray, shape (T, 2)
        Position [m] and velocity [m/s] in the plane.
    """

    stamp_ns: int
    places: NDArray[np.float64]
    sensor: NDArray[np.float64]
    id: NDArray[np.int64]
    planar_position: NDArray[np.float64]
    planar_velocity: NDArray[np.float64]

    @property
    def boxes(self) -> Boxes:
        """Return the tracks in space: unknown heights and extents are zero."""
        return Boxes(
            self.id,
            in_plane(self.planar_position),
            in_plane(self.planar_velocity),
            np.zeros((len(self.id), 3)),
            self.stamp_ns,
        )


def in_plane(rows: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return rows (K, 2) with a zero as third value; rows of three values do not change."""
    return np.pad(rows, ((0, 0), (0, 3 - rows.shape[1])))


def in_world(places: NDArray[np.float64], sensor: NDArray[np.float64]) -> NDArray[np.float64]:
    """Transform places (M, 2) [m] into the world from a sensor at x, y [m], yaw [rad]."""
    matrix = _matrix(sensor)
    found: NDArray[np.float64] = places @ matrix[:2, :2].T + sensor[:2]
    return found


def write_run_mcap(folder: RunFolder, steps: Iterable[PlanarStep]) -> str:
    """Write run.mcap with the sensor, measured places as clouds, and tracks; return its name."""
    with McapWriter(folder.path / MCAP, tracks_frame=WORLD_FRAME) as writer:
        for step in steps:
            writer.write(Pose(step.stamp_ns, WORLD_FRAME, SENSOR_FRAME, _matrix(step.sensor)))
            if len(step.places):
                points = in_plane(step.places).astype(np.float32)
                writer.write(Scan(step.stamp_ns, points, SENSOR_FRAME, topic=MEASUREMENTS_TOPIC))
            writer.write(step.boxes)
    return MCAP


def sensor_at(
    measurements: Sequence[Measurement], stamps: NDArray[np.int64], lever: tuple[float, ...]
) -> NDArray[np.float64]:
    """Sensor pose x, y [m], yaw [rad] (K, 3) by interpolation of the poses; zero without poses."""
    poses = [m for m in measurements if m.sensor in YAWS and np.isfinite(m.values).all()]
    if not poses:
        return np.zeros((len(stamps), 3))
    first = poses[0].stamp_ns
    times = np.array([m.stamp_ns - first for m in poses])
    x, y, yaw = np.array([m.values[[0, 1, YAWS[m.sensor]]] for m in poses]).T
    x, y, yaw = (np.interp(stamps - first, times, values) for values in (x, y, np.unwrap(yaw)))
    c, s = np.cos(yaw), np.sin(yaw)
    return np.stack([x + c * lever[0] - s * lever[1], y + s * lever[0] + c * lever[1], yaw], axis=1)


def _matrix(sensor: NDArray[np.float64]) -> NDArray[np.float64]:
    x, y, yaw = sensor
    matrix = np.eye(4)
    matrix[:2, :2] = [[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]]
    matrix[:2, 3] = x, y
    return matrix


def planar_table(
    number_name: str,
    stamps: NDArray[np.int64],
    position: NDArray[np.float64],
    velocity: NDArray[np.float64],
    numbers: NDArray[np.int64] | None = None,
) -> dict[str, Any]:
    """Return positions as columns that `lidar-core evaluate` reads; planar heights are zero."""
    zero = np.zeros((len(stamps), 1))
    (_, _, z), (_, _, vz) = (np.hstack([part, zero])[:, :3].T for part in (position, velocity))
    return {
        "t_ns": stamps,
        number_name: np.zeros(len(stamps), np.int64) if numbers is None else numbers,
        "x": position[:, 0],
        "y": position[:, 1],
        "z": z,
        "vx": velocity[:, 0],
        "vy": velocity[:, 1],
        "vz": vz,
    }


def planar_truth(
    stamps: NDArray[np.int64],
    position: NDArray[np.float64],
    velocity: NDArray[np.float64] | None = None,
    numbers: NDArray[np.int64] | None = None,
) -> dict[str, Any]:
    """Return true positions as columns, as `planar_table`; velocities only if they are known."""
    is_known = velocity is not None and bool(np.isfinite(velocity).all())
    stand_in = position if velocity is None else velocity
    table = planar_table("target_id", stamps, position, stand_in, numbers)
    return {name: column for name, column in table.items() if is_known or name[0] != "v"}
