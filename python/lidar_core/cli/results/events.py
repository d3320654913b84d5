"""`lidar-core events`: rows of the tables of runs and batches for which a query is true."""

from math import isnan
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lidar_core.cli.shared.common import (
    JsonFile,
    OverwriteFile,
    aligned,
    check_new,
    consoles,
    write_json,
)
from lidar_core.cli.shared.voice import tell

if TYPE_CHECKING:
    from lidar_core.io.tables.columns import Columns

SHOWN = (
    *("recording", "track_id", "kind", "event", "time"),
    *("x", "y", "z", "speed", "distance", "duration"),
)
"""Columns on the console besides those of the query, as far as the table has them."""
MOST_ROWS, MOST_TEXTS = 40, 12
QUERY = "Such as \"distance < 20 and event == 'lost'\"; columns: see `lidar-core events all TABLE`."
TABLE = "Folder of a run or a batch, table (.parquet, .csv), or folder of tables such as tracks/."


def command(
    query: Annotated[str, typer.Argument(help=QUERY)],
    table: Annotated[str, typer.Argument(help=TABLE)],
    *,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="Also write the rows: .csv, or .parquet."),
    ] = None,
    overwrite: OverwriteFile = False,
    json: JsonFile = None,
) -> None:
    """List the events in TABLE for which QUERY is true.

    Events are first_sight, closest_approach and lost. The QUERY `all` lists every row.
    """
    from tempfile import TemporaryDirectory

    from lidar_core.io.remote import fetched, is_remote
    from lidar_core.runs.catalogue import columns_named, matching_rows, read_table
    from lidar_core.runs.catalogue.names import listed_columns

    if output is not None:
        _check_output(output, overwrite=overwrite)
    with TemporaryDirectory(prefix="lidar-core-events-") as scratch:
        place = fetched(table, Path(scratch)) if is_remote(table) else Path(table)
        columns = read_table(place)
    rows = columns if query == "all" else matching_rows(columns, query)
    count, total = (len(next(iter(one.values()), ())) for one in (rows, columns))
    out, errors = consoles(json)
    shown = [name for name in SHOWN if name in rows] or list(rows)[: len(SHOWN)]
    named = columns_named(query)
    shown += [name for name in rows if name in named and name not in shown]
    lines = aligned({name: _texts(rows[name][:MOST_ROWS]) for name in shown})
    out.print("\n".join(lines), markup=False, highlight=False, soft_wrap=True)
    more = f", the first {MOST_ROWS} are shown (-o FILE.csv: all)" if count > MOST_ROWS else ""
    told = listed_columns(list(columns) if query == "all" else shown, len(columns))
    out.print(f"{count} of {total} rows{more}; columns: {told}", soft_wrap=True, markup=False)
    if total and (unknown := _unknown(columns, query)):
        errors.print(f"note: {', '.join(unknown)}: unknown in all rows", highlight=False)
    for note in _absent(columns, query) if total and query != "all" else ():
        tell(errors, note)
    if output is not None:
        _write(rows, output)
    write_json([_plain_row(rows, row) for row in range(count)] if json else [], json)


def _unknown(columns: "Columns", query: str) -> list[str]:
    """Names of columns in the query that have no value, so that no comparison is true."""
    from lidar_core.runs.catalogue import columns_named

    named = columns_named(query)
    return [
        name
        for name, values in columns.items()
        if name in named and values.dtype.kind == "f" and all(map(isnan, values.tolist()))
    ]


def _absent(columns: "Columns", query: str) -> list[str]:
    """Notes on texts in the query that no row has, with the texts that occur."""
    from lidar_core.runs.catalogue import absent_texts

    notes = []
    for name, text, held in absent_texts(columns, query):
        more = f" and {len(held) - MOST_TEXTS} more" if len(held) > MOST_TEXTS else ""
        known = ", ".join(held[:MOST_TEXTS]) + more
        notes.append(f"note: {name}: no row has {text!r}; the values are {known}")
    return notes


def _texts(values: Any) -> list[str]:
    return [f"{one:.2f}" if isinstance(one, float) else str(one) for one in values.tolist()]


def _plain_row(rows: "Columns", row: int) -> dict[str, Any]:
    """Return one row for JSON; an unknown value is null."""
    values = {name: column[row : row + 1].tolist()[0] for name, column in rows.items()}
    return {
        name: None if isinstance(value, float) and isnan(value) else value
        for name, value in values.items()
    }


def _check_output(output: Path, *, overwrite: bool) -> None:
    from lidar_core.errors import ConfigError
    from lidar_core.io.files.atomic import check_place

    if output.suffix not in {".csv", ".parquet"}:
        raise ConfigError(f"output: expected a file that ends in .csv or .parquet, got {output}")
    check_new(output, overwrite=overwrite)
    check_place(output)


def _write(rows: "Columns", output: Path) -> None:
    from lidar_core.io.tables.long_table import write_long_table

    kinds = {"i": int, "u": int, "f": float, "b": bool}
    columns = {name: kinds.get(values.dtype.kind, str) for name, values in rows.items()}
    write_long_table(
        output, columns, zip(*(values.tolist() for values in rows.values()), strict=True)
    )
