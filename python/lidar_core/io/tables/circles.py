"""Elements of a circle map in tables and trajectory files."""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from lidar_core.io.tables.covariance import covariance_columns
from lidar_core.io.tables.elements import element_columns, element_rows
from lidar_core.io.tables.long_table import write_long_table
from lidar_core.io.tables.tracks import KIND_PROBABILITIES, write_trajectories
from lidar_core.messages import TrackKind
from lidar_core.objects import CircleElements

STATE = ("x", "y", "vx", "vy", "radius")
BELIEFS = ("person_probability", "existence", *KIND_PROBABILITIES)
COLUMNS = element_columns(STATE, texts=("kind",), more=BELIEFS)
"""Columns of the circles table: SI units, world frame."""


def write_circles_table(
    path: str | Path, maps: Iterable[CircleElements], *, frame_id: str = "world"
) -> Path:
    """Write the maps of successive times as one long table atomically.

    Parameters
    ----------
    path : str or Path
        Parquet, if it ends in .parquet and pyarrow is installed; otherwise CSV, ending in .csv.
    maps : iterable of map states
        Maps as `CirclePipeline.map_at` returns them.
    frame_id : str
        Frame of the states.

    Returns
    -------
    path : Path
        File that was written; `read_columns` reads it.
    """
    return write_long_table(path, COLUMNS, element_rows(maps, frame_id, len(STATE), _values))


def map_columns(maps: Iterable[CircleElements], frame_id: str) -> dict[str, Any]:
    """Return every element that successive maps report as columns, one row per element.

    A row has first and last measurement, and the state when the element was last in sight, because
    the place of an element that was passed long ago is still valid.
    """
    first: dict[int, int] = {}
    last: dict[int, tuple[CircleElements, int]] = {}
    for state in maps:
        born = state.stamp_ns - np.round(state.age * 1e9).astype(np.int64)
        for row, number in enumerate(state.id.tolist()):
            first.setdefault(number, int(born[row]))
            if state.visible[row] or number not in last:
                last[number] = state, row
    numbers = sorted(last)
    rows = [last[number] for number in numbers]
    values = np.array(
        [[*state.center[row], *state.velocity[row], state.radius[row]] for state, row in rows]
    ).reshape(-1, len(STATE))
    beliefs = np.array([_beliefs(state, row) for state, row in rows]).reshape(-1, len(BELIEFS))
    covariance = np.array([state.covariance[row] for state, row in rows]).reshape(-1, 5, 5)
    return {
        "track_id": np.array(numbers, np.int64),
        "frame_id": [frame_id] * len(numbers),
        "first_ns": np.array([first[number] for number in numbers], np.int64),
        "last_ns": np.array([int(state.seen_ns[row]) for state, row in rows], np.int64),
        **dict(zip(STATE, values.T, strict=True)),
        "kind": [_kind(state, row) for state, row in rows],
        **dict(zip(BELIEFS, beliefs.T, strict=True)),
        **covariance_columns(STATE, covariance),
    }


def write_circles_tum(folder: str | Path, maps: Iterable[CircleElements]) -> list[Path]:
    """Write one TUM trajectory (t x y 0 qx qy qz qw) per element into `folder`, as `write_tum`."""
    steps = ((m.stamp_ns, m.id, np.pad(m.center, ((0, 0), (0, 1)))) for m in maps)
    return write_trajectories(folder, steps)


def _values(state: CircleElements, row: int) -> Sequence[Any]:
    place, velocity = state.center[row].tolist(), state.velocity[row].tolist()
    numbers = (*place, *velocity, float(state.radius[row]), *_beliefs(state, row))
    return (_kind(state, row), *numbers)


def _kind(state: CircleElements, row: int) -> str:
    return TrackKind(int(state.kind[row])).name.lower()


def _beliefs(state: CircleElements, row: int) -> list[float]:
    """Values of `BELIEFS` of an element: its probabilities of person, existence and kinds."""
    likely = state.kind_probability[row].tolist()
    return [float(state.person_probability[row]), float(state.existence[row]), *likely]
