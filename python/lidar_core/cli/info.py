"""`lidar-core info`: what is in a recording."""

import json
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from lidar_core.cli.common import given
from lidar_core.cli.run_options import Metadata, NoReturn, PointTime, Recover

if TYPE_CHECKING:
    from rich.console import Console

    from lidar_core.io import RecordingInfo

COMMANDS = (
    ("detect", "--cloud", ("scan", "scan+pose")),
    ("circles", "--scan", ("planar", "planar+pose")),
)
"""What goes on from a recording: command, option of its topic, kinds of topics."""
RADAR = "radar_msgs/"


def command(
    recording: Annotated[Path, typer.Argument(help="File or folder to look into.")],
    point_time: PointTime = None,
    no_return: NoReturn = None,
    metadata: Metadata = None,
    recover: Recover = False,
    as_json: Annotated[bool, typer.Option("--json", help="Machine-readable output.")] = False,
) -> None:
    """Topics, rates, frames, time span and defects of a recording; the command that goes on."""
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

    from lidar_core.io.scan_topics import NAMELESS

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
    for step in next_steps(info):
        console.print(f"next: {step}", markup=False, highlight=False, soft_wrap=True)


def next_steps(info: "RecordingInfo") -> Iterator[str]:
    """Commands that go on from a recording, with the options that it needs."""
    for command, option, kinds in COMMANDS:
        topics = [topic for topic in info.topics if topic.kind in kinds]
        if topics:
            choice = [option, topics[0].name] if len(topics) > 1 else []
            poses, remark = _poses(info, topics[0].frames)
            yield _told(command, info.path, *choice, *poses) + remark
    if any(topic.type.startswith(RADAR) for topic in info.topics):
        yield _told("fuse", info.path)


def _told(command: str, path: str, *options: str) -> str:
    return shlex.join(["lidar-core", command, path, "-o", "run/", *options])


def _poses(info: "RecordingInfo", frames: tuple[str, ...]) -> tuple[list[str], str]:
    """Options that tell where scans in `frames` were taken, and a remark."""
    known, edges = set(frames), [{parent, child} for parent, child, _ in info.transforms if child]
    while more := {frame for edge in edges if known & edge for frame in edge} - known:
        known |= more
    moving = [child for _, child, is_static in info.transforms if not is_static]
    if not moving:
        return ["--pose", "static"], "  (if the sensor moved: --pose FILE)"
    named = [child for child in moving if child]
    if not named or known & set(named) or not frames:
        return [], ""
    mounting = f"{named[0]} {frames[0]} x y z roll pitch yaw"
    return ["--mounting", mounting], "  (where the sensor sits on what moves, in m and rad)"
