"""Recordings of one target by LiDAR and radar: noise on top of them, and filters over them."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from lidar_core.fusion import FusionConfig, Measurements, Run, read_laser_radar, run_batch
from lidar_core.fusion.recordings.reading import TargetTruth
from lidar_core.reproduce.recordings import recording

SAMPLE_1 = "fusion/sample-laser-radar-measurement-data-1.txt"
OBJ_POSE = "fusion/obj_pose-laser-radar-synthetic-input.txt"
LEVELS = (-30, -25, -20, -15, -10, -5, 0, 5)
"""Power of the noise that Fig. 10 adds [dBW]."""
PAPER_LEVEL = -13.0
"""Power at which the paper's errors can be matched [dBW]."""
CHUNK = 50
"""Draws that are filtered at a time: what a filter says of one takes a megabyte."""
RANGE_FLOOR = 0.3
"""Least range that says how far noise in the plane turns a bearing [m]."""

Form: TypeAlias = Literal["fixed-lidar", "fixed", "lidar", "polar", "position"]
"""How measurements reach a filter: with the noise of the filter's configuration, those of the
LiDAR or all; with the noise that they have, those of the LiDAR or all; the same, where the radar's
range and bearing come as a position with its covariance, and the range rate beside it."""


@dataclass(frozen=True, slots=True)
class Noise:
    """Standard deviations of the sensors.

    Attributes
    ----------
    lidar : float
        Standard deviation of x and y [m].
    radar : tuple of float
        Standard deviations of range [m], bearing [rad], range rate [m/s].
    """

    lidar: float
    radar: tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Course:
    """Recording of one target as arrays.

    Attributes
    ----------
    is_lidar : ndarray, shape (K,), bool
        True for rows of the LiDAR, false for rows of the radar.
    values : ndarray, shape (K, 3)
        x, y and nothing; or range, bearing, range rate.
    truth : TargetTruth
        Row by row.
    """

    is_lidar: NDArray[np.bool_]
    values: NDArray[np.float64]
    truth: TargetTruth


@cache
def course(name: str) -> Course:
    """Read a recording."""
    found = read_laser_radar(recording(name))
    values = np.zeros((len(found.measurements), 3))
    for row, measurement in zip(values, found.measurements, strict=True):
        row[: len(measurement.values)] = measurement.values
    is_lidar = np.array([measurement.sensor == "lidar" for measurement in found.measurements])
    return Course(is_lidar, values, found.truth)


def power_std(level: float) -> float:
    """Standard deviation of white noise of a power in dBW [m]."""
    return float(10 ** (level / 20))


def places(values: NDArray[np.float64], is_lidar: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Measured positions (K, 2) [m] of LiDAR and radar rows."""
    bearing = values[:, 1]
    polar = values[:, :1] * np.stack([np.cos(bearing), np.sin(bearing)], axis=1)
    return np.where(is_lidar[:, None], values[:, :2], polar)


def add_noise(of: Course, std: float, rng: np.random.Generator) -> NDArray[np.float64]:
    """Add white noise to x and y of every row; range rates do not change."""
    noisy = places(of.values, of.is_lidar) + std * rng.normal(size=(len(of.values), 2))
    values, radar = of.values.copy(), ~of.is_lidar
    values[of.is_lidar, :2] = noisy[of.is_lidar]
    values[radar, 0] = np.hypot(*noisy[radar].T)
    values[radar, 1] = np.arctan2(noisy[radar, 1], noisy[radar, 0])
    return values


def measured(truth: TargetTruth, noise: Noise, rng: np.random.Generator) -> NDArray[np.float64]:
    """Return the values of a LiDAR and a radar in turn, the LiDAR first, along a true path."""
    (x, y), (vx, vy) = truth.position.T, truth.velocity.T
    rho = np.hypot(x, y)
    radar = np.stack([rho, np.arctan2(y, x), (x * vx + y * vy) / rho], axis=1)
    radar += rng.normal(size=radar.shape) * noise.radar
    lidar = np.zeros_like(radar)
    lidar[:, :2] = truth.position + noise.lidar * rng.normal(size=(len(x), 2))
    return np.where(in_turn(len(x))[:, None], lidar, radar)


def in_turn(rows: int) -> NDArray[np.bool_]:
    """Return which rows belong to the LiDAR if both sensors take turns."""
    return np.asarray(np.arange(rows) % 2 == 0)


def measurements(
    of: Course, values: NDArray[np.float64], form: Form, noise: Noise, std: float
) -> Measurements:
    """Return `values` as measurements in the given form for a filter.

    Their errors are `noise` plus white noise of standard deviation `std` [m] per axis.
    """
    stamps, names = of.truth.stamps_ns, np.where(of.is_lidar, "lidar", "radar")
    if form == "position":
        return _positions_and_rates(of, values, noise, std)
    keep = of.is_lidar if form.endswith("lidar") else np.ones(len(names), np.bool_)
    if form.startswith("fixed"):
        return Measurements.from_arrays(stamps[keep], names[keep], values[keep])
    polar = polar_covariances(of.is_lidar, values, noise, std)
    return Measurements.from_arrays(
        stamps[keep], names[keep], values[keep], covariances=polar[keep]
    )


def polar_covariances(
    is_lidar: NDArray[np.bool_], values: NDArray[np.float64], noise: Noise, std: float
) -> NDArray[np.float64]:
    """Covariances (K, 3, 3) of all values, white noise of `std` per axis on top of `noise`."""
    rho, bearing, rate = noise.radar
    turned = std / np.maximum(values[:, 0], RANGE_FLOOR)
    radar = np.stack(
        [0 * turned + rho**2 + std**2, bearing**2 + turned**2, 0 * turned + rate**2], axis=1
    )
    lidar = np.array([noise.lidar**2 + std**2] * 2 + [1.0])
    return np.where(is_lidar[:, None], lidar, radar)[:, :, None] * np.eye(3)


def _positions_and_rates(
    of: Course, values: NDArray[np.float64], noise: Noise, std: float
) -> Measurements:
    """Return measurements in which each radar row appears twice: as position, then as range rate.

    In the second row, range and bearing have such large variances that they have no effect.
    """
    first = np.zeros((len(values), 3, 3))
    c, s, rho = np.cos(values[:, 1]), np.sin(values[:, 1]), values[:, 0]
    T = np.moveaxis(np.array([[c, -rho * s], [s, rho * c]]), 2, 0)
    radar = T @ np.diag(np.square(noise.radar[:2])) @ np.swapaxes(T, 1, 2)
    lidar = noise.lidar**2 * np.eye(2)
    first[:, :2, :2] = np.where(of.is_lidar[:, None, None], lidar, radar) + std**2 * np.eye(2)
    nothing = np.diag([1e8, 1e4, noise.radar[2] ** 2])
    twice = np.repeat(np.arange(len(values)), np.where(of.is_lidar, 1, 2))
    is_rate = np.diff(twice, prepend=-1) == 0
    both = np.zeros((len(values), 3))
    both[:, :2] = places(values, of.is_lidar)
    return Measurements.from_arrays(
        of.truth.stamps_ns[twice],
        np.where(is_rate, "radar", "lidar"),
        np.where(is_rate[:, None], values[twice], both[twice]),
        covariances=np.where(is_rate[:, None, None], nothing, first[twice]),
    )


def estimates(result: Run, of: Course, form: Form) -> NDArray[np.float64]:
    """Positions after every row of the recording, (K, 2); NaN where a row is not used."""
    found = np.full((len(of.is_lidar), 2), np.nan)
    if form.endswith("lidar"):
        found[of.is_lidar] = result.states[:, :2]
        return found
    last = np.arange(len(found))
    if form == "position":
        last = np.cumsum(np.where(of.is_lidar, 1, 2)) - 1
    found[:] = result.states[last, :2]
    return found


@dataclass(frozen=True, slots=True)
class Contender:
    """Filter in a comparison, and the form in which it gets the measurements.

    Attributes
    ----------
    form : Form
    config : FusionConfig
    noise : Noise
        Noise of the sensors without the added noise; form fixed uses the configuration's.
    """

    form: Form
    config: FusionConfig
    noise: Noise

    def follow(
        self, of: Course, draws: Sequence[NDArray[np.float64]], std: float, *, threads: int
    ) -> list[Run]:
        """Filter every draw of values, each with white noise of `std` on top."""
        targets = [measurements(of, values, self.form, self.noise, std) for values in draws]
        return run_batch(targets, self.config, threads=threads)

    def rmse(
        self, of: Course, draws: Sequence[NDArray[np.float64]], std: float, *, threads: int
    ) -> NDArray[np.float64]:
        """Root mean square errors of x and y of every draw, (N, 2) [m]."""
        squares: list[NDArray[np.float64]] = []
        for start in range(0, len(draws), CHUNK):
            for one in self.follow(of, draws[start : start + CHUNK], std, threads=threads):
                wrong = estimates(one, of, self.form) - of.truth.position
                squares.append(np.nanmean(wrong**2, axis=0))
        return np.sqrt(np.reshape(squares, (-1, 2)))


def draws_of(
    of: Course, level: float, count: int, *, seed: int, first: int = 0
) -> list[NDArray[np.float64]]:
    """Draw values with white noise of a power in dBW, `count` times, numbered from `first`."""
    whole = round(1000 * (level + 100))
    return [
        add_noise(of, power_std(level), np.random.default_rng([20230630, seed, number, whole]))
        for number in range(first, first + count)
    ]


def plane(rmse: NDArray[np.float64]) -> float:
    """Mean over draws of the error in the plane [m]."""
    return float(np.hypot(*rmse.T).mean())
