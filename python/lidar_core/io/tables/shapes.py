"""Tables and outlines of map elements with other shapes than circles."""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_core.io.tables.columns import Columns
from lidar_core.io.tables.elements import element_columns, element_rows
from lidar_core.io.tables.long_table import write_long_table
from lidar_core.messages import ShapeKind
from lidar_core.objects import ShapeElements

STATE = ("x", "y", "vx", "vy", "heading", "half_length", "half_width")
ENDS = ("x1", "y1", "x2", "y2")
COLUMNS = element_columns(STATE, texts=("kind",), more=ENDS)
"""Columns of the shapes table: SI units, world frame; ends of lines only, NaN for others."""


def write_shapes_table(
    path: str | Path, shapes: Iterable[ShapeElements], *, frame_id: str = "world"
) -> Path:
    """Write the lines, ellipses and rectangles of successive times as one long table.

    Parameters
    ----------
    path : str or Path
        Parquet, if it ends in .parquet and pyarrow is installed; otherwise CSV, ending in .csv.
        Written atomically.
    shapes : iterable of map states
        Shapes as `CirclePipeline.shapes_at` returns them.
    frame_id : str
        Frame of the states.

    Returns
    -------
    path : Path
        File that was written; `read_columns` reads it.
    """
    return write_long_table(path, COLUMNS, element_rows(shapes, frame_id, len(STATE), _values))


def outline(shapes: ShapeElements, row: int, corners: int) -> NDArray[np.float64]:
    """Points of an outline [m]: two of a line, four of a rectangle, `corners` of an ellipse."""
    kind = ShapeKind(int(shapes.kind[row]))
    if kind is ShapeKind.LINE:
        ends: NDArray[np.float64] = shapes.ends[row]
        return ends
    around = _unit(kind, corners) * shapes.half_size[row]
    return _transform(around, shapes.center[row], float(shapes.heading[row]))


def outline_of_row(columns: Columns, row: int, corners: int) -> NDArray[np.float64]:
    """Outline of an element from a row of the shapes table."""
    kind = ShapeKind[str(columns["kind"][row]).upper()]
    values = {name: float(columns[name][row]) for name in (*STATE, *ENDS)}
    if kind is ShapeKind.LINE:
        return np.array([values[name] for name in ENDS]).reshape(2, 2)
    around = _unit(kind, corners) * (values["half_length"], values["half_width"])
    return _transform(around, np.array([values["x"], values["y"]]), values["heading"])


def _unit(kind: ShapeKind, corners: int) -> NDArray[np.float64]:
    """Points of a rectangle or ellipse of half lengths 1."""
    if kind is ShapeKind.RECTANGLE:
        return np.array([(1, 1), (-1, 1), (-1, -1), (1, -1)], np.float64)
    angles = np.linspace(0, 2 * np.pi, corners, endpoint=False)
    return np.stack([np.cos(angles), np.sin(angles)], axis=1)


def _transform(
    around: NDArray[np.float64], center: NDArray[np.float64], heading: float
) -> NDArray[np.float64]:
    cos, sin = np.cos(heading), np.sin(heading)
    points: NDArray[np.float64] = center + around @ np.array([[cos, sin], [-sin, cos]])
    return points


def _values(state: ShapeElements, row: int) -> Sequence[Any]:
    return (
        ShapeKind(int(state.kind[row])).name.lower(),
        *state.center[row].tolist(),
        *state.velocity[row].tolist(),
        float(state.heading[row]),
        *state.half_size[row].tolist(),
        *state.ends[row].ravel().tolist(),
    )
