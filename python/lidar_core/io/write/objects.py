"""Numbered objects over time: the input of writers for other programs."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from lidar_core.objects import Objects

SCORE = 1.0
"""Of every track: a tracker that reports one is sure of it."""


Steps: TypeAlias = Iterable[tuple[int, Objects]]
"""Times [ns] and the objects at each, in the order of time."""


@dataclass(frozen=True, slots=True)
class RunObjects:
    """Objects of a run.

    Attributes
    ----------
    steps : sequence of (int, Objects)
        All processed times [ns], also those without objects.
    name : str
        Class of all objects.
    sensors : tuple of str
        Sensors that were used, of camera, lidar, radar, map, external.
    frame_id : str
        Frame of the objects.
    segments : mapping of int to ndarray
        Walls by the times of the steps, both ends (S, 2, 3) [m].
    """

    steps: Sequence[tuple[int, Objects]]
    name: str
    sensors: tuple[str, ...]
    frame_id: str
    segments: Mapping[int, NDArray[np.float64]]
