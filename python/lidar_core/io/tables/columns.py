"""Tables of tracks and of targets, as columns: CSV, Parquet, .npz, TUM trajectories, MCAP."""

import csv
import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from lidar_core.errors import FormatError
from lidar_core.extras import require
from lidar_core.files import check_regular_or_folder
from lidar_core.io.child.client import call
from lidar_core.io.child.trust import is_trusted
from lidar_core.io.files.guard import check_size, reading
from lidar_core.io.files.npy import archive_of, array_in
from lidar_core.io.formats.mcap import McapRecording
from lidar_core.io.options import ReadOptions
from lidar_core.io.poses.pose_files import MAX_FILE_BYTES, read_poses

Columns: TypeAlias = dict[str, NDArray[Any]]
"""Columns of equal length by name; those of `write_tracks_table`, as far as they are known."""

DECIMAL_COMMA = re.compile(r"\s*[+-]?\d*,\d+([eE][+-]?\d+)?\s*")
SEPARATORS = {",": "commas", ";": "semicolons", "\t": "tabs"}
"""What may stand between values; the first of them that the names have does."""
SEPARATOR_LINE = re.compile(r"\"?sep=([,;\t])\"?\s*", re.IGNORECASE)
"""First line by which spreadsheets tell the separator."""
TRACK_FILE = re.compile(r"track_(\d+)\.txt")
RUN_NOTE = "run.toml"
"""File that a folder of a run has: its tables are different ones."""
FOREIGN = (".parquet", ".mcap")
"""Endings of tables that libraries parse."""
SCENE_UPDATE = "foxglove.SceneUpdate"


def read_columns(path: str | Path, *, trusted: bool | None = None) -> Columns:
    """Read a table of tracks or targets.

    Parameters
    ----------
    path : str or Path
        A table with a row per object and time: .csv or .tsv (separated by commas, semicolons or
        tabs; a first line `sep=;` also counts; with semicolons and tabs, numbers may have decimal
        commas), .parquet or .npz (one array per column); a TUM trajectory .txt or .tum, or a folder
        of track_ID.txt as `write_tum` writes it; an MCAP file with tracks as `write_mcap` writes
        it; a folder of .parquet or .csv tables with the same columns, such as tracks/ of a batch,
        one after another.
    trusted : bool, optional
        See `lidar_core.io.open_recording`: with False a child process parses Parquet and MCAP.

    Returns
    -------
    columns : dict of ndarray
        Columns by name, as `write_tracks_table` names them. Trajectories and MCAP have t_ns,
        track_id, x, y, z.

    Raises
    ------
    FormatError
        The file has another format; rows of tables count from 1, below the names of columns.
    LimitError
        More than 256 MiB.
    MissingExtraError
        Parquet without pyarrow, MCAP without mcap.
    """
    place = Path(path)
    if check_regular_or_folder(place).is_dir():
        return _read_folder(place, trusted=trusted)
    suffix = place.suffix.lower()
    if suffix in FOREIGN and not is_trusted(trusted):
        return dict(call("tables.columns:read_in_child", place))
    readers = {
        ".csv": _read_csv,
        ".tsv": _read_csv,
        ".npz": _read_npz,
        ".parquet": _read_parquet,
        ".mcap": _read_mcap,
        ".txt": _read_trajectory,
        ".tum": _read_trajectory,
    }
    reader = readers.get(suffix)
    if reader is None:
        raise FormatError(f"{place}: expected a table: {', '.join(sorted(readers))}, or a folder")
    _check(place, place.stat().st_size)
    columns = reader(place)
    sizes = {name: len(column) for name, column in columns.items()}
    if len(set(sizes.values())) > 1:
        raise FormatError(f"{place}: expected columns of equal length, got {sizes}")
    return columns


def read_in_child(path: Path) -> Columns:
    """Return the result of `read_columns`; for a child process."""
    return read_columns(path, trusted=True)


def _check(place: Path, size: int) -> None:
    check_size(str(place), size, limit=MAX_FILE_BYTES, key="nothing", what="a table of bytes")


def at_row(place: object, row: int) -> str:
    """Name a row of a table in errors: they count from 1, below the names of columns.

    Examples
    --------
    >>> at_row("radar.csv", 0)
    'radar.csv, row 1'
    """
    return f"{place}, row {row + 1}"


def _read_csv(path: Path) -> Columns:
    with reading(str(path)), path.open(newline="", encoding="utf-8-sig") as file:
        first = file.readline()
        told = SEPARATOR_LINE.fullmatch(first)
        if told is None:
            file.seek(0)
        separator = told[1] if told else _separator(first)
        lines = csv.reader(file, delimiter=separator)
        names = next(lines, [])
        _check_names(path, names, separator)
        rows: list[list[str]] = []
        for row in lines:
            if not row:
                continue  # an empty line, as at the end of a file
            if len(row) != len(names):
                raise FormatError(_uneven(path, names, row, separator, len(rows)))
            rows.append(row if separator == "," else [_point(text) for text in row])
    values: Iterable[Sequence[str]] = zip(*rows, strict=True) if rows else [()] * len(names)
    # Spreadsheets write the empty columns beside a table, too.
    return {
        name: _parse(column) for name, column in zip(names, values, strict=True) if name.strip()
    }


def _check_names(path: Path, names: Sequence[str], used: str) -> None:
    """Refuse a first line that cannot be the names of columns."""
    if not any(name.strip() for name in names):
        raise FormatError(f"{path}: expected a first line with the names of columns, got none")
    text = used.join(names)
    others = [other for other in SEPARATORS if other != used and other in text]
    if others or (len(names) == 1 and "|" in text):
        raise FormatError(
            f"{path}: expected {SEPARATORS[used]} between the names of columns, got"
            f" {text!r}; use commas, semicolons or tabs in all lines"
        )
    if len(names) == 1 and len(names[0].split()) > 1:
        raise FormatError(
            f"{path}: expected commas, semicolons or tabs between the names of columns,"
            f" got {names[0]!r}"
        )
    twice = [name for place, name in enumerate(names) if name.strip() and name in names[:place]]
    if twice:
        raise FormatError(f"{path}: column {twice[0]!r} appears twice; remove one of them")


def _uneven(path: Path, names: Sequence[str], row: Sequence[str], used: str, number: int) -> str:
    """Return the error text for a row with another number of values than the names."""
    text = used.join(row)
    others = [other for other in SEPARATORS if other != used and other in text]
    is_mixed = len(row) == 1 and bool(others)
    hint = f" with {SEPARATORS[others[0]]}: use one of both in all lines" if is_mixed else ""
    return (
        f"{at_row(path, number)}: expected {len(names)} values with {SEPARATORS[used]} between"
        f" them, as the names of columns have, got {len(row)}{hint}"
    )


def _separator(names: str) -> str:
    """Return the separator of the names of columns: a comma, semicolon or tab."""
    return next((one for one in SEPARATORS if one in names), ",")


def _point(text: str) -> str:
    """Replace the decimal comma of a number by a point; other texts do not change."""
    return text.replace(",", ".") if DECIMAL_COMMA.fullmatch(text) else text


def _parse(column: Sequence[str]) -> NDArray[Any]:
    """Parse a column as integers, if all values are, else as numbers, else as text."""
    for dtype, parse in ((np.int64, int), (np.float64, float)):
        try:
            return np.array([parse(text) for text in column], dtype)
        except (ValueError, OverflowError):
            continue
    return np.array(column, np.str_)


def _read_npz(path: Path) -> Columns:
    with reading(str(path)), archive_of(path) as archive:
        _check(path, sum(member.file_size for member in archive.infolist()))
        names = [name.removesuffix(".npy") for name in archive.namelist()]
        columns = {
            name: array_in(archive, name, what="column", limit=MAX_FILE_BYTES, key="nothing")
            for name in names
        }
    for name, column in columns.items():
        if column.ndim != 1:
            raise FormatError(
                f"{path}: {name}: expected one dimension, got shape"
                f" {column.shape}; a recording of scans is no table"
            )
    return columns


def _read_parquet(path: Path) -> Columns:
    parquet = require("pyarrow.parquet", extra="tables", purpose="reading Parquet")
    with reading(str(path)), parquet.ParquetFile(path) as file:
        _check(path, file.metadata.num_rows * file.metadata.num_columns * 8)
        table = file.read()
        return {name: table[name].to_numpy() for name in table.column_names}


def tables_of(folder: Path) -> list[Path]:
    """Return the tables of a folder that are read as one, such as tracks/ of a batch, by name."""
    endings = {".csv", ".parquet"}
    return sorted(one for one in folder.iterdir() if one.suffix in endings and one.is_file())


def read_tables(files: Sequence[Path], *, trusted: bool | None = None) -> Columns:
    """Read tables with the same columns as one table, in their order.

    Raises
    ------
    FormatError
        Their columns differ; errors of `read_columns`.
    LimitError
        All together more than one table may have.
    """
    _check(files[0].parent, sum(file.stat().st_size for file in files))
    parts = [read_columns(one, trusted=trusted) for one in files]
    for file, part in zip(files, parts, strict=True):
        if list(part) != list(parts[0]):
            raise FormatError(
                f"{file}: expected the columns of {files[0].name}, to read the folder as one table;"
                " give one table, or a folder of like tables, such as tracks/ of a batch"
            )
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def _read_folder(folder: Path, *, trusted: bool | None) -> Columns:
    files = sorted(path for path in folder.iterdir() if TRACK_FILE.fullmatch(path.name))
    if files:
        return _read_trajectories(folder, files)
    tables = tables_of(folder)
    if (folder / RUN_NOTE).is_file():
        names = ", ".join(table.name for table in tables) or "none"
        raise FormatError(f"{folder}: the folder of a run has several tables; give one of {names}")
    if not tables:
        raise FormatError(
            f"{folder}: expected a run folder, or one with files track_ID.txt, or with tables"
            " (.parquet, .csv)"
        )
    return read_tables(tables, trusted=trusted)


def _read_trajectories(folder: Path, files: Sequence[Path]) -> Columns:
    _check(folder, sum(path.stat().st_size for path in files))
    parts = [_read_trajectory(path) for path in files]
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def _read_trajectory(path: Path) -> Columns:
    """Read a TUM trajectory; the track ID is the number in the file's name, else 0."""
    stamps, poses = read_poses(path)
    if stamps is None:
        raise FormatError(f"{path}: expected TUM lines, t x y z qx qy qz qw; these have no times")
    named = TRACK_FILE.fullmatch(path.name)
    numbers = np.full(len(stamps), int(named[1]) if named else 0)
    return {"t_ns": stamps, "track_id": numbers, **_by_axis(poses[:, :3, 3])}


def _read_mcap(path: Path) -> Columns:
    rows, places = [], []
    with McapRecording(path, ReadOptions()) as recording:
        for place, message in recording.foxglove(SCENE_UPDATE):
            for entity in message.entities:
                bodies = [*entity.cubes, *entity.cylinders]
                if not entity.id.isdecimal() or len(entity.id) > 18 or not bodies:
                    raise FormatError(
                        f"{place}: entity {entity.id!r}: expected a track"
                        " ID as name, and a cube or cylinder"
                    )
                stamp, position = entity.timestamp, bodies[0].pose.position
                rows.append((stamp.seconds * 1_000_000_000 + stamp.nanos, int(entity.id)))
                places.append((position.x, position.y, position.z))
    numbers = np.array(rows, np.int64).reshape(-1, 2)
    return {
        "t_ns": numbers[:, 0],
        "track_id": numbers[:, 1],
        **_by_axis(np.array(places, np.float64).reshape(-1, 3)),
    }


def _by_axis(position: NDArray[np.float64]) -> Columns:
    return {name: position[:, axis] for axis, name in enumerate("xyz")}
