"""Long tables, a row per object and time, as Parquet or CSV."""

import csv
from collections.abc import Iterable, Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from lidar_core.extras import require
from lidar_core.io.files.atomic import written_whole


def write_long_table(
    path: str | Path, columns: Mapping[str, type], rows: Iterable[Sequence[Any]]
) -> Path:
    """Write rows atomically; return the file that was written.

    Parameters
    ----------
    path : str or Path
        Parquet, if it ends in .parquet and pyarrow is installed; otherwise CSV, ending in .csv.
    columns : mapping of str to type
        Names in the order of the values of a row, each with int, float, bool or str.
    rows : iterable of sequence
        One value per column.
    """
    place = Path(path)
    if place.suffix == ".parquet" and find_spec("pyarrow") is not None:
        _write_parquet(place, columns, list(rows))
        return place
    place = place.with_suffix(".csv")
    with (
        written_whole(place) as temporary,
        temporary.open("w", newline="", encoding="utf-8") as file,
    ):
        writer = csv.writer(file)
        writer.writerow(columns)
        writer.writerows(rows)
    return place


def _write_parquet(place: Path, columns: Mapping[str, type], rows: list[Sequence[Any]]) -> None:
    arrow = require("pyarrow", extra="tables", purpose="writing Parquet")
    parquet = require("pyarrow.parquet", extra="tables", purpose="writing Parquet")
    types = {int: arrow.int64(), float: arrow.float64(), bool: arrow.bool_(), str: arrow.string()}
    schema = arrow.schema([(name, types[sort]) for name, sort in columns.items()])
    values = list(zip(*rows, strict=True)) if rows else [()] * len(columns)
    arrays = [arrow.array(column, field.type) for column, field in zip(values, schema, strict=True)]
    with written_whole(place) as temporary:
        parquet.write_table(arrow.table(arrays, schema=schema), temporary)
