"""Shared parts of the items about networks: circle estimators, and errors of circles."""

from functools import cache

import numpy as np
from numpy.typing import NDArray

from lidar_core.circles import CircleDetector, CircleNetwork, Samples, Scanner
from lidar_core.circles.estimators.detector_name import shipped
from lidar_core.circles.samples import HITS

PAPER_NETWORK = "paper-cnn"
MEASURES = {"MSE": "m^2", "MAE": "m", "p99": "m"}
"""Of the errors of x, y and radius of all circles, and their units; p99 is that of circles."""
_ROWS = 2048


@cache  # every job of an item asks, and a network is read whole
def checksums() -> dict[str, str]:
    """SHA-256 of the networks that come with the package, by name."""
    return {name: str(CircleNetwork(name).card["sha256"]) for name in shipped()}


def errors_of(detector: CircleDetector, samples: Samples, scanner: Scanner) -> NDArray[np.float64]:
    """Errors of x, y and radius of a detector on the samples, shape (N, 3) [m]."""
    bearings, found = scanner.bearings(), []
    for start in range(0, len(samples), _ROWS):
        rows = samples.take(np.arange(start, min(start + _ROWS, len(samples))))
        found.append(np.asarray(detector.detect(rows.scans(scanner), bearings)) - rows.circles)
    return np.concatenate(found)


def measures(errors: NDArray[np.float64]) -> list[float | None]:
    """Values of `MEASURES`; None where there are no errors."""
    if not len(errors):
        return [None] * len(MEASURES)
    per_circle = np.abs(errors).mean(axis=1)
    values = (np.square(errors).mean(), per_circle.mean(), np.quantile(per_circle, 0.99))
    return [float(value) for value in values]


def groups(hits: NDArray[np.int64], is_whole: NDArray[np.bool_]) -> dict[str, NDArray[np.bool_]]:
    """Return groups of circles: all, whole and cut ones, and by number of hits."""
    found = {
        "all": np.ones(len(hits), np.bool_),
        "whole, 4 hits or more": is_whole & (hits >= 4),
        "cut": ~is_whole,
    }
    for low, high in HITS:
        found[hits_name(low, high)] = (hits >= low) & (hits <= (np.inf if high is None else high))
    return found


def hits_name(low: int, high: int | None) -> str:
    """Name of the group of circles with `low` to `high` hits; None: no upper limit."""
    if high is None:
        return f"{low} or more hits"
    return f"{low} hits" if low == high else f"{low} to {high} hits"
