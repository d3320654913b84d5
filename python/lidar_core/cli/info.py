"""`lidar-core info`: what is in a recording."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from lidar_core.cli.common import given

if TYPE_CHECKING:
    from rich.console import Console

    from lidar_core.io import RecordingInfo


def command(
    recording: Annotated[Path, typer.Argument(help="File or folder to look into.")],
    point_time: Annotated[
        str | None, typer.Option(help="Time of each point as field:unit:reference, auto or none.")
    ] = None,
    no_return: Annotated[
        str | None,
        typer.Option(help="What marks a ray without return: auto, zero, nan, max or none."),
    ] = None,
    metadata: Annotated[
        str | None, typer.Option(help="JSON file of an Ouster capture, if not beside it.")
    ] = None,
    recover: Annotated[
        bool,
        typer.Option("--recover", help="Read what is whole in an MCAP that was cut or not closed."),
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Machine-readable output.")] = False,
) -> None:
    """Topics, rates, frames, time span and defects of a recording."""
    from lidar_core.io import ReadOptions, open_recording

    options = ReadOptions.load(
        given({"point_time": point_time, "no_return": no_return, "metadata": metadata,
               "recover": recover or None})
    )  # fmt: skip
    with open_recording(recording, options) as opened:
        info = opened.info()
    if as_json:
        print(json.dumps(info.to_dict(), indent=2))
        return
    from rich.console import Console

    _print(info, Console())


def _print(info: "RecordingInfo", console: "Console") -> None:
    from rich.markup import escape
    from rich.table import Table

    from lidar_core.io.posed import NAMELESS

    console.print(f"[bold]{escape(info.path)}[/bold]  {info.format}")
    if info.start_ns is not None:
        start = f"{info.start_ns // 10**9}.{info.start_ns % 10**9:09d}"
        console.print(f"from {start} s, {info.duration_s:.3f} s long")
    table = Table("topic", "type", "read as", "messages", "Hz", "frames", "rays", "points")
    for column in table.columns:
        column.overflow = "fold"
    for topic in info.topics:
        table.add_row(
            escape(topic.name or NAMELESS),
            escape(topic.type),
            topic.kind,
            str(topic.count),
            "-" if topic.rate_hz is None else f"{topic.rate_hz:.3g}",
            escape(", ".join(name or "(none)" for name in topic.frames)),
            "-" if topic.rays is None else str(topic.rays),
            "-" if topic.points is None else str(topic.points),
        )
    console.print(table)
    for parent, child, is_static in info.transforms:
        how = "static" if is_static else "moving"
        console.print(f"transform {escape(parent)} -> {escape(child or '(none)')}: {how}")
    for name, verdict in info.point_time.items():
        console.print(
            f"point time of {escape(name or NAMELESS)}: {escape(verdict)}", soft_wrap=True
        )
    for name, verdict in info.no_return.items():
        console.print(
            f"rays without return of {escape(name or NAMELESS)}: {escape(verdict)}", soft_wrap=True
        )
    for defect in info.defects:
        console.print(f"[yellow]note[/yellow] {escape(defect)}", soft_wrap=True)
    if not info.defects:
        console.print("no defects found")
