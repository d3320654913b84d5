"""`lidar-core live`: a running robot, or a recording as if it were one."""

from collections.abc import Mapping, Sequence
from contextlib import ExitStack, closing
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from lidar_core.cli.circles import NO_RETURN
from lidar_core.cli.common import (
    INTERRUPTED,
    READ,
    WRITTEN,
    OverwriteFile,
    Row,
    Threads,
    consoles,
    given,
    number,
    result_table,
    write_json,
)
from lidar_core.cli.detect import MAP, POINT_TIME
from lidar_core.cli.run_options import PipelineOptions, with_options

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from lidar_core.live import LiveLoop, Output, Source
    from lidar_core.live.loop import Report
    from lidar_core.live.stats import Delay

IN = (
    "zenoh, zenoh:tcp/HOST:PORT, foxglove, foxglove:ws://HOST:PORT, udp, udp:PORT (Velodyne's"
    " packets)."
)
OUT = (
    "foxglove, foxglove:PORT, zenoh, zenoh:tcp/HOST:PORT, rerun, rerun:web, rerun:FILE.rrd,"
    " mcap:FILE; again for more."
)
STREAM = "Single value of the model `live`, such as pose_wait=0.5; again for more."
FOLDER = "Folder to write: what `detect` or `circles` would leave of the scans that were processed."
CAPABILITY = "auto: flying objects if clouds arrive, circles if 2D scans do."


@with_options(PipelineOptions)
def command(
    options: PipelineOptions,
    *,
    source: Annotated[str | None, typer.Option("--in", help=IN, rich_help_panel=READ)] = None,
    replay: Annotated[
        Path | None, typer.Option(help="Play this recording instead.", rich_help_panel=READ)
    ] = None,
    rate: Annotated[
        float | None,
        typer.Option(
            min=0.01,
            show_default="1",
            help="Seconds of the recording per second, for --replay.",
            rich_help_panel=READ,
        ),
    ] = None,
    outputs: Annotated[list[str], typer.Option("--out", help=OUT, rich_help_panel=WRITTEN)] = [],  # noqa: B006
    capability: Annotated[
        Literal["auto", "flying", "circles"], typer.Option(help=CAPABILITY)
    ] = "auto",
    cloud: Annotated[
        list[str], typer.Option(help="Topic of a LiDAR; again for more.", rich_help_panel=READ)
    ] = [],  # noqa: B006
    scan: Annotated[
        list[str], typer.Option(help="Topic of a 2D LiDAR; again for more.", rich_help_panel=READ)
    ] = [],  # noqa: B006
    point_time: Annotated[str | None, typer.Option(help=POINT_TIME, rich_help_panel=READ)] = None,
    no_return: Annotated[str | None, typer.Option(help=NO_RETURN, rich_help_panel=READ)] = None,
    known_map: Annotated[
        Path | None, typer.Option("--map", help=f"{MAP} Only clouds count then.")
    ] = None,
    domain: Annotated[
        int | None,
        typer.Option(
            envvar="ROS_DOMAIN_ID", help="Domain of ROS 2 over Zenoh.", rich_help_panel=READ
        ),
    ] = None,
    stream: Annotated[list[str], typer.Option(help=STREAM)] = [],  # noqa: B006
    seconds: Annotated[float | None, typer.Option(min=0, help="End after this time \\[s].")] = None,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help=FOLDER, rich_help_panel=WRITTEN)
    ] = None,
    overwrite: OverwriteFile = False,
    threads: Threads,
) -> None:
    """Process scans as they arrive; the newest wins, and what is left out is counted.

    A line a second tells rate, latency (median and 95th percentile, from the stamp of the scan and
    from its arrival to the end of the outputs) and drops. Ctrl-C or SIGTERM ends with a
    summary.
    """
    from lidar_core.cli.live_job import (
        PipelineChoice,
        check_files,
        live_config,
        open_output,
        open_source,
    )
    from lidar_core.cli.live_run import LiveRun
    from lidar_core.io import ReadOptions
    from lidar_core.live import LiveLoop
    from lidar_core.live.poses import LivePoses
    from lidar_core.run_folder import RunFolder

    read = ReadOptions.load(given({"point_time": point_time, "no_return": no_return}))
    settings = live_config(domain, stream)
    chosen = PipelineChoice(
        capability,
        tuple(cloud),
        tuple(scan),
        options.mode,
        options.config,
        tuple(options.values),
        known_map,
        threads,
    )
    where = LivePoses(options.poses(), settings)
    check_files(outputs, replay, output, overwrite=overwrite)
    record = None if output is None else LiveRun(
        RunFolder(output, overwrite=overwrite, reads=replay), chosen.pipeline
    )  # fmt: skip
    out, errors = consoles(options.json)
    with ExitStack() as stack:
        listening = open_source(source, replay, rate=rate, read=read, live=settings,
                                topics=chosen.topics(options.odom))  # fmt: skip
        stack.callback(listening.close)
        opened = [stack.enter_context(closing(open_output(text, settings))) for text in outputs]
        opened += [] if record is None else [record]
        loop = LiveLoop(
            listening, chosen.pipeline if record is None else record.pipeline, where, opened,
            settings, topics=(*cloud, *scan), on_report=lambda report: _tell(errors, report),
        )  # fmt: skip
        _announce(errors, listening, opened)
        try:
            is_interrupted = _run(loop, seconds)
        finally:
            summary = {"command": "live", "outputs": [item.name for item in opened],
                       **loop.summary()}  # fmt: skip
            if record is not None:
                config = {"live": settings, "read": read, "pose": options.poses()}
                inputs = {"recording": replay, "map": known_map}
                summary = record.write(summary, config, inputs, errors)
    out.print(_table(summary))
    if summary.get("files"):
        out.print(f"{output}: {', '.join(summary['files'])}", highlight=False, soft_wrap=True)
    for note in summary["notes"]:
        out.print(f"note: {note}", markup=False, highlight=False, soft_wrap=True)
    write_json(summary, options.json)
    if record is not None and record.failed is not None:
        raise record.failed
    if is_interrupted:
        raise typer.Exit(INTERRUPTED)


def _run(loop: "LiveLoop[Any]", seconds: float | None) -> bool:
    """Work until the end; True if that was Ctrl-C."""
    try:
        loop.run(seconds)
    except KeyboardInterrupt:
        return True
    return False


def _announce(console: "Console", source: "Source", outputs: Sequence["Output"]) -> None:
    for text in (f"from {source.name}", *(f"to {item.name}" for item in outputs)):
        console.print(text, markup=False, highlight=False, soft_wrap=True)


def _tell(console: "Console", report: "Report") -> None:
    """Print how it goes, on one line."""
    parts = [
        f"{report.elapsed_s:7.1f} s",
        f"{report.rate_hz:5.1f} scans/s",
        f"latency {_delay(report.from_arrival)}, from stamp {_delay(report.from_stamp)}",
        *(f"{count} {what}" for what, count in report.counts.items()),
        f"{report.objects} objects",
        *([report.trouble] if report.trouble else []),
    ]
    console.print(" | ".join(parts), markup=False, highlight=False, soft_wrap=True)


def _delay(delay: "Delay | None") -> str:
    if delay is None:
        return "-"
    return f"{number(delay.median, 1)} (95 %: {number(delay.p95, 1)}) ms"


def _table(summary: Mapping[str, Any]) -> "Table":
    rate = summary["processed"] / max(summary["seconds"], 1e-9)
    latency = summary["latency_ms"]
    rows = [Row("scans", str(summary["processed"]), f"{rate:.1f} per second")]
    for name, what in (("from_arrival", "from arrival"), ("from_stamp", "from stamp")):
        delay = latency[name]
        if delay is not None:
            rows.append(Row(f"latency {what}", f"{delay['median']:.1f} ms",
                            f"95 %: {delay['p95']:.1f} ms"))  # fmt: skip
    for name in ("dropped", "without_pose", "rejected", "ignored", "bad_messages"):
        counts = summary[name]
        told = "; ".join(
            f"{count} x {reason or 'the only topic'}" for reason, count in counts.items()
        )
        rows.append(Row(name.replace("_", " "), str(sum(counts.values())), told))
    return result_table(f"{summary['source']} ({summary['capability'] or 'no scans'})", rows)
