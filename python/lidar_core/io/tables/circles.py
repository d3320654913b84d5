"""Elements of a circle map in tables and trajectory files."""

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from lidar_core.io.tables.covariance import covariance_titles, upper_triangle
from lidar_core.io.tables.long_table import write_long_table
from lidar_core.io.tables.tracks import write_trajectories
from lidar_core.objects import CircleElements

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


def write_circles_table(
    path: str | Path, maps: Iterable[CircleElements], *, frame_id: str = "world"
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


def write_circles_tum(folder: str | Path, maps: Iterable[CircleElements]) -> list[Path]:
    """Write one TUM trajectory (t x y 0 qx qy qz qw) per element into `folder`, as `write_tum`."""
    steps = ((m.stamp_ns, m.id, np.pad(m.center, ((0, 0), (0, 1)))) for m in maps)
    return write_trajectories(folder, steps)


def _rows(maps: Iterable[CircleElements], frame_id: str) -> Iterator[Sequence[Any]]:
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
