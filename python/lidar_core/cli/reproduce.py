"""`lidar-core reproduce`: tables and figures of the papers, beside the papers' numbers."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lidar_core.cli.shared.common import (
    INTERRUPTED,
    JsonFile,
    Threads,
    consoles,
    shown_progress,
    write_json,
)
from lidar_core.cli.shared.voice import tell

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from lidar_core.reproduce import Item, Result

ALL = "all"
FRESH = "Compute every part again, even those that an earlier run of this build finished."


def command(
    item: Annotated[
        str | None, typer.Argument(help="Item to run, or all; without it, the items are listed.")
    ] = None,
    *,
    scans: Annotated[
        int | None,
        typer.Option(
            min=1,
            help="Length of the run, in the unit of ITEM, such as scans or samples; a small"
            " number gives a quick look.",
        ),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of all random numbers.")] = 0,
    output: Annotated[
        Path, typer.Option("--output", "-o", help="Folder for ITEM.png, ITEM.json, ITEM.toml.")
    ] = Path("runs/reproduce"),
    fresh: Annotated[bool, typer.Option("--fresh", help=FRESH)] = False,
    picture: Annotated[bool, typer.Option(help="Draw ITEM.png (extra `plot`).")] = True,
    threads: Threads,
    json: JsonFile = None,
) -> None:
    """Reproduce a table or figure of the papers, with the paper's value and those of both modes.

    Paper mode is the algorithm as published. If its equations contradict each other, one more
    column shows the result with corrected equations.

    Ctrl-C leaves complete files; the same command continues where it stopped.
    """
    from lidar_core.reproduce import item_named, items
    from lidar_core.runs.reproduction import ReproduceJob

    out, errors = consoles(json)
    if item is None:
        out.print(_list(items()))
        return
    chosen = _all(errors) if item == ALL else [item_named(item)]
    for one in chosen:
        length = scans or one.scans
        text = f"{one.name}: {length:,} {one.counts}, about {one.duration(length)} on two cores"
        tell(errors, text)
    job = ReproduceJob(
        output, seed=seed, scans=scans, threads=threads, is_fresh=fresh, draws=picture
    )
    done: list[dict[str, Any]] = []
    try:
        for one in chosen:
            with shown_progress(errors, counts=one.counts) as on_progress:
                result = job.run(one, on_progress)
            values, notes = job.write(one, result)
            done.append(values)
            for note in notes:
                tell(errors, note)
            out.print(_table(one, result))
            if str(json) != "-":  # a file holds what is finished, at any time
                write_json(done if item == ALL else done[0], json)
    except KeyboardInterrupt as stop:
        errors.print("interrupted: run the same command to resume")
        raise typer.Exit(INTERRUPTED) from stop
    if str(json) == "-":
        write_json(done if item == ALL else done[0], json)
    out.print(f"{output}: {', '.join(job.files)}", highlight=False, soft_wrap=True)


def _all(console: "Console") -> "list[Item]":
    """Return every item whose recordings are available; print the names of the others."""
    from lidar_core.reproduce import items
    from lidar_core.reproduce.recordings import FOLDER, is_missing

    missing = [one.name for one in items().values() if is_missing(one.data)]
    if missing:
        console.print(
            f"left out, {FOLDER} does not hold their recordings: {', '.join(missing)}",
            highlight=False,
            soft_wrap=True,
        )
    return [one for one in items().values() if one.name not in missing]


def _list(items: "dict[str, Item]") -> "Table":
    from rich.table import Table

    table = Table(title="lidar-core reproduce ITEM", title_justify="left", title_style="bold")
    table.add_column("item", no_wrap=True)
    for column in ("shows", "full run", "on two cores"):
        table.add_column(column, overflow="fold")
    for item in items.values():
        length = f"{item.scans:,} {item.counts}"
        table.add_row(item.name, item.title, length, item.duration(item.scans))
    return table


def _table(item: "Item", result: "Result") -> "Table":
    from rich.markup import escape
    from rich.table import Table

    from lidar_core.reproduce import COLUMNS

    table = Table(
        title=escape(f"{item.name}: {item.title} ({result.scans:,} {item.counts})"),
        title_justify="left",
        title_style="bold",
        caption=escape(result.note),
        caption_justify="left",
    )
    table.add_column("", style="cyan", overflow="fold")
    table.add_column("unit", style="dim")
    columns = _columns(result)
    for column in columns:
        table.add_column(COLUMNS[column], justify="right")
    for row in result.rows:
        values = (getattr(row, column) for column in columns)
        table.add_row(escape(row.name), escape(row.unit), *map(_number, values))
    return table


def _columns(result: "Result") -> list[str]:
    """Names of the columns of numbers; corrected equations only if the item has such values."""
    from lidar_core.reproduce import COLUMNS

    has_corrected = any(row.equations_corrected is not None for row in result.rows)
    return [name for name in COLUMNS if name != "equations_corrected" or has_corrected]


def _number(value: float | None) -> str:
    """Format counts exactly, others to three decimals, small ones to three digits; None as dash."""
    if value is None:
        return "-"
    if float(value).is_integer():
        return f"{value:,.0f}"
    return f"{value:.3f}" if abs(value) >= 0.1 else f"{value:.3g}"
