"""Measurements from ROS recordings: radar tracks and scans, positions, poses, turn rates."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from lidar_core.config import Config, as_config
from lidar_core.errors import ConfigError, FormatError
from lidar_core.fusion.measurement import Measurement, SensorName
from lidar_core.fusion.recordings.autoferry import DetectionScan
from lidar_core.fusion.recordings.mountings import Mountings
from lidar_core.fusion.recordings.radar_tracks import definite, radar_of_track
from lidar_core.io.files.guard import reading
from lidar_core.io.messages.ros import (
    IMU_TYPE,
    POINT_TYPE,
    POSE_TYPES,
    matrix_of,
    ros_name,
    stamp_of,
)
from lidar_core.io.messages.ros_types import OBJECTS_TYPES, RADAR_SCAN_TYPE, RADAR_TRACKS_TYPE
from lidar_core.io.opening import open_recording
from lidar_core.io.records import Topic

KINDS = frozenset({"measurement", "pose"})
TYPES: dict[SensorName, tuple[str, ...]] = {
    "lidar": (POINT_TYPE, *OBJECTS_TYPES, *POSE_TYPES[1:]),
    "radar": (RADAR_TRACKS_TYPE, RADAR_SCAN_TYPE),
    "gyro": (IMU_TYPE,),
    "pose": POSE_TYPES,
}
"""What each sensor may speak; poses without a twist may be a LiDAR's positions, if named so."""
BY_ITSELF: dict[SensorName, tuple[str, ...]] = {**TYPES, "lidar": (POINT_TYPE, *OBJECTS_TYPES)}
READABLE = "; ".join(
    f"{sensor}: {', '.join(one.replace('/msg/', '/') for one in types)}"
    for sensor, types in TYPES.items()
)
SEEN = 1  # state of an object that is seen; of others the place is a guess
STEEPEST = 1e-3  # least cosine of the elevation of a radar's return

Found: TypeAlias = list[Measurement]
Turn: TypeAlias = NDArray[np.float64] | None
"""Rotation (3, 3) from the axes of a sensor to those of the platform."""


class BagOptions(Config):
    """Topics of a ROS recording that contain measurements, by sensor."""

    topics: dict[SensorName, tuple[str, ...]] = Field(
        default={},
        description="Topics of `lidar`, `radar`, `gyro` or `pose` (no unit); of sensors that are"
        " not named, those whose type says so: PointStamped and ObjectsStamped; RadarTracks and"
        " RadarScan; Imu; and Odometry, PoseStamped or PoseWithCovarianceStamped, if it is one"
        " topic.",
    )
    doppler: Literal["receding", "approaching"] = Field(
        default="receding",
        description="Targets whose doppler_velocity is positive in a RadarScan, whose definition"
        " does not say (no unit).",
    )


def read_bag(path: str | Path, options: BagOptions | None = None) -> list[DetectionScan]:
    """Read measurements of LiDAR and radar, and the motion of the platform, from a ROS recording.

    Parameters
    ----------
    path : str or Path
        ROS 1 bag, ROS 2 folder, .db3 or .mcap with ROS messages.
    options : BagOptions, optional

    Returns
    -------
    scans : list of DetectionScan
        One per message, by the stamps in their headers; `source` is the topic. Places are in the
        axes of the platform, from the sensor: static transforms (/tf_static) turn what sensors
        see. Where they do not place a sensor, it is taken to look along the platform's axes.

    Raises
    ------
    FormatError
        The recording does not exist, has no such message, or a broken one.
    ConfigError
        A topic that is not there or has another type; or several topics with poses, none named.

    Notes
    -----
    A radar's track gives range, bearing and range rate of its position and velocity, which are
    relative to the radar, with their covariance, if it has one. Such tracks are filtered already:
    their errors are correlated over time, so covariances of filters on them are too small.
    Elevated returns are levelled, as if target and radar kept their heights. Objects of a camera
    are positions like those of a LiDAR, with their covariance, if they have one; they are filtered,
    too. Those that the camera tracks and does not see at the moment are left out.
    """
    chosen, place = as_config(options, BagOptions), Path(path)
    with open_recording(place) as recording:
        sensors = _sensors(place, recording.topics(), chosen)
        mountings = Mountings.of(recording)
        scans = [
            DetectionScan(stamp, record.topic.name, found, np.zeros(2), {})
            for number, record in enumerate(recording.records(KINDS))
            if record.topic.name in sensors and record.parse is not None
            for stamp, found in _read(
                record.parse(),
                sensors[record.topic.name],
                record.topic,
                f"{place}, message {number}",
                chosen,
                mountings,
            )
        ]
        if not scans:
            listed = ", ".join(f"{t.name} ({t.type})" for t in recording.topics()) or "none"
            raise FormatError(
                f"{place}: no measurements in it; topics: {listed}. Messages that are read:"
                f" {READABLE}"
            )
    return sorted(scans, key=lambda scan: scan.stamp_ns)


def _sensors(place: Path, topics: Sequence[Topic], options: BagOptions) -> dict[str, SensorName]:
    """Sensor of every topic that is read."""
    types = {topic.name: ros_name(topic.type) for topic in topics}
    found: dict[str, SensorName] = {}
    for sensor, names in options.topics.items():
        for name in names:
            if types.get(name) not in TYPES[sensor]:
                raise ConfigError(
                    f"{place}: topics: {sensor}: {name!r} is"
                    f" {types.get(name, 'not there')}, expected {', '.join(TYPES[sensor])}"
                )
            found[name] = sensor
    for sensor in set(BY_ITSELF) - set(options.topics):
        fitting = [n for n, t in types.items() if t in BY_ITSELF[sensor] and n not in found]
        if sensor == "pose" and len(fitting) > 1:
            raise ConfigError(
                f"{place}: topics: several hold poses, {', '.join(sorted(fitting))};"
                ' choose that of the platform with topics={"pose": ["NAME"]}'
            )
        found |= dict.fromkeys(fitting, sensor)
    return found


def _read(
    message: Any,
    sensor: SensorName,
    topic: Topic,
    place: str,
    options: BagOptions,
    mountings: Mountings,
) -> Iterator[tuple[int, Found]]:
    """Yield stamp and measurements of a message; errors name its place."""
    with reading(f"{place} on {topic.name}"):
        stamp = stamp_of(message.header.stamp)
        turn = mountings.rotation(message.header.frame_id)
        if sensor == "pose":
            found = _pose(stamp, message, place)
        elif sensor == "gyro":
            found = _turn_rate(stamp, message, turn)
        elif sensor == "lidar" and hasattr(message, "objects"):
            found = _objects(stamp, message, turn)
        elif sensor == "lidar":
            found = _positions(stamp, message, place, turn)
        elif hasattr(message, "tracks"):
            found = _tracks(stamp, message, turn)
        else:
            found = _returns(stamp, message, options.doppler, turn)
        yield stamp, found


def _tracks(stamp: int, message: Any, turn: Turn) -> Found:
    found = []
    for track in message.tracks:
        p, v = _axes(track.position, turn), _axes(track.velocity, turn)
        spreads = [
            _planar(upper, turn) for upper in (track.position_covariance, track.velocity_covariance)
        ]
        found.append(radar_of_track(stamp, p[:2], v[:2], *spreads))
    return [one for one in found if one is not None]


def _objects(stamp: int, message: Any, turn: Turn) -> Found:
    found = []
    for item in message.objects:
        at = np.array(item.position, np.float64)
        is_seen = not item.tracking_available or item.tracking_state == SEEN
        if is_seen and np.isfinite(at).all():
            at = at if turn is None else turn @ at
            known = definite(_planar(item.position_covariance, turn))
            found.append(Measurement(stamp, "lidar", at[:2], known))
    return found


def _axes(vector: Any, turn: Turn) -> NDArray[np.float64]:
    """Rotate a vector (3,) of a message into the axes of the platform."""
    own = np.array([vector.x, vector.y, vector.z], np.float64)
    return own if turn is None else turn @ own


def _planar(upper: Any, turn: Turn) -> NDArray[np.float64]:
    """Covariance of x and y from the upper triangle of a covariance of three axes."""
    whole = np.array([upper[k] for k in (0, 1, 2, 1, 3, 4, 2, 4, 5)], np.float64).reshape(3, 3)
    if turn is not None:
        whole = turn @ whole @ turn.T
    planar: NDArray[np.float64] = whole[:2, :2]
    return planar


def _returns(stamp: int, message: Any, doppler: str, turn: Turn) -> Found:
    sign = 1.0 if doppler == "receding" else -1.0
    found = []
    for item in message.returns:
        azimuth, elevation = float(item.azimuth), float(item.elevation)
        if turn is not None:
            flat = np.cos(elevation)
            seen = [flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)]
            x, y, z = turn @ np.array(seen)
            azimuth, elevation = float(np.arctan2(y, x)), float(np.arctan2(z, np.hypot(x, y)))
        level = max(float(np.cos(elevation)), STEEPEST)
        values = [item.range * level, azimuth, sign * item.doppler_velocity / level]
        found.append(Measurement(stamp, "radar", values))
    return found


def _positions(stamp: int, message: Any, place: str, turn: Turn) -> Found:
    if hasattr(message, "point"):
        return [Measurement(stamp, "lidar", _axes(message.point, turn)[:2])]
    matrix, covariance = matrix_of(message, place)
    at, spread = matrix[:3, 3], None if covariance is None else covariance[:3, :3]
    if turn is not None:
        at, spread = turn @ at, None if spread is None else turn @ spread @ turn.T
    known = None if spread is None else definite(spread[:2, :2])
    return [Measurement(stamp, "lidar", at[:2], known)]


def _turn_rate(stamp: int, message: Any, turn: Turn) -> Found:
    """Measurement of the turn rate about the vertical [rad/s] from a message of an IMU.

    It uses the orientation in the message, else the mounting `turn`, else the z axis as it is.
    """
    rates, q = message.angular_velocity, message.orientation
    rate, variance = float(rates.z), float(message.angular_velocity_covariance[8])
    norm = float(np.linalg.norm([q.x, q.y, q.z, q.w]))
    if message.orientation_covariance[0] != -1 and abs(norm - 1) < 0.1:
        roll = np.arctan2(2 * (q.w * q.x + q.y * q.z), 1 - 2 * (q.x**2 + q.y**2))
        pitch = np.arcsin(np.clip(2 * (q.w * q.y - q.z * q.x), -1, 1))
        level = max(float(np.cos(pitch)), STEEPEST)
        rate = float(rates.y * np.sin(roll) + rates.z * np.cos(roll)) / level
    elif turn is not None:
        rate = float(_axes(rates, turn)[2])
    known = [[variance]] if np.isfinite(variance) and variance > 0 else None
    return [Measurement(stamp, "gyro", [rate], known)]


def _pose(stamp: int, message: Any, place: str) -> Found:
    """Measurement of a pose, with velocity in the world and turn rate if a twist states them."""
    matrix, covariance = matrix_of(message, place)
    yaw = float(np.arctan2(matrix[1, 0], matrix[0, 0]))
    values = [*matrix[:2, 3].tolist(), yaw]
    if hasattr(message, "twist"):
        linear, turning = message.twist.twist.linear, message.twist.twist.angular
        twist = np.array([linear.x, linear.y, linear.z, turning.z], np.float64)
        if twist.any():  # many drivers leave it zero
            values += [*(matrix[:2, :3] @ twist[:3]).tolist(), float(twist[3])]
    known = None
    if covariance is not None:
        known = definite(covariance[np.ix_([0, 1, 5], [0, 1, 5])])
    return [Measurement(stamp, "pose", values, known)]
