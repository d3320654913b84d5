"""Measurements for filters."""

from collections.abc import Iterable, Sequence
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lidar_core import _core
from lidar_core.arrays import as_real, as_rows, as_stamp
from lidar_core.errors import InputError

SensorName: TypeAlias = Literal["lidar", "radar", "gyro", "pose", "pose-3d"]
VALUES: dict[str, tuple[int, ...]] = {
    "lidar": (2, 3),
    "radar": (3, 4, 5),
    "gyro": (1, 3),
    "pose": (3, 6),
    "pose-3d": (6, 12),
}
"""Numbers of values that each sensor may give."""
NOISY = {"gyro": 1, "pose": 3, "pose-3d": 6}
"""Rows of the covariance of sensors that tell of the platform; of the others as many as values."""
MEASURES = ("range", "bearing", "elevation", "range_rate")
"""What a radar may measure, in the order of its values."""
FLAT = ("range", "bearing", "range_rate")
"""What it measures with three values."""
_UNNAMED = (
    "; three values of a radar are range, bearing and range rate: name other ones, such as"
    ' measures=["range", "bearing"]'
)


class Measurement:
    """One measurement of one sensor.

    Parameters
    ----------
    stamp_ns : int
        Time [ns].
    sensor : {"lidar", "radar", "gyro", "pose", "pose-3d"}
        Kind of the sensor. "radar" is every sensor that measures ranges, angles or range rates.
    values : array_like
        lidar: x, y, or x, y, z [m]. radar: range [m], bearing counter-clockwise from x [rad],
        elevation above the plane of x and y [rad], range rate [m/s], positive when the range
        grows; three values are range, bearing and range rate, other ones are named by `measures`;
        or five: these three and the target's true speed and heading, which only
        `PublishedModel.reading` c uses. gyro: turn rate of the platform [rad/s], or that
        and the velocity of its origin in its own axes, vx, vy [m/s]. pose, of the platform in
        the world: x, y [m], yaw [rad]; or these and vx, vy in the world [m/s] and the turn rate
        [rad/s]. pose-3d: x, y, z [m], roll, pitch, yaw [rad] of the platform in the world (turned
        about z by the yaw, then about the new y by the pitch, then about the new x by the roll);
        or these, vx, vy, vz in the world [m/s] and the turn rates about its own axes [rad/s].
        Values that are not finite are allowed: a filter refuses them and says so.
    covariance : array_like, optional
        Covariance of all values of a lidar or radar (K, K), of a gyro's turn rate (1, 1), of a
        pose's x, y and yaw (3, 3), of the first six values of a pose-3d (6, 6); without it the
        filter's configuration applies.
    measures : sequence of str, optional
        Names of the values of a radar, in their order: range, bearing, elevation, range_rate. A
        filter in the plane uses an elevation to convert range and range rate to the plane.
    seen_from : array_like, shape (2,), optional
        Position [m] of the radar that measured a position given as sensor "lidar", in the same
        frame. `MultiTargetTracker` then distinguishes double echoes from targets.

    Raises
    ------
    InputError
        Unknown sensor, wrong number of values, a matrix that is no covariance, or a place that is
        not finite or not of a measured position.

    Examples
    --------
    >>> Measurement(0, "radar", [5.0, 0.1, -1.2])
    Measurement(0, 'radar', [5.0, 0.1, -1.2])
    >>> Measurement(0, "radar", [0.1, 0.3], measures=["bearing", "elevation"])
    Measurement(0, 'radar', [0.1, 0.3], measures=('bearing', 'elevation'))
    """

    __slots__ = ("_core", "covariance", "measures", "seen_from", "sensor", "stamp_ns", "values")

    stamp_ns: int
    sensor: SensorName
    values: NDArray[np.float64]
    covariance: NDArray[np.float64] | None
    measures: tuple[str, ...] | None
    seen_from: NDArray[np.float64] | None

    def __init__(
        self,
        stamp_ns: int,
        sensor: SensorName,
        values: ArrayLike,
        covariance: ArrayLike | None = None,
        *,
        measures: Sequence[str] | None = None,
        seen_from: ArrayLike | None = None,
    ) -> None:
        if sensor not in VALUES:
            raise InputError(f"sensor: expected one of {', '.join(VALUES)}, got {sensor!r}")
        self.stamp_ns = as_stamp(stamp_ns)
        self.sensor = sensor
        self.values = as_real(values, name="values").astype(np.float64)
        self.values.flags.writeable = False
        self.measures = _measures(sensor, measures, self.values.size)
        counts = VALUES[sensor] if measures is None else (len(self.measures or ()),)
        if self.values.shape not in [(count,) for count in counts]:
            expected = " or ".join(f"({count},)" for count in counts)
            cure = _UNNAMED if sensor == "radar" and measures is None else ""
            raise InputError(f"values: expected shape {expected}, got {self.values.shape}{cure}")
        size = NOISY.get(sensor, len(self.measures or self.values))
        self.covariance = None if covariance is None else _covariance(covariance, size)
        self.seen_from = None if seen_from is None else _radar_place(seen_from, sensor)
        self._core = _core.Measurement(
            self.stamp_ns,
            sensor,
            self.values,
            measures=None if measures is None else [name in measures for name in MEASURES],
            covariance=None if self.covariance is None else self.covariance.reshape(-1),
            seen_from=None if self.seen_from is None else self.seen_from.tolist(),
        )

    def __repr__(self) -> str:
        usual = self.measures in (None, FLAT, MEASURES)
        named = "" if usual else f", measures={self.measures}"
        if self.seen_from is not None:
            named += f", seen_from={self.seen_from.tolist()}"
        return f"Measurement({self.stamp_ns}, {self.sensor!r}, {self.values.tolist()}{named})"

    def with_values(self, values: ArrayLike, *, stamp_ns: int | None = None) -> "Measurement":
        """Return another measurement of the same kind and covariance, of the same time or another.

        Raises
        ------
        InputError
            Another number of values.
        """
        other = self.measures if self.measures not in (None, FLAT, MEASURES) else None
        stamp = self.stamp_ns if stamp_ns is None else stamp_ns
        return Measurement(
            stamp,
            self.sensor,
            values,
            self.covariance,
            measures=other,
            seen_from=self.seen_from,
        )


class Measurements:
    """Measurements of one target, kept by the core: for long recordings and many runs.

    Parameters
    ----------
    measurements : iterable of Measurement
        In any order.

    Raises
    ------
    InputError
        Something else than a `Measurement`.

    Examples
    --------
    >>> len(Measurements([Measurement(0, "lidar", [1.0, 2.0])]))
    1
    """

    __slots__ = ("_core", "_stamps_ns")

    def __init__(self, measurements: Iterable[Measurement]) -> None:
        listed = list(measurements)
        for number, measurement in enumerate(listed):
            if not isinstance(measurement, Measurement):
                raise InputError(
                    f"measurements[{number}]: expected a Measurement,"
                    f" got {type(measurement).__name__}"
                )
        self._core = _core.Measurements([m._core for m in listed])
        self._stamps_ns = np.array([m.stamp_ns for m in listed], np.int64)

    @classmethod
    def from_arrays(
        cls,
        stamps_ns: ArrayLike,
        sensors: ArrayLike,
        values: ArrayLike,
        *,
        covariances: ArrayLike | None = None,
    ) -> "Measurements":
        """Make measurements from arrays, one per row.

        Parameters
        ----------
        stamps_ns : array_like, shape (K,), int64
            Times [ns].
        sensors : array_like, shape (K,), str
            Names of sensors, as of `Measurement`.
        values : array_like, shape (K, W)
            A row has at least as many values as its sensor; further ones are ignored.
        covariances : array_like, shape (K, 3, 3) or (K, 6, 6), optional
            Covariances as in `Measurement`, in the first rows and columns of each matrix; the rest
            is ignored. Without it the filter's configuration applies.

        Raises
        ------
        InputError
            Wrong shapes, an unknown sensor, or a matrix that is no covariance.
        """
        stamps = as_rows(stamps_ns, name="stamps_ns", rows=None, shape=(), dtype=np.int64)
        names = np.asarray(sensors, dtype=np.str_)
        order = list(VALUES)
        if names.shape != stamps.shape or not np.isin(names, order).all():
            raise InputError(f"sensors: expected {len(stamps)} of {', '.join(order)}")
        codes = np.zeros(len(stamps), np.uint8)
        for number, name in enumerate(order):
            codes[names == name] = number
        counts = np.array([VALUES[name][0] for name in order], np.uint8)[codes]
        rows = as_real(values, name="values").astype(np.float64)
        if rows.ndim != 2 or len(rows) != len(stamps) or (counts > rows.shape[1]).any():
            raise InputError(
                f"values: expected {len(stamps)} rows with the values of their sensors,"
                f" got shape {rows.shape}"
            )
        noise = np.zeros((0, 9))
        if covariances is not None:
            size = 6 if (names == "pose-3d").any() else 3
            noise = as_rows(
                covariances,
                name="covariances",
                rows=len(stamps),
                shape=(size, size),
                dtype=np.float64,
            ).reshape(len(stamps), -1)
        made = cls.__new__(cls)
        made._stamps_ns = stamps.copy()
        made._core = _core.Measurements.from_arrays(
            stamps, codes, np.ascontiguousarray(rows), counts=counts, covariances=noise
        )
        return made

    def __len__(self) -> int:
        return len(self._core)


def as_measurements(measurements: Iterable[Measurement] | Measurements) -> Measurements:
    """Return `measurements` in the core's own storage."""
    if isinstance(measurements, Measurements):
        return measurements
    return Measurements(measurements)


def measured_place(m: Measurement) -> list[float]:
    """Measured position x, y [m] of a LiDAR or a radar in its frame; NaN without a position."""
    if m.sensor == "lidar":
        x, y = m.values[:2].tolist()
        return [x, y]
    told = dict(zip(m.measures or (), m.values.tolist(), strict=False))
    far = told.get("range", np.nan) * np.cos(told.get("elevation", 0.0))
    bearing = told.get("bearing", np.nan)
    return [far * np.cos(bearing), far * np.sin(bearing)]


def measured_values(measurements: Iterable[Measurement]) -> dict[str, list[str]]:
    """Names of the values that LiDAR and radar measured at least once."""
    found: dict[str, set[str]] = {}
    for m in measurements:
        if m.sensor in ("lidar", "radar"):
            names = "xyz"[: len(m.values)] if m.measures is None else m.measures
            found.setdefault(m.sensor, set()).update(names)
    order = (*"xyz", *MEASURES)
    return {sensor: [name for name in order if name in names] for sensor, names in found.items()}


def _measures(sensor: str, measures: Sequence[str] | None, count: int) -> tuple[str, ...] | None:
    """Names of the values of a radar; None for other sensors."""
    if sensor != "radar":
        if measures is not None:
            raise InputError(f"measures: applies only to sensor 'radar', got sensor {sensor!r}")
        return None
    if measures is None:
        return MEASURES if count == len(MEASURES) else FLAT
    names = tuple(measures)
    if not names or names != tuple(name for name in MEASURES if name in names):
        raise InputError(
            f"measures: expected some of {', '.join(MEASURES)} in this order,"
            f" got {', '.join(map(str, names)) or 'none'}"
        )
    return names


def _radar_place(seen_from: ArrayLike, sensor: str) -> NDArray[np.float64]:
    place = as_real(seen_from, name="seen_from").astype(np.float64)
    if place.shape != (2,) or not np.isfinite(place).all() or sensor != "lidar":
        raise InputError(
            "seen_from: expected a finite x and y, with sensor 'lidar', got shape"
            f" {place.shape} with sensor {sensor!r}"
        )
    place.flags.writeable = False
    return place


def _covariance(covariance: ArrayLike, size: int) -> NDArray[np.float64]:
    matrix = as_real(covariance, name="covariance").astype(np.float64)
    if matrix.shape != (size, size):
        raise InputError(f"covariance: expected shape ({size}, {size}), got {matrix.shape}")
    return np.ascontiguousarray(matrix)
