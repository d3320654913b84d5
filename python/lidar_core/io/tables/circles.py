"""Elements of a circle map in tables and trajectory files."""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from lidar_core.io.tables.elements import element_columns, element_rows
from lidar_core.io.tables.long_table import write_long_table
from lidar_core.io.tables.tracks import write_trajectories
from lidar_core.objects import CircleElements

STATE = ("x", "y", "vx", "vy", "radius")
COLUMNS = element_columns(STATE, more=("person_probability",))
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
    return write_long_table(path, COLUMNS, element_rows(maps, frame_id, len(STATE), _values))


def write_circles_tum(folder: str | Path, maps: Iterable[CircleElements]) -> list[Path]:
    """Write one TUM trajectory (t x y 0 qx qy qz qw) per element into `folder`, as `write_tum`."""
    steps = ((m.stamp_ns, m.id, np.pad(m.center, ((0, 0), (0, 1)))) for m in maps)
    return write_trajectories(folder, steps)


def _values(state: CircleElements, row: int) -> Sequence[Any]:
    place, velocity = state.center[row].tolist(), state.velocity[row].tolist()
    person = float(state.person_probability[row])
    return (*place, *velocity, float(state.radius[row]), person)
