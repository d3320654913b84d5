"""Measurements of one target from files: L/R text, or any table by a map of its columns."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, field_validator

from lidar_core.config import Config, as_config
from lidar_core.errors import FormatError, InputError
from lidar_core.fusion.measurement import FLAT, MEASURES, Measurement, SensorName
from lidar_core.fusion.recordings.columns.cells import (
    POSE_STD,
    POSITION,
    TRUE_ID,
    VELOCITY,
    numbers_in,
    pose_covariances,
    scaled,
    stamps_in,
    targets_in,
    truth_in,
)
from lidar_core.fusion.recordings.columns.conventions import (
    WORDS,
    Azimuth,
    Turned,
    local_places,
    turned,
)
from lidar_core.fusion.recordings.columns.unused import unused_columns, unused_note
from lidar_core.fusion.recordings.reading import TargetTruth, read_laser_radar
from lidar_core.io.tables.columns import Columns, at_row, read_columns

VALUES: dict[SensorName, tuple[str, ...]] = {
    "lidar": ("x", "y"),
    "radar": ("range", "bearing", "range_rate"),
    "gyro": ("turn_rate",),
    "pose": ("pose_x", "pose_y", "pose_yaw"),
}
IN_SPACE = {"lidar": ("z",), "radar": ("elevation",), "pose": ("pose_z", "pose_roll", "pose_pitch")}
"""Further values of sensors in space. A radar may lack any of its values, and a LiDAR its z."""
POSE_IN_SPACE = ("pose_x", "pose_y", "pose_z", "pose_roll", "pose_pitch", "pose_yaw")
ON_EARTH = {"": ("x", "y", "z"), "pose_": ("pose_x", "pose_y", "pose_z")}
"""What latitude, longitude and altitude are turned into, by the start of their names."""
NOT_VALUES = ("t_ns", "sensor", *POSE_STD, *POSITION, *VELOCITY, TRUE_ID)
"""Columns that are no value of a sensor."""
NAMES = (
    "t_ns",
    "sensor",
    *(name for names in VALUES.values() for name in names),
    *(name for names in IN_SPACE.values() for name in names),
    *(start + name for start in ON_EARTH for name in ("lat", "lon", "alt")),
    *POSE_STD,
    *POSITION,
    *VELOCITY,
    TRUE_ID,
)
"""Columns that a table may have."""
SCALABLE = tuple(name for name in NAMES if name not in ("t_ns", "sensor", TRUE_ID))
"""Columns whose numbers a factor may change; times have a unit of their own."""
UNITS_NS = {"ns": 1, "us": 1000, "ms": 1_000_000, "s": 1_000_000_000}
TABLES = (".csv", ".npz", ".parquet", ".tsv")
"""Endings of tables, in lower case."""
_FORMAT = "table ("


class TableOptions(Config):
    """Options for reading a table of measurements; not used for L/R text files."""

    columns: dict[str, str] = Field(
        default={},
        description="Names of columns where they differ: ours to the table's (no unit). Ours are"
        f" {', '.join(NAMES)}.",
    )
    time_unit: Literal["ns", "us", "ms", "s"] = Field(
        default="ns", description="Unit of the column of times (no unit of its own)."
    )
    angle_unit: Literal["rad", "deg"] = Field(
        default="rad",
        description="Unit of bearing, elevation, angles of the pose, pose_std_yaw and, per second,"
        " turn_rate (no unit of its own).",
    )
    azimuth: dict[Turned, Azimuth] = Field(
        default={},
        description="Angles that are not counter-clockwise from x (no unit): bearing,"
        " pose_yaw, turn_rate or lidar (x and y of a LiDAR), each clockwise (from"
        " x; y to the right) or compass (clockwise from y, which is north; x and y"
        " exchanged).",
    )
    clock: dict[SensorName, float] = Field(
        default={},
        description="Offset of the clocks of sensors, by sensor, positive if ahead [s]: it is"
        " subtracted from their times.",
    )
    scale: dict[str, float] = Field(
        default={},
        description="Factors of columns as they are in the table, by our names (no unit): range"
        " 0.001 reads millimetres, range_rate -1 the other sign.",
    )

    @field_validator("scale")
    @classmethod
    def _scales_numbers(cls, factors: dict[str, float]) -> dict[str, float]:
        for name, factor in factors.items():
            if name not in SCALABLE:
                raise ValueError(f"expected columns among {', '.join(SCALABLE)}; got {name!r}")
            if factor == 0:
                raise ValueError(f"expected factors other than 0 (column {name})")
        return factors


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
        Format of the file.
    origin : tuple of float, or None
        Latitude, longitude [deg] and altitude [m] of x = y = z = 0, with x to the east and y to
        the north, where the file has places on the Earth (WGS84).
    targets : ndarray, shape (K,), int64, or None
        Number of the target of each measurement, -1 for none, if the file states it.
    options : TableOptions
        Options with which a table was read; the defaults for other files.
    unused : str or None
        Columns of a table that give no measurement, and what they may be, as text.
    """

    measurements: list[Measurement]
    truth: TargetTruth | None
    format: str
    origin: tuple[float, float, float] | None = None
    targets: NDArray[np.int64] | None = None
    options: TableOptions = field(default_factory=TableOptions)
    unused: str | None = None

    def rows(self, chosen: list[int]) -> "MeasurementLog":
        """Return the measurements with these indices, in this order."""
        truth = None if self.truth is None else self.truth.rows(np.array(chosen, np.int64))
        targets = None if self.targets is None else self.targets[np.array(chosen, np.int64)]
        kept = [self.measurements[row] for row in chosen]
        return replace(self, measurements=kept, truth=truth, targets=targets)


def read_measurements(path: str | Path, options: TableOptions | None = None) -> MeasurementLog:
    """Read measurements of one target.

    Parameters
    ----------
    path : str or Path
        An L/R text file (.txt), or a table .csv, .tsv, .parquet or .npz with a row per time.
        Columns are t_ns (numbers, or ISO 8601); x, y, and z if there is one, of a LiDAR; any of
        range, bearing, elevation, range_rate of a radar; turn_rate of a gyro; pose_x, pose_y,
        pose_yaw of the platform, or these with pose_z, pose_roll, pose_pitch; their standard
        deviations pose_std_x, pose_std_y, pose_std_yaw, where they are known; true_x and true_y,
        if known with true_vx and true_vy, and true_id of the target in tables of several. lat,
        lon and alt stand for x, y, z, and pose_lat, pose_lon, pose_alt for those of the platform:
        places on WGS84 become metres to the east, north and up of the first one. Without a column
        `sensor`, a row gives a measurement of every sensor whose values are there.
    options : TableOptions, optional

    Raises
    ------
    FormatError
        A column is missing or holds something else; the text names file, column and row, which
        count from 1 below the names of columns.
    InputError
        `columns` names something that is not read, or the truth lacks a column.
    LimitError
        More than 256 MiB.
    """
    place, options = Path(path), as_config(options, TableOptions)
    if not is_table(place):
        recording = read_laser_radar(place)
        return MeasurementLog(recording.measurements, recording.truth, "L/R text")
    table = read_columns(place)
    columns = _renamed(place, table, options.columns)
    columns = scaled(place, columns, options.scale)
    if not any(len(column) for column in columns.values()):
        raise FormatError(f"{place}: no rows below the names of columns")
    columns, origin = _in_metres(place, columns)
    stamps = stamps_in(place, columns, UNITS_NS[options.time_unit])
    angle = np.pi / 180 if options.angle_unit == "deg" else 1.0
    values = _values(place, columns, angle, options.azimuth)
    rows = _rows_of_sensors(place, columns, values, len(stamps))
    spread = pose_covariances(place, columns, angle)
    ahead = {sensor: round(seconds * 1e9) for sensor, seconds in options.clock.items()}
    made = [
        (row, _measurement(int(stamps[row]) - ahead.get(sensor, 0), sensor, values, row, spread))
        for row, sensor in rows
    ]
    if not made:
        raise FormatError(f"{place}: no row holds all values of a sensor")
    kept = np.array([row for row, _ in made])
    truth = truth_in(place, columns, stamps, kept)
    kind = f"{_FORMAT}{place.suffix[1:].lower()})"
    targets = targets_in(place, columns, kept)
    unused = _unused(tuple(table), set(columns), set(values), options)
    return MeasurementLog([m for _, m in made], truth, kind, origin, targets, options, unused)


def _unused(
    table: tuple[str, ...], columns: set[str], sensors: set[SensorName], options: TableOptions
) -> str | None:
    """Return a note on columns of a table that are not used; `columns` have our names."""
    used = set(NOT_VALUES) & columns
    for sensor in sensors:
        further = set(IN_SPACE.get(sensor, ()))
        used |= {*VALUES[sensor], *(further if sensor == "radar" or further <= columns else ())}
    for start, places in ON_EARTH.items():
        if {f"{start}lat", f"{start}lon"} <= columns and set(places[:2]) <= used:
            used |= {f"{start}lat", f"{start}lon", f"{start}alt"}
    used &= columns
    return unused_note(unused_columns(table, used, options.columns), used, SCALABLE)


def is_of_table(log_format: str) -> bool:
    """Return whether a format is that of a `MeasurementLog` from a table."""
    return log_format.startswith(_FORMAT)


def is_table(place: Path) -> bool:
    """True if a file is read as a table; other files are L/R text.

    Examples
    --------
    >>> is_table(Path("RADAR.CSV")), is_table(Path("sample.txt"))
    (True, False)
    """
    return place.suffix.lower() in TABLES


def _measurement(
    stamp_ns: int,
    sensor: SensorName,
    values: Mapping[SensorName, NDArray[np.float64]],
    row: int,
    spread: Mapping[int, NDArray[np.float64]],
) -> Measurement:
    """Make a measurement from the finite values in a row; if there are none, from all values."""
    own = values[sensor][row]
    known = np.isfinite(own)
    if sensor == "radar":
        there = known if known.any() else np.atleast_1d(np.isfinite(values[sensor]).any(axis=0))
        names = tuple(MEASURES[place] for place in np.flatnonzero(there).tolist()) or FLAT
        rows = [MEASURES.index(name) for name in names]
        return Measurement(stamp_ns, sensor, own[rows], measures=names)
    if sensor == "pose" and known[len(VALUES["pose"]) :].all() and len(own) > len(VALUES["pose"]):
        x, y, yaw, z, roll, pitch = own
        return Measurement(stamp_ns, "pose-3d", [x, y, z, roll, pitch, yaw])
    if sensor == "lidar" and len(own) > 2 and known[2]:
        return Measurement(stamp_ns, sensor, own)
    noise = spread.get(row) if sensor == "pose" else None
    return Measurement(stamp_ns, sensor, own[: len(VALUES[sensor])], noise)


def _in_metres(place: Path, columns: Columns) -> tuple[Columns, tuple[float, float, float] | None]:
    """Convert latitude, longitude and altitude to east, north and up; return also their origin.

    Raises
    ------
    InputError
        Places of a target on the Earth beside poses: what a sensor measures is relative to it.
    """
    given = [start for start in ON_EARTH if {f"{start}lat", f"{start}lon"} <= set(columns)]
    if not given:
        return columns, None
    if "" in given and ("pose_" in given or "pose_x" in columns):
        raise InputError(
            f"{place}: lat and lon are positions in the world, but LiDAR and radar measure from"
            " the platform; leave out lat and lon, or the poses"
        )
    start = given[0]
    names = [f"{start}{name}" for name in ("lat", "lon", "alt")]
    parts = [numbers_in(place, columns, name) for name in names if name in columns]
    altitude = parts[2] if len(parts) == 3 else np.zeros(len(parts[0]))
    whole = np.isfinite(parts[0]) & np.isfinite(parts[1])
    bad = whole & ~((np.abs(parts[0]) <= 90) & (np.abs(parts[1]) <= 360))
    if bad.any() or not whole.any():
        row = int(np.argmax(bad))
        raise FormatError(
            f"{at_row(place, row)}: expected a latitude within 90 and a longitude within 360"
            f" degrees, got {parts[0][row]}, {parts[1][row]}"
        )
    first = int(np.argmax(whole))
    high = altitude[first] if np.isfinite(altitude[first]) else 0.0
    origin = (float(parts[0][first]), float(parts[1][first]), float(high))
    local = local_places(parts[0], parts[1], np.nan_to_num(altitude, nan=high), origin).T
    chosen = ON_EARTH[start] if len(parts) == 3 else ON_EARTH[start][:2]
    return columns | dict(zip(chosen, local, strict=False)), origin


def _renamed(place: Path, columns: Columns, names: Mapping[str, str]) -> Columns:
    unknown = sorted(set(names) - set(NAMES))
    if unknown:
        raise InputError(f"columns: expected names among {', '.join(NAMES)}; got {unknown[0]!r}")
    missing = sorted(set(names.values()) - set(columns))
    if missing:
        raise FormatError(f"{place}: no column {missing[0]!r} among {', '.join(columns)}")
    return columns | {ours: columns[theirs] for ours, theirs in names.items()}


def _values(
    place: Path, columns: Columns, angle: float, azimuth: Mapping[Turned, Azimuth]
) -> dict[SensorName, NDArray[np.float64]]:
    """Values (K, n) of every sensor that has columns; values that a radar lacks are NaN.

    A radar's are range, bearing, elevation and range rate; others are those of `VALUES`, and those
    of `IN_SPACE` if there are such columns.
    """
    angles = ("bearing", "elevation", "turn_rate", "pose_yaw", "pose_roll", "pose_pitch")

    def numbers(name: str) -> NDArray[np.float64]:
        if name not in columns:
            return np.full(count, np.nan)
        column = numbers_in(place, columns, name) * (angle if name in angles else 1.0)
        if name == "turn_rate":
            return -column if "turn_rate" in azimuth else column
        if name == "bearing":
            return turned(column, azimuth.get("bearing"))
        return turned(column, azimuth.get("pose_yaw")) if name == "pose_yaw" else column

    count = len(columns["t_ns"])
    found: dict[SensorName, NDArray[np.float64]] = {}
    for sensor, names in VALUES.items():
        wanted = MEASURES if sensor == "radar" else names
        further = () if sensor == "radar" else IN_SPACE.get(sensor, ())
        there = set(wanted) & set(columns) if sensor == "radar" else set(wanted) <= set(columns)
        if there:
            own = (*wanted, *(further if set(further) <= set(columns) else ()))
            found[sensor] = np.stack([numbers(name) for name in own], axis=1)
    way = azimuth.get("lidar")
    if "lidar" in found and way is not None:
        x, y = found["lidar"][:, 0].copy(), found["lidar"][:, 1].copy()
        found["lidar"][:, :2] = np.stack([x, -y] if way == "clockwise" else [y, x], axis=1)
    if not found:
        wanted_names = "; ".join(f"{one}: {', '.join(names)}" for one, names in VALUES.items())
        raise FormatError(
            f"{place}: no sensor has all its columns ({wanted_names}) among {', '.join(columns)};"
            ' name them with columns={"OURS": "THEIRS"}'
        )
    return found


def _rows_of_sensors(
    place: Path, columns: Columns, values: Mapping[SensorName, NDArray[np.float64]], count: int
) -> list[tuple[int, SensorName]]:
    """Row and sensor of every measurement, in the order of the table."""
    if "sensor" in columns:
        return [
            (row, _sensor(place, row, word, values))
            for row, word in enumerate(columns["sensor"].tolist())
        ]
    whole = {sensor: _is_there(sensor, values[sensor]) for sensor in values}
    order: tuple[SensorName, ...] = ("pose", "gyro", "lidar", "radar")  # the platform moves first
    return [
        (row, sensor)
        for row in range(count)
        for sensor in order
        if sensor in whole and whole[sensor][row]
    ]


def _is_there(sensor: SensorName, values: NDArray[np.float64]) -> list[bool]:
    """Return which rows contain a measurement: any value of a radar, all planar ones of others."""
    known = np.isfinite(values)
    rows = known.any(axis=1) if sensor == "radar" else known[:, : len(VALUES[sensor])].all(axis=1)
    return [bool(row) for row in np.atleast_1d(rows)]


def _sensor(
    place: Path, row: int, word: object, values: Mapping[SensorName, NDArray[np.float64]]
) -> SensorName:
    sensor = WORDS.get(str(word).strip().lower())
    if sensor is None or sensor not in values:
        raise FormatError(
            f"{at_row(place, row)}: column sensor: expected one of"
            f" {', '.join(known for known, name in WORDS.items() if name in values)}, got {word!r}"
        )
    return sensor
