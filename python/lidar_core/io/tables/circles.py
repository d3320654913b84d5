"""Elements of a circle map in tables and trajectory files."""

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from lidar_core.io.tables.covariance import covariance_titles, upper_triangle
from lidar_core.io.tables.long_table import write_long_table
from lidar_core.io.tables.tracks import write_trajectories

STATE = ("x", "y", "vx", "vy", "radius")
COLUMNS: dict[str, type] = {
    "t_ns": int,
    "track_id": int,
    "frame_id": str,
    **dict.fromkeys(STATE, float),
    "age": float,
    "visible": int,
    **dict.fromkeys(covariance_titles(STATE), float),
}
"""Columns of the circles table: SI units, world frame."""


class ElementsLike(Protocol):
    """Elements of a map at one time, one row per element."""

    @property
    def id(self) -> NDArray[np.int64]:
        """Numbers of the elements, shape (M,)."""

    @property
    def center(self) -> NDArray[np.float64]:
        """Centres [m], world frame, shape (M, 2)."""

    @property
    def velocity(self) -> NDArray[np.float64]:
        """Velocities [m/s], shape (M, 2)."""

    @property
    def covariance(self) -> NDArray[np.float64]:
        """Covariances of the N numbers of the state, shape (M, N, N)."""

    @property
    def age(self) -> NDArray[np.float64]:
        """Time since the first measurement [s], shape (M,)."""

    @property
    def visible(self) -> NDArray[np.bool_]:
        """Whether the sensor can see each element, shape (M,)."""

    @property
    def stamp_ns(self) -> int:
        """Time of the states [ns]."""


class CirclesLike(ElementsLike, Protocol):
    """Circles as `CirclePipeline.map_at` gives them; covariances are of x, y, vx, vy, radius."""

    @property
    def radius(self) -> NDArray[np.float64]:
        """Radii [m], shape (M,)."""


def write_circles_table(
    path: str | Path, maps: Iterable[CirclesLike], *, frame_id: str = "world"
) -> Path:
    """Write the maps of successive times as one long table, whole or not at all.

    Parameters
    ----------
    path : str or Path
        Parquet, if it ends in .parquet and pyarrow is installed; otherwise CSV, ending in .csv.
    maps : iterable of map states
        As `CirclePipeline.map_at` gives them.
    frame_id : str
        Frame of the states.

    Returns
    -------
    path : Path
        File that was written; `read_columns` reads it.
    """
    return write_long_table(path, COLUMNS, _rows(maps, frame_id))


def write_circles_tum(folder: str | Path, maps: Iterable[CirclesLike]) -> list[Path]:
    """Write one TUM trajectory (t x y 0 qx qy qz qw) per element into `folder`, as `write_tum`."""
    steps = ((m.stamp_ns, m.id, np.pad(m.center, ((0, 0), (0, 1)))) for m in maps)
    return write_trajectories(folder, steps)


def _rows(maps: Iterable[CirclesLike], frame_id: str) -> Iterator[Sequence[Any]]:
    for state in maps:
        covariance = upper_triangle(state.covariance, len(STATE)).tolist()
        for row, number in enumerate(state.id.tolist()):
            yield (
                int(state.stamp_ns),
                number,
                frame_id,
                *state.center[row].tolist(),
                *state.velocity[row].tolist(),
                float(state.radius[row]),
                float(state.age[row]),
                int(state.visible[row]),
                *covariance[row],
            )
