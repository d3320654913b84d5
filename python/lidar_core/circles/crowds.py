"""Scans of several circles and walls, combined from samples of single circles."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lidar_core.circles.samples import Samples
from lidar_core.circles.scanner import Scanner

_NEAREST_MIDDLE = 1.0
_WALL_LENGTH = (1.0, 6.0)


@dataclass(frozen=True, slots=True)
class Crowds:
    """Scans, with the circle that each ray hit.

    Attributes
    ----------
    scans : ndarray, shape (N, n_beams), float32
        Distances [m]; +inf is a miss.
    owner : ndarray, shape (N, n_beams), int64
        Row of the circle in `circles`; -1 for a wall or nothing.
    circles : ndarray, shape (M, 3), float32
        Centre x, centre y, radius [m], of one scan after the other.
    """

    scans: NDArray[np.float32]
    owner: NDArray[np.int64]
    circles: NDArray[np.float32]


def crowds(
    samples: Samples, scanner: Scanner, *, per_scan: int, walls: int = 0, seed: int = 0
) -> Crowds:
    """Let neighbouring samples share a scan: each ray ends at the nearest object.

    Parameters
    ----------
    samples : Samples
        Single circles.
    scanner : Scanner
        Scanner that the samples were made for.
    per_scan : int
        Circles in every scan, >= 1; fewer in the last one.
    walls : int
        Walls in every scan: straight, 1 to 6 m long, with their middle at least 1 m away.
    seed : int
        Seed of the walls.

    Examples
    --------
    >>> from lidar_core.circles import DatasetConfig, make_samples
    >>> samples = make_samples(DatasetConfig.continuous(circles=7), count=7, seed=1)
    >>> crowds(samples, Scanner(), per_scan=3).scans.shape
    (3, 1081)
    """
    count, beams = -(-len(samples) // per_scan), scanner.n_beams
    single = np.full((count * per_scan, beams), np.inf, np.float32)
    single[: len(samples)] = np.nan_to_num(samples.scans(scanner), nan=np.inf, posinf=np.inf)
    together = single.reshape(count, per_scan, beams)
    nearest = together.argmin(axis=1)
    scans = np.take_along_axis(together, nearest[:, None], axis=1)[:, 0]
    owner = np.where(np.isfinite(scans), nearest + per_scan * np.arange(count)[:, None], -1)
    random = np.random.default_rng([seed, walls])
    noise = samples.range_std[::per_scan, None]
    for _ in range(walls):
        distance = _wall(scanner, count, random)
        distance += noise * random.normal(size=distance.shape)
        is_seen = (distance < scans) & (distance >= scanner.range_min)
        scans = np.where(is_seen, distance.astype(np.float32), scans)
        owner = np.where(is_seen, -1, owner)
    return Crowds(scans, owner, samples.circles)


def _wall(scanner: Scanner, count: int, random: np.random.Generator) -> NDArray[np.float64]:
    """Draw one wall per scan; return its distances (N, n_beams) [m], +inf where a ray misses."""
    ends = scanner.angle_min, scanner.angle_min + scanner.field_of_view
    away = random.uniform(_NEAREST_MIDDLE, scanner.range_max, (count, 1))
    bearing = scanner.bearings() - random.uniform(*ends, (count, 1))
    turn = random.uniform(-np.pi / 2, np.pi / 2, (count, 1))
    half = random.uniform(*_WALL_LENGTH, (count, 1)) / 2
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = away * np.cos(turn) / np.cos(bearing - turn)
        along = away * np.sin(bearing) / np.cos(bearing - turn)  # from its middle
    is_met = (distance > 0) & (distance <= scanner.range_max) & (np.abs(along) <= half)
    return np.where(is_met, distance, np.inf)
