"""Table of sightings of targets, for means over any group of them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lidar_core.evaluation import EvaluationConfig, pair
from lidar_core.reproduce.common import Kind
from lidar_core.reproduce.flying.simulated.flights import tables
from lidar_core.reproduce.jobs import Part

RATES = ("velocity", "acceleration")


@dataclass(frozen=True, slots=True)
class Sightings:
    """Times at which a target was required, over several flights.

    Attributes
    ----------
    scan : ndarray, shape (N,), float64
        Number of the scan in its flight.
    distance, speed, acceleration : ndarray, shape (N,), float64
        Distance from the sensor [m]; speed [m/s] and acceleration [m/s^2] of the target.
    error : ndarray, shape (N,), float64
        Distance to its detection or track [m]; NaN where it has none.
    along : ndarray, shape (N,), float64
        Position error along the line of sight, positive behind the centre [m].
    """

    scan: NDArray[np.float64]
    distance: NDArray[np.float64]
    speed: NDArray[np.float64]
    acceleration: NDArray[np.float64]
    error: NDArray[np.float64]
    along: NDArray[np.float64]

    @property
    def is_found(self) -> NDArray[np.bool_]:
        """Return whether there is a detection or track."""
        return np.isfinite(self.error)


def sightings(
    parts: Sequence[Part], name: str, kind: Kind, *, target: int, config: EvaluationConfig
) -> Sightings:
    """Sightings of one target of every flight by the configuration `name`."""
    columns = [_columns(part, name, kind, target, config) for part in parts]
    return Sightings(*np.concatenate(columns, axis=1))


def _columns(
    part: Part, name: str, kind: Kind, target: int, config: EvaluationConfig
) -> NDArray[np.float64]:
    """Rows of `Sightings` of one flight."""
    estimates, truth = tables(part, name, kind, config=config)
    partner = pair(estimates, truth, config=config).estimate_of
    count = len(part["id"])
    chosen = np.flatnonzero(truth.is_eligible & (np.arange(len(partner)) % count == target))
    scan, partner = chosen // count, partner[chosen]
    sight = truth.position[chosen] - part["sensor"][scan]
    distance = np.linalg.norm(sight, axis=1)
    away = np.full((len(chosen), 3), np.nan)
    is_found = partner >= 0
    away[is_found] = estimates.position[partner[is_found]] - truth.position[chosen[is_found]]
    speeds = (np.linalg.norm(part[name][scan, target], axis=1) for name in RATES)
    error = np.linalg.norm(away, axis=1)
    return np.stack([scan, distance, *speeds, error, np.sum(away * sight, axis=1) / distance])
