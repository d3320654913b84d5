"""Shared parts of the items: modes, scoring, drawing, and seeds of flights."""

from collections.abc import Sequence
from itertools import pairwise
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from lidar_core.evaluation import EvaluationConfig

Kind: TypeAlias = Literal["detections", "tracks"]
"""What the detector of flying objects gives."""
MODES = ("paper", "best")
KINDS: tuple[Kind, Kind] = ("detections", "tracks")
BLUE, RED, GREY, PALE = "#0369a1", "#be185d", "#9aa5b1", "#d5dae1"
COLOURS = {"paper": RED, "corrected": GREY, "best": BLUE}
"""Colour of each mode."""
TITLES = {"paper": "paper mode", "corrected": "equations corrected", "best": "best mode"}
"""What pictures call it."""
GATE = 2.0
"""Estimates further from every target are false: simulated and real flights alike [m]."""


def evaluation_config(**given: Any) -> EvaluationConfig:
    """Return the scoring: a gate wide enough for a lagging track, or else as `given`.

    The scans of the burn-in are counted by the run: see `flying.simulated.flights.tables`.
    """
    return EvaluationConfig(**{"gate": GATE, **given})


def mean(values: NDArray[Any]) -> float | None:
    """Mean of all values; None without values."""
    return float(values.mean()) if len(values) else None


def share(part: float, whole: float) -> float | None:
    """Return `part` divided by `whole`; None if `whole` is 0."""
    return float(part / whole) if whole else None


def in_space(places: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return places (N, 2) as (N, 3) with z = 0."""
    return np.pad(places, ((0, 0), (0, 1)))


def middles(edges: Sequence[float]) -> list[float]:
    """Middle of each interval between successive `edges`."""
    return [(near + far) / 2 for near, far in pairwise(edges)]


def simulator_seed(seed: int, number: int) -> int:
    """Seed of the noise of flight `number`; different for every flight of every seed."""
    return (seed * 1_000_003 + number) % 2**32


def scene_rng(seed: int, number: int, *more: int) -> np.random.Generator:
    """Generator of the random numbers for the scene of flight `number`."""
    return np.random.default_rng([20240607, seed, number, *more])
