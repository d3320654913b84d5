"""Places that one target in metres cannot have: geographic ones, and those of several targets."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lidar_core.fusion.measurement import Measurement

LEAST = 20
"""Measurements that have to be compared before anything is said (count)."""
HEAD = 5000
"""Measurements among which causes are looked for (count)."""
FAR = 3.0
"""Places so many times further apart than usual belong to different targets."""
MAY_BE_FALSE = 0.2
"""Share of the measurements that may be false, or follow a dropout or an unexpected turn."""


def geographic_poses(measurements: Sequence[Measurement]) -> str | None:
    """Return a warning about poses of the platform that may be latitude and longitude.

    A target seen from a platform that seems to stand still also moves smoothly, so the NIS does not
    reveal the mistake. A platform that really stands still has such poses too, so they are not
    refused.
    """
    found = geographic(measurements[:HEAD], "pose", "poses of the platform")
    return found[0] if found else None


def geographic(measurements: Sequence[Measurement], sensor: str, what: str) -> list[str]:
    """Return a message if the positions of a sensor look like latitude and longitude; else none.

    They do if they lie within the ranges of both and keep their first three digits.
    """
    places = _places(measurements, sensor)
    if len(places) < LEAST:
        return []
    middle, spread = np.median(places, axis=0), np.ptp(places, axis=0)
    inside = np.sort(np.abs(places).max(axis=0)) <= (90.0, 180.0)
    # 0.05 degrees are 5 km; what stands still exactly is no recording of a position
    if inside.all() and 0 < spread.max() < 0.05 and spread.max() < 1e-3 * np.abs(middle).max():
        return [
            f"{what} stay within {spread.max():.2g} of {middle[0]:.6g}, {middle[1]:.6g}:"
            " latitude and longitude in degrees, which have to be metres"
        ]
    return []


def several(measurements: Sequence[Measurement]) -> list[str]:
    """Return a message if the positions of a sensor jump to and fro, as of several targets."""
    for sensor in ("lidar", "radar"):
        places = _places(measurements, sensor)
        if len(places) < LEAST:
            continue
        last = np.linalg.norm(places[1:] - places[:-1], axis=1)
        nearest = np.array(
            [
                np.linalg.norm(places[max(0, row - 9) : row] - places[row], axis=1).min()
                for row in range(1, len(places))
            ]
        )
        usual = float(np.median(nearest))
        jumps = (last > FAR * usual) & (nearest < last / FAR)
        # A false measurement makes one such jump, back; a fifth of them is more than may be false.
        if jumps.mean() > MAY_BE_FALSE:
            return [
                f"{100 * jumps.mean():.0f} % of the places of the {sensor} are far from the one"
                " before and near to an earlier one: several targets in one table"
            ]
    return []


def _places(measurements: Sequence[Measurement], sensor: str) -> NDArray[np.float64]:
    """Finite positions (K, 2) that a sensor measured [m]."""
    rows = [m for m in measurements if m.sensor == sensor and np.isfinite(m.values).all()]
    if sensor == "radar":
        rows = [m for m in rows if (m.measures or ())[:2] == ("range", "bearing")]
    values = np.array([m.values[:2] for m in rows], np.float64).reshape(-1, 2)
    if sensor == "radar":
        c, s = np.cos(values[:, 1]), np.sin(values[:, 1])
        values = values[:, :1] * np.stack([c, s], axis=1)
    return values
