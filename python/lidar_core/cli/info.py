"""`lidar-core info`: content of a recording."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from lidar_core.cli.shared.common import as_options, printing
from lidar_core.cli.shared.run_options import DecodingOptions, with_options

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from lidar_core.io import RecordingInfo


UNBROKEN = 1000
"""Least width of what goes to no terminal (characters)."""


def _print_formats() -> None:
    from rich.console import Console
    from rich.table import Table

    from lidar_core.io.readers import READERS

    table = Table("Format", "Files", "Extra", "")
    for one in READERS.parts():
        table.add_row(one.name, " ".join(one.suffixes), one.extra, one.note)
    Console().print(table)


@with_options(DecodingOptions)
def command(
    options: DecodingOptions,
    *,
    recording: Annotated[
        Path, typer.Argument(help="File or folder to inspect; --formats lists the formats.")
    ],
    as_json: Annotated[bool, typer.Option("--json", help="Print the result as JSON.")] = False,
    formats: Annotated[
        bool,
        typer.Option(
            "--formats",
            callback=printing(_print_formats),
            is_eager=True,
            help="List the input formats.",
        ),
    ] = False,
) -> None:
    """List topics, rates, frames, time span and defects of RECORDING; suggest next commands."""
    from lidar_core.io import ReadOptions, open_recording
    from lidar_core.runs.next_steps import next_steps

    with open_recording(recording, ReadOptions.load(options.to_values())) as opened:
        info = opened.info()
        steps = [] if as_json else list(next_steps(opened, info))
    if as_json:
        print(json.dumps(info.to_dict(), indent=2))
        return
    from rich.console import Console

    console = Console()
    if not console.is_terminal:
        console.width = max(console.width, UNBROKEN)  # a name in a pipe stays whole
    _print(info, steps, console)


def _print(info: "RecordingInfo", steps: list[str], console: "Console") -> None:
    from rich.markup import escape

    from lidar_core.io.scan_topics import NAMELESS

    console.print(f"[bold]{escape(info.path)}[/bold]  {info.format}", soft_wrap=True)
    if info.start_ns is not None:
        start = f"{info.start_ns // 10**9}.{info.start_ns % 10**9:09d}"
        console.print(f"from {start} s, {info.duration_s:.3f} s long")
    console.print(_topics_table(info))
    for parent, child, is_static in info.transforms:
        how = "static" if is_static else "moving"
        what = f"transform {escape(parent)} -> {escape(child)}"
        if not child:  # as of PoseStamped, which names one frame
            what = f"poses in {escape(parent)} of a body without a frame name"
        console.print(f"{what}: {how}", soft_wrap=True)
    for name, verdict in info.point_time.items():
        console.print(
            f"point time of {escape(name or NAMELESS)}: {escape(verdict)}", soft_wrap=True
        )
    for name, verdict in info.no_return.items():
        console.print(
            f"rays without return of {escape(name or NAMELESS)}: {escape(verdict)}", soft_wrap=True
        )
    for name, (decoded, total) in info.looked_at.items():
        console.print(
            f"looked at the first {decoded:,} of {total:,} scans of {escape(name)}", soft_wrap=True
        )
    for defect in info.defects:
        console.print(f"[yellow]note[/yellow] {escape(as_options(defect))}", soft_wrap=True)
    if not info.defects:
        console.print("no defects found")
    for step in steps:
        console.print(f"next: {step}", markup=False, highlight=False, soft_wrap=True)


def _topics_table(info: "RecordingInfo") -> "Table":
    from rich.markup import escape
    from rich.table import Table

    from lidar_core.io.scan_topics import NAMELESS

    table = Table("topic", "type", "read as", "messages", "Hz", "frames", "rays", "points")
    for column in table.columns:
        column.overflow = "fold"
    stands = bool(info.transforms) and all(is_static for _, _, is_static in info.transforms)
    for topic in info.topics:
        table.add_row(
            escape(topic.name or NAMELESS),
            escape(topic.type.replace("/msg/", "/")),  # the whole name is in --json
            topic.kind.replace("pose", "mounting") if stands else topic.kind,
            str(topic.count),
            "-" if topic.rate_hz is None else f"{topic.rate_hz:.3g}",
            escape(", ".join(name or "(none)" for name in topic.frames)),
            "-" if topic.rays is None else str(topic.rays),
            "-" if topic.points is None else str(topic.points),
        )
    return table
