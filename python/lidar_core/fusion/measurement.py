"""Measurements, as a filter takes them."""

from collections.abc import Iterable
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lidar_core import _core
from lidar_core.arrays import as_real, as_rows, as_stamp
from lidar_core.errors import InputError

SensorName: TypeAlias = Literal["lidar", "radar", "gyro", "pose"]
VALUES: dict[str, tuple[int, ...]] = {
    "lidar": (2,),
    "radar": (3, 5),
    "gyro": (1, 3),
    "pose": (3, 6),
}
"""Numbers of values that each sensor may give."""
NOISY = {"lidar": 2, "radar": 3, "gyro": 1, "pose": 3}
"""Rows of each sensor's covariance."""


class Measurement:
    """One measurement of one sensor.

    Parameters
    ----------
    stamp_ns : int
        Time [ns].
    sensor : {"lidar", "radar", "gyro", "pose"}
        Where it comes from.
    values : array_like
        lidar: x, y [m]. radar: range [m], bearing counter-clockwise from x [rad], range rate
        [m/s], positive when the range grows; or these and the target's true speed and heading,
        which only `PublishedModel.reading` c uses. gyro: turn rate of the platform [rad/s], or that
        and the velocity of its origin in its own axes, vx, vy [m/s]. pose, of the platform in
        the world: x, y [m], yaw [rad]; or these and vx, vy in the world [m/s] and the turn rate
        [rad/s]. Values that are not finite are allowed: a filter refuses them and says so.
    covariance : array_like, optional
        Of a lidar's x and y (2, 2), of all values of a radar (3, 3), of a gyro's turn rate
        (1, 1), of a pose's x, y and yaw (3, 3); without it the filter's configuration holds.

    Raises
    ------
    InputError
        Unknown sensor, wrong number of values, or a matrix that is no covariance.

    Examples
    --------
    >>> Measurement(0, "radar", [5.0, 0.1, -1.2])
    Measurement(0, 'radar', [5.0, 0.1, -1.2])
    """

    __slots__ = ("_core", "covariance", "sensor", "stamp_ns", "values")

    stamp_ns: int
    sensor: SensorName
    values: NDArray[np.float64]
    covariance: NDArray[np.float64] | None

    def __init__(
        self,
        stamp_ns: int,
        sensor: SensorName,
        values: ArrayLike,
        covariance: ArrayLike | None = None,
    ) -> None:
        if sensor not in VALUES:
            raise InputError(f"sensor: expected one of {', '.join(VALUES)}, got {sensor!r}")
        self.stamp_ns = as_stamp(stamp_ns)
        self.sensor = sensor
        self.values = as_real(values, name="values").astype(np.float64)
        self.values.flags.writeable = False
        if self.values.shape not in [(count,) for count in VALUES[sensor]]:
            expected = " or ".join(f"({count},)" for count in VALUES[sensor])
            raise InputError(f"values: expected shape {expected}, got {self.values.shape}")
        self.covariance = None if covariance is None else _covariance(covariance, sensor)
        self._core = _core.Measurement(
            self.stamp_ns,
            sensor,
            self.values,
            covariance=None if self.covariance is None else self.covariance.reshape(-1),
        )

    def __repr__(self) -> str:
        return f"Measurement({self.stamp_ns}, {self.sensor!r}, {self.values.tolist()})"


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

    __slots__ = ("_core",)

    def __init__(self, measurements: Iterable[Measurement]) -> None:
        listed = list(measurements)
        for number, measurement in enumerate(listed):
            if not isinstance(measurement, Measurement):
                raise InputError(
                    f"measurements[{number}]: expected a Measurement,"
                    f" got {type(measurement).__name__}"
                )
        self._core = _core.Measurements([m._core for m in listed])

    @classmethod
    def from_arrays(
        cls,
        stamps_ns: ArrayLike,
        sensors: ArrayLike,
        values: ArrayLike,
        *,
        covariances: ArrayLike | None = None,
    ) -> "Measurements":
        """Many measurements at once.

        Parameters
        ----------
        stamps_ns : array_like, shape (K,), int64
            Times [ns].
        sensors : array_like, shape (K,), str
            Names of sensors, as of `Measurement`.
        values : array_like, shape (K, W)
            A row holds as many values as its sensor has at least; the rest is not looked at.
        covariances : array_like, shape (K, 3, 3), optional
            As of `Measurement`, in the first rows and columns of each matrix; the rest is not
            looked at. Without it the filter's configuration holds.

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
            noise = as_rows(
                covariances, name="covariances", rows=len(stamps), shape=(3, 3), dtype=np.float64
            ).reshape(-1, 9)
        made = cls.__new__(cls)
        made._core = _core.Measurements.from_arrays(
            stamps, codes, np.ascontiguousarray(rows), counts=counts, covariances=noise
        )
        return made

    def __len__(self) -> int:
        return len(self._core)


def as_measurements(measurements: Iterable[Measurement] | Measurements) -> Measurements:
    """`measurements`, kept by the core."""
    if isinstance(measurements, Measurements):
        return measurements
    return Measurements(measurements)


def _covariance(covariance: ArrayLike, sensor: SensorName) -> NDArray[np.float64]:
    size = NOISY[sensor]
    matrix = as_real(covariance, name="covariance").astype(np.float64)
    if matrix.shape != (size, size):
        raise InputError(f"covariance: expected shape ({size}, {size}), got {matrix.shape}")
    return np.ascontiguousarray(matrix)
