"""Conventions of tables: directions of angles, places on the Earth, times as text."""

from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from lidar_core.errors import FormatError
from lidar_core.fusion.measurement import SensorName
from lidar_core.io.tables.columns import at_row

Azimuth: TypeAlias = Literal["clockwise", "compass"]
"""How angles count that are not counter-clockwise from x: clockwise from x, or from north (y)."""
Turned: TypeAlias = Literal["bearing", "pose_yaw", "turn_rate", "lidar"]
"""What may count otherwise; lidar stands for x and y of a LiDAR."""
A_TIME = "a time (a number, or ISO 8601 such as 2026-11-26T08:00:00Z)"
"""What cells of times hold, for errors."""
SEMI_MAJOR, FLATTENING = 6378137.0, 1 / 298.257223563
"""Of the ellipsoid of WGS84: [m], and no unit."""
WORDS: dict[str, SensorName] = {
    "lidar": "lidar",
    "laser": "lidar",
    "l": "lidar",
    "radar": "radar",
    "r": "radar",
    "gyro": "gyro",
    "imu": "gyro",
    "pose": "pose",
    "odometry": "pose",
}
"""What a column of sensors may say, in any case."""


def turned(values: NDArray[np.float64], azimuth: Azimuth | None) -> NDArray[np.float64]:
    """Convert angles [rad] of another convention into angles counter-clockwise from x [rad].

    Examples
    --------
    >>> turned(np.array([np.pi / 2]), "compass").tolist()
    [0.0]
    """
    if azimuth is None:
        return values
    return -values if azimuth == "clockwise" else np.pi / 2 - values


def earth_fixed(
    latitude: NDArray[np.float64], longitude: NDArray[np.float64], altitude: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Convert coordinates on WGS84 [deg], [m] to Earth-centred Cartesian ones (K, 3) [m]."""
    phi, lam = np.deg2rad(latitude), np.deg2rad(longitude)
    square = FLATTENING * (2 - FLATTENING)
    across = SEMI_MAJOR / np.sqrt(1 - square * np.sin(phi) ** 2)
    flat = (across + altitude) * np.cos(phi)
    up = (across * (1 - square) + altitude) * np.sin(phi)
    return np.stack([flat * np.cos(lam), flat * np.sin(lam), up], axis=1)


def local_places(
    latitude: NDArray[np.float64],
    longitude: NDArray[np.float64],
    altitude: NDArray[np.float64],
    origin: tuple[float, float, float],
) -> NDArray[np.float64]:
    """Convert coordinates on WGS84 to east, north, up (K, 3) [m] from `origin` [deg, deg, m].

    Examples
    --------
    >>> east = local_places(*(np.array([v]) for v in (59.0, 10.001, 0.0)), (59.0, 10.0, 0.0))
    >>> east.round(1).tolist()
    [[57.5, 0.0, -0.0]]
    """
    phi, lam, _ = np.deg2rad(origin)
    (cp, cl), (sp, sl) = np.cos([phi, lam]), np.sin([phi, lam])
    axes = np.array([[-sl, cl, 0.0], [-sp * cl, -sp * sl, cp], [cp * cl, cp * sl, sp]])
    start = earth_fixed(*(np.array([value]) for value in origin))
    places: NDArray[np.float64] = (earth_fixed(latitude, longitude, altitude) - start) @ axes.T
    return places


def stamps_of_texts(texts: NDArray[np.str_], where: str) -> NDArray[np.int64] | None:
    """Return times [ns] since 1970 of ISO 8601 texts, UTC without a zone; None for other texts.

    Raises
    ------
    FormatError
        The first text is such a time, and another one is not.

    Examples
    --------
    >>> stamps_of_texts(np.array(["1970-01-01T00:00:01.5Z"]), "table").tolist()
    [1500000000]
    """
    from datetime import UTC, datetime

    found: list[int] = []
    for row, text in enumerate(texts.tolist()):
        try:
            time = datetime.fromisoformat(text)
        except ValueError as error:
            if not found:
                return None
            raise FormatError(
                f"{at_row(where, row)}: column t_ns: expected {A_TIME}, got {text!r}"
            ) from error
        aware = time if time.tzinfo else time.replace(tzinfo=UTC)
        since = aware - datetime(1970, 1, 1, tzinfo=UTC)
        found.append((since.days * 86_400 + since.seconds) * 10**9 + since.microseconds * 1000)
    return np.array(found, np.int64)
