"""Columns of tables as numbers, times and truth."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lidar_core.errors import FormatError, InputError
from lidar_core.fusion.recordings.columns.conventions import A_TIME, stamps_of_texts
from lidar_core.fusion.recordings.reading import TargetTruth
from lidar_core.io.tables.columns import Columns, at_row

POSITION, VELOCITY = ("true_x", "true_y"), ("true_vx", "true_vy")
TRUE_ID = "true_id"
POSE_STD = ("pose_std_x", "pose_std_y", "pose_std_yaw")
MAX_SECONDS = 9e9
"""Largest time that int64 nanoseconds hold [s]."""


def numbers_in(place: Path, columns: Columns, name: str) -> NDArray[np.float64]:
    """Return a column as numbers; empty cells are NaN."""
    column = columns[name]
    if column.dtype.kind in "fiub":
        return column.astype(np.float64)
    numbers = np.empty(len(column))
    for row, text in enumerate(column.tolist()):
        try:
            numbers[row] = float(text) if text not in ("", None) else np.nan
        except (TypeError, ValueError) as error:
            raise _refused(place, row, name, text) from error
    return numbers


def _refused(place: Path, row: int, name: str, value: object) -> FormatError:
    """Return the error of a cell that holds no number, or no time."""
    what = f"column {name}: expected {A_TIME if name == 't_ns' else 'a number'}, got {value!r}"
    cure = "" if name == "t_ns" else "; leave cells of unknown values empty"
    return FormatError(f"{at_row(place, row)}: {what}{cure}")


def scaled(place: Path, columns: Columns, factors: Mapping[str, float]) -> Columns:
    """Return the columns with those in `factors` multiplied; the others do not change.

    Raises
    ------
    InputError
        There is no such column.
    """
    for name in factors:
        if name not in columns:
            raise InputError(f"{place}: scale: no column {name} among {', '.join(columns)}")
    return columns | {
        name: factor * numbers_in(place, columns, name) for name, factor in factors.items()
    }


def stamps_in(place: Path, columns: Columns, unit_ns: int) -> NDArray[np.int64]:
    """Times [ns] of the column t_ns, whose numbers count `unit_ns`, or which holds ISO 8601 texts.

    Raises
    ------
    FormatError
        There is no such column, or a cell holds no time.
    """
    if "t_ns" not in columns:
        raise FormatError(
            f"{place}: no column t_ns among {', '.join(columns) or 'none'}; name the column of"
            ' times with columns={"t_ns": "NAME"}'
        )
    column, limit = columns["t_ns"], MAX_SECONDS * 1e9 / unit_ns
    if column.dtype.kind == "U":
        texts = stamps_of_texts(column, str(place))
        if texts is not None:
            return texts
    numbers = numbers_in(place, columns, "t_ns")
    bad = np.logical_not(np.abs(numbers) <= limit)  # NaN is bad, too
    if bad.any():
        row = int(np.argmax(bad))
        raise _refused(place, row, "t_ns", column[row])
    if column.dtype.kind in "iu":
        return column.astype(np.int64) * unit_ns
    stamps: NDArray[np.int64] = np.round(numbers * unit_ns).astype(np.int64)
    return stamps


def truth_in(
    place: Path, columns: Columns, stamps: NDArray[np.int64], rows: NDArray[np.int64]
) -> TargetTruth | None:
    """Truth of these rows of a table: positions, and velocities if there are any.

    Raises
    ------
    InputError
        A column of a pair is there without the other, or velocities without positions.
    FormatError
        A value of a row that is of a target is not finite.
    """
    given = [name for name in (*POSITION, *VELOCITY) if name in columns]
    if not given:
        return None
    needed = (*POSITION, *(VELOCITY if set(VELOCITY) & set(given) else ()))
    missing = [name for name in needed if name not in columns]
    if missing:
        raise InputError(
            f"{place}: {', '.join(given)} without {', '.join(missing)}; the truth is true_x and"
            " true_y, if known with true_vx and true_vy: name the column with"
            f' columns={{"{missing[0]}": "NAME"}}'
        )
    values = np.full((len(rows), 4), np.nan)
    for column, name in enumerate(needed):
        values[:, column] = numbers_in(place, columns, name)[rows]
    targets = targets_in(place, columns, rows)
    known = values[:, : len(needed)] if targets is None else values[targets >= 0, : len(needed)]
    if not np.isfinite(known).all():  # rows of clutter have no truth
        raise FormatError(f"{place}: a true value is not finite; leave the columns true_* out")
    return TargetTruth(stamps[rows], values[:, :2], values[:, 2:], None, None)


def targets_in(place: Path, columns: Columns, rows: NDArray[np.int64]) -> NDArray[np.int64] | None:
    """Target IDs of these rows, -1 for none; None if the table has no such column."""
    if TRUE_ID not in columns:
        return None
    numbers = numbers_in(place, columns, TRUE_ID)[rows]
    return np.where(np.isfinite(numbers), numbers, -1).astype(np.int64)


def pose_covariances(place: Path, columns: Columns, angle: float) -> dict[int, NDArray[np.float64]]:
    """Covariances of the pose by row number, for rows in which all its deviations are positive."""
    if not set(POSE_STD) <= set(columns):
        return {}
    scales = (1.0, 1.0, angle)
    stds = np.stack(
        [
            numbers_in(place, columns, name) * scale
            for name, scale in zip(POSE_STD, scales, strict=True)
        ],
        axis=1,
    )
    whole = np.isfinite(stds).all(axis=1) & (stds > 0).all(axis=1)
    return {row: np.diag(stds[row] ** 2) for row in np.flatnonzero(whole).tolist()}
