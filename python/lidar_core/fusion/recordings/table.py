"""Measurements of one target from files: L/R text, or any table by a map of its columns."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from lidar_core.config import Config, as_config
from lidar_core.errors import FormatError, InputError
from lidar_core.fusion.measurement import Measurement, SensorName
from lidar_core.fusion.recordings.reading import TargetTruth, read_laser_radar
from lidar_core.io.tables.columns import Columns, read_columns

VALUES: dict[SensorName, tuple[str, ...]] = {
    "lidar": ("x", "y"),
    "radar": ("range", "bearing", "range_rate"),
    "gyro": ("turn_rate",),
    "pose": ("pose_x", "pose_y", "pose_yaw"),
}
POSE_STD = ("pose_std_x", "pose_std_y", "pose_std_yaw")
TRUTH = ("true_x", "true_y", "true_vx", "true_vy")
NAMES = (
    "t_ns",
    "sensor",
    *(name for names in VALUES.values() for name in names),
    *POSE_STD,
    *TRUTH,
)
"""Columns that a table may have."""
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
UNITS_NS = {"ns": 1, "us": 1000, "ms": 1_000_000, "s": 1_000_000_000}
TABLES = (".csv", ".npz", ".parquet")
MAX_SECONDS = 9e9


class TableOptions(Config):
    """How a table of measurements is to be read; not used for L/R text files."""

    columns: dict[str, str] = Field(
        {},
        description="Names of columns where they differ: ours to the table's (no unit). Ours are"
        f" {', '.join(NAMES)}.",
    )
    time_unit: Literal["ns", "us", "ms", "s"] = Field(
        "ns", description="Unit of the column of times (no unit of its own)."
    )
    angle_unit: Literal["rad", "deg"] = Field(
        "rad",
        description="Unit of bearing, pose_yaw, pose_std_yaw and, per second, turn_rate (no unit"
        " of its own).",
    )


@dataclass(frozen=True, slots=True)
class MeasurementLog:
    """Measurements of one target, and the truth where a file has it.

    Attributes
    ----------
    measurements : list of Measurement
        In the order of the file.
    truth : TargetTruth or None
        One row per measurement.
    format : str
        What kind of file it was.
    """

    measurements: list[Measurement]
    truth: TargetTruth | None
    format: str

    def rows(self, chosen: list[int]) -> "MeasurementLog":
        """Those measurements, in that order."""
        truth = None if self.truth is None else self.truth.rows(np.array(chosen, np.int64))
        return MeasurementLog([self.measurements[row] for row in chosen], truth, self.format)


def read_measurements(path: str | Path, options: TableOptions | None = None) -> MeasurementLog:
    """Read measurements of one target.

    Parameters
    ----------
    path : str or Path
        An L/R text file (.txt), or a table .csv, .parquet or .npz with a row per time. Columns
        are t_ns; x, y of a LiDAR; range, bearing, range_rate of a radar; turn_rate of a gyro;
        pose_x, pose_y, pose_yaw of the platform, and their standard deviations pose_std_x,
        pose_std_y, pose_std_yaw, where they are known; true_x, true_y, true_vx, true_vy. Without a
        column `sensor`, a row gives a measurement of every sensor whose values are all there.
    options : TableOptions, optional

    Raises
    ------
    FormatError
        A column is missing or holds something else; the text names file, column and row.
    InputError
        `columns` names something that is not read.
    LimitError
        More than 256 MiB.
    """
    place, options = Path(path), as_config(options, TableOptions)
    if place.suffix not in TABLES:
        recording = read_laser_radar(place)
        return MeasurementLog(recording.measurements, recording.truth, "L/R text")
    columns = _renamed(place, read_columns(place), options.columns)
    stamps = _stamps(place, columns, UNITS_NS[options.time_unit])
    angle = np.pi / 180 if options.angle_unit == "deg" else 1.0
    values = _values(place, columns, angle)
    rows = _rows_of_sensors(place, columns, values, len(stamps))
    spread = _pose_covariances(place, columns, angle)
    made = [
        (
            row,
            Measurement(
                int(stamps[row]),
                sensor,
                values[sensor][row],
                spread.get(row) if sensor == "pose" else None,
            ),
        )
        for row, sensor in rows
    ]
    if not made:
        raise FormatError(f"{place}: no row holds all values of a sensor")
    kept = np.array([row for row, _ in made])
    truth = _truth(place, columns, stamps, kept)
    return MeasurementLog([m for _, m in made], truth, f"table ({place.suffix[1:]})")


def _renamed(place: Path, columns: Columns, names: Mapping[str, str]) -> Columns:
    unknown = sorted(set(names) - set(NAMES))
    if unknown:
        raise InputError(f"columns: expected names among {', '.join(NAMES)}; got {unknown[0]!r}")
    missing = sorted(set(names.values()) - set(columns))
    if missing:
        raise FormatError(f"{place}: no column {missing[0]!r} among {', '.join(columns)}")
    return columns | {ours: columns[theirs] for ours, theirs in names.items()}


def _numbers(place: Path, columns: Columns, name: str) -> NDArray[np.float64]:
    """A column as numbers; empty cells are NaN."""
    column = columns[name]
    if column.dtype.kind in "fiub":
        return column.astype(np.float64)
    numbers = np.empty(len(column))
    for row, text in enumerate(column.tolist()):
        try:
            numbers[row] = float(text) if text not in ("", None) else np.nan
        except (TypeError, ValueError) as error:
            raise FormatError(
                f"{place}, row {row}: column {name}: expected a number, got {text!r}"
            ) from error
    return numbers


def _stamps(place: Path, columns: Columns, unit_ns: int) -> NDArray[np.int64]:
    if "t_ns" not in columns:
        raise FormatError(
            f"{place}: no column t_ns among {', '.join(columns) or 'none'}; name the column of"
            ' times with columns={"t_ns": "NAME"}'
        )
    column, limit = columns["t_ns"], MAX_SECONDS * 1e9 / unit_ns
    numbers = _numbers(place, columns, "t_ns")
    bad = np.logical_not(np.abs(numbers) <= limit)  # NaN is bad, too
    if bad.any():
        row = int(np.argmax(bad))
        raise FormatError(f"{place}, row {row}: expected a time, got {column[row]!r}")
    if column.dtype.kind in "iu":
        return column.astype(np.int64) * unit_ns
    stamps: NDArray[np.int64] = np.round(numbers * unit_ns).astype(np.int64)
    return stamps


def _values(place: Path, columns: Columns, angle: float) -> dict[SensorName, NDArray[np.float64]]:
    """Values (K, n) of every sensor whose columns are all there."""
    scale = dict.fromkeys(("bearing", "turn_rate", "pose_yaw"), angle)
    found = {
        sensor: np.stack(
            [_numbers(place, columns, name) * scale.get(name, 1.0) for name in names], axis=1
        )
        for sensor, names in VALUES.items()
        if set(names) <= set(columns)
    }
    if not found:
        wanted = "; ".join(f"{sensor}: {', '.join(names)}" for sensor, names in VALUES.items())
        raise FormatError(
            f"{place}: no sensor has all its columns ({wanted}) among {', '.join(columns)};"
            ' name them with columns={"OURS": "THEIRS"}'
        )
    return found


def _pose_covariances(
    place: Path, columns: Columns, angle: float
) -> dict[int, NDArray[np.float64]]:
    """Covariance of the pose by row, where all its deviations are above zero."""
    if not set(POSE_STD) <= set(columns):
        return {}
    scales = (1.0, 1.0, angle)
    stds = np.stack(
        [
            _numbers(place, columns, name) * scale
            for name, scale in zip(POSE_STD, scales, strict=True)
        ],
        axis=1,
    )
    whole = np.isfinite(stds).all(axis=1) & (stds > 0).all(axis=1)
    return {row: np.diag(stds[row] ** 2) for row in np.flatnonzero(whole).tolist()}


def _rows_of_sensors(
    place: Path, columns: Columns, values: Mapping[SensorName, NDArray[np.float64]], count: int
) -> list[tuple[int, SensorName]]:
    """Row and sensor of every measurement, in the order of the table."""
    if "sensor" in columns:
        return [
            (row, _sensor(place, row, word, values))
            for row, word in enumerate(columns["sensor"].tolist())
        ]
    whole = {sensor: [bool(row.all()) for row in np.isfinite(values[sensor])] for sensor in values}
    order: tuple[SensorName, ...] = ("pose", "gyro", "lidar", "radar")  # the platform moves first
    return [
        (row, sensor)
        for row in range(count)
        for sensor in order
        if sensor in whole and whole[sensor][row]
    ]


def _sensor(
    place: Path, row: int, word: object, values: Mapping[SensorName, NDArray[np.float64]]
) -> SensorName:
    sensor = WORDS.get(str(word).strip().lower())
    if sensor is None or sensor not in values:
        raise FormatError(
            f"{place}, row {row}: column sensor: expected one of"
            f" {', '.join(known for known, name in WORDS.items() if name in values)}, got {word!r}"
        )
    return sensor


def _truth(
    place: Path, columns: Columns, stamps: NDArray[np.int64], rows: NDArray[np.int64]
) -> TargetTruth | None:
    if not set(TRUTH) <= set(columns):
        return None
    values = np.stack([_numbers(place, columns, name) for name in TRUTH], axis=1)[rows]
    if not np.isfinite(values).all():
        raise FormatError(f"{place}: a true value is not finite; leave the columns true_* out")
    return TargetTruth(stamps[rows], values[:, :2], values[:, 2:], None, None)
