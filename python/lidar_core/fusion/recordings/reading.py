"""Reader of the L/R text format: LiDAR positions and radar rows with the truth beside them."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lidar_core.errors import FormatError
from lidar_core.fusion.measurement import Measurement
from lidar_core.fusion.recordings.folders import check_sizes
from lidar_core.io.files.guard import reading

SENSORS = {"L": ("lidar", 2), "R": ("radar", 3)}
TRUTH_COLUMNS = (4, 6)
"""x, y, vx, vy; or these with yaw and yaw rate."""


@dataclass(frozen=True, slots=True)
class TargetTruth:
    """True states of a target, one row per measurement.

    Attributes
    ----------
    stamps_ns : ndarray, shape (K,), int64
        Times [ns].
    position, velocity : ndarray, shape (K, 2)
        Frame of the sensor [m], [m/s]; velocities are NaN if the file does not contain them.
    heading, turn_rate : ndarray, shape (K,), or None
        Heading [rad] and turn rate [rad/s]; None if the file does not contain them.
    """

    stamps_ns: NDArray[np.int64]
    position: NDArray[np.float64]
    velocity: NDArray[np.float64]
    heading: NDArray[np.float64] | None
    turn_rate: NDArray[np.float64] | None

    def rows(self, chosen: NDArray[np.int64]) -> "TargetTruth":
        """Return the rows with these indices, in this order."""
        return TargetTruth(
            self.stamps_ns[chosen],
            self.position[chosen],
            self.velocity[chosen],
            None if self.heading is None else self.heading[chosen],
            None if self.turn_rate is None else self.turn_rate[chosen],
        )


@dataclass(frozen=True, slots=True)
class TargetRecording:
    """Measurements of one target, and the truth.

    Attributes
    ----------
    measurements : list of Measurement
        In the order of the file.
    truth : TargetTruth
    """

    measurements: list[Measurement]
    truth: TargetTruth


def read_laser_radar(path: str | Path) -> TargetRecording:
    """Read a text file whose rows start with L or R.

    L rows hold x, y; R rows range, bearing, range rate; both then a stamp in microseconds, true
    x, y, vx, vy and, in some files, true yaw and yaw rate. Rows of zeros are kept: a filter
    refuses a range of zero.

    Parameters
    ----------
    path : str or Path
        Tab or space separated, at most 256 MiB.

    Returns
    -------
    TargetRecording

    Raises
    ------
    FormatError
        A row has none of these forms; the text names file and line.
    LimitError
        The file is too large.
    """
    place = Path(path)
    check_sizes(place, [place], what="a file")
    with reading(str(place)):
        lines = place.read_text("utf-8").splitlines()
    rows = [_row(place, n, line.split()) for n, line in enumerate(lines, 1) if line.strip()]
    if not rows:
        raise FormatError(f"{place}: no rows in this file")
    truths = [truth for _, truth in rows]
    if len(set(map(len, truths))) > 1:
        raise FormatError(f"{place}: expected the same true values in every row")
    return TargetRecording([m for m, _ in rows], _truth([m.stamp_ns for m, _ in rows], truths))


def _row(place: Path, line: int, fields: list[str]) -> tuple[Measurement, list[float]]:
    sensor, count = SENSORS.get(fields[0], (None, 0))
    allowed = [2 + count + truth for truth in TRUTH_COLUMNS]
    if sensor is None or len(fields) not in allowed:
        raise FormatError(
            f"{place}, line {line}: expected L or R and, with it,"
            f" {' or '.join(map(str, allowed or [7, 8, 9, 10]))} fields, got {len(fields)}"
            f" starting with {fields[0]!r}"
        )
    try:
        values = [float(text) for text in fields[1 : 1 + count]]
        stamp_ns = int(fields[1 + count]) * 1000
        truth = [float(text) for text in fields[2 + count :]]
    except ValueError as error:
        raise FormatError(f"{place}, line {line}: expected numbers: {error}") from error
    return Measurement(stamp_ns, "lidar" if sensor == "lidar" else "radar", values), truth


def _truth(stamps_ns: list[int], rows: list[list[float]]) -> TargetTruth:
    values = np.array(rows)
    full = values.shape[1] == max(TRUTH_COLUMNS)
    return TargetTruth(
        stamps_ns=np.array(stamps_ns, np.int64),
        position=values[:, :2],
        velocity=values[:, 2:4],
        heading=values[:, 4] if full else None,
        turn_rate=values[:, 5] if full else None,
    )
