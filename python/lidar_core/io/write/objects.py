"""Objects with numbers over time: what writers for other programs are given."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

SCORE = 1.0
"""Of every track: a tracker that reports one is sure of it."""


class ObjectsLike(Protocol):
    """Objects at one time, one row each, as `lidar_core.viz.Objects` holds them."""

    @property
    def id(self) -> NDArray[np.int64]:
        """Numbers, shape (K,)."""

    @property
    def position(self) -> NDArray[np.float64]:
        """Positions [m], shape (K, 3)."""

    @property
    def velocity(self) -> NDArray[np.float64]:
        """Velocities [m/s], shape (K, 3)."""

    @property
    def covariance(self) -> NDArray[np.float64]:
        """Covariances of the positions [m^2], shape (K, 3, 3)."""

    @property
    def size(self) -> NDArray[np.float64]:
        """Sides of the bounding boxes [m], shape (K, 3); circles have no height; zero: unknown."""


Steps: TypeAlias = Iterable[tuple[int, ObjectsLike]]
"""Times [ns] and the objects at each, in the order of time."""


@dataclass(frozen=True, slots=True)
class RunObjects:
    """Objects of a run.

    Attributes
    ----------
    steps : sequence of (int, Objects)
        Every time that was looked at [ns], also those without objects.
    name : str
        Class of all objects.
    sensors : tuple of str
        Of camera, lidar, radar, map, external: what was used.
    frame_id : str
        Frame of the objects.
    segments : mapping of int to ndarray
        Walls by the times of the steps, both ends (S, 2, 3) [m].
    """

    steps: Sequence[tuple[int, ObjectsLike]]
    name: str
    sensors: tuple[str, ...]
    frame_id: str
    segments: Mapping[int, NDArray[np.float64]]
