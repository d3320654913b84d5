"""`lidar-core live`: a running robot, or a recording as if it were one."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing
from functools import partial
from typing import TYPE_CHECKING, Any

import typer

from lidar_core.cli.common import (
    INTERRUPTED,
    NOTHING_CAME,
    Row,
    consoles,
    number,
    result_table,
    write_json,
)
from lidar_core.cli.live_options import LiveOptions
from lidar_core.cli.run_options import with_options

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from lidar_core.cli.live_job import PipelineChoice
    from lidar_core.cli.live_run import LiveRun
    from lidar_core.live import LiveConfig, LiveLoop, Output, Source
    from lidar_core.live.loop import Report
    from lidar_core.live.stats import Delay


@with_options(LiveOptions)
def command(options: LiveOptions) -> None:
    """Process scans as they arrive; the newest wins, and what is left out is counted.

    A line a second tells rate, latency (median and 95th percentile, from the stamp of the scan and
    from its arrival to the end of the outputs) and drops. Ctrl-C or SIGTERM ends with a
    summary. If no scan comes, what is there instead is listed; status 3 if none ever came.
    """
    from lidar_core.cli.live_job import check_files, live_config, open_source
    from lidar_core.live import LiveLoop
    from lidar_core.live.poses import LivePoses

    outputs = _outputs(options)
    read, settings = options.read(), live_config(options.domain, options.stream)
    chosen, where = options.pipeline(), LivePoses(options.poses(), settings)
    check_files(options.outputs, options.replay, options.output, overwrite=options.overwrite)
    record = options.record(chosen)
    out, errors = consoles(options.json)
    with ExitStack() as stack:
        listening = open_source(
            options.source,
            options.replay,
            rate=options.rate,
            read=read,
            live=settings,
            topics=chosen.topics(options.odom),
        )
        stack.callback(listening.close)
        opened = [stack.enter_context(closing(item)) for item in outputs(settings, errors)]
        opened += [] if record is None else [record]
        loop = LiveLoop(
            listening,
            chosen.pipeline if record is None else record.pipeline,
            where,
            opened,
            settings,
            topics=(*options.clouds, *options.scans),
            on_report=lambda report: _tell(errors, report),
            on_silence=partial(_tell_what_there_is, errors, chosen, listening),
        )
        _announce(errors, listening, opened)
        try:
            is_interrupted = _run(loop, options.seconds)
        finally:
            summary = {
                "command": "live",
                "outputs": [item.name for item in opened],
                **loop.summary(),
            }
            if record is not None:
                summary = _recorded(record, summary, options, settings, errors)
    _conclude(out, summary, options)
    if record is not None and record.failed is not None:
        raise record.failed
    if loop.heard_nothing:
        raise typer.Exit(NOTHING_CAME)
    if is_interrupted:
        raise typer.Exit(INTERRUPTED)


def _outputs(options: LiveOptions) -> "Callable[[LiveConfig, Console], Iterator[Output]]":
    """What opens the outputs one by one; options that name no web page are refused before."""
    from lidar_core.cli.live_job import open_output
    from lidar_core.viz.origin_check import allowed_origins

    allowed = allowed_origins(options.allow_origin)

    def opened(settings: "LiveConfig", console: "Console") -> "Iterator[Output]":
        for text in options.outputs:
            refused = partial(_refused, console)
            yield open_output(text, settings, allowed=allowed, on_refused=refused)

    return opened


def _recorded(
    record: "LiveRun",
    summary: dict[str, Any],
    options: LiveOptions,
    settings: "LiveConfig",
    console: "Console",
) -> dict[str, Any]:
    """Write the folder of the run; the summary with what is in it."""
    config = {"live": settings, "read": options.read(), "pose": options.poses()}
    inputs = {"recording": options.replay, "map": options.known_map}
    return record.write(summary, config, inputs, console)


def _conclude(out: "Console", summary: Mapping[str, Any], options: LiveOptions) -> None:
    """Say how it went, and which files there are."""
    out.print(_table(summary))
    if summary.get("files"):
        files = ", ".join(summary["files"])
        out.print(f"{options.output}: {files}", highlight=False, soft_wrap=True)
    for note in summary["notes"]:
        out.print(f"note: {note}", markup=False, highlight=False, soft_wrap=True)
    write_json(summary, options.json)


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


def _refused(console: "Console", reason: str) -> None:
    """Say that somebody was not let in, and what would let them in."""
    console.print(f"refused: {reason}", markup=False, highlight=False, soft_wrap=True)


def _tell_what_there_is(
    console: "Console", chosen: "PipelineChoice", source: "Source", advertised: Sequence[str]
) -> None:
    """Say that nothing comes, and what there is instead."""
    named = (*chosen.clouds, *chosen.scans)
    sorts = " or ".join(
        name
        for name, wanted in (("clouds", chosen.wants_clouds), ("2D scans", chosen.wants_scans))
        if wanted
    )
    there = "; ".join(advertised) or "nothing"
    console.print(
        f"no scan yet of {', '.join(named) or f'any topic with {sorts}'};"
        f" {source.name} has: {there}",
        markup=False,
        highlight=False,
        soft_wrap=True,
    )


def _tell(console: "Console", report: "Report") -> None:
    """Print how it goes, on one line."""
    parts = [
        f"{report.elapsed_s:7.1f} s",
        f"{report.rate_hz:5.1f} scans/s",
        f"latency {_delay(report.from_arrival)}, from stamp {_since_stamp(report)}",
        *(f"{count} {what}" for what, count in report.counts.items()),
        f"{report.objects} objects",
        *([report.trouble] if report.trouble else []),
    ]
    console.print(" | ".join(parts), markup=False, highlight=False, soft_wrap=True)


def _since_stamp(report: "Report") -> str:
    from lidar_core.live.stats import clock_difference_ms, told_difference

    difference = clock_difference_ms(report.from_stamp, report.from_arrival)
    return _delay(report.from_stamp) if difference is None else told_difference(difference)


def _delay(delay: "Delay | None") -> str:
    if delay is None:
        return "-"
    return f"{number(delay.median, 1)} (95 %: {number(delay.p95, 1)}) ms"


def _table(summary: Mapping[str, Any]) -> "Table":
    from lidar_core.live.stats import told_difference

    rate = summary["processed"] / max(summary["seconds"], 1e-9)
    latency = summary["latency_ms"]
    rows = [Row("scans", str(summary["processed"]), f"{rate:.1f} per second")]
    for name, what in (("from_arrival", "from arrival"), ("from_stamp", "from stamp")):
        delay = latency[name]
        if delay is not None:
            rows.append(
                Row(f"latency {what}", f"{delay['median']:.1f} ms", f"95 %: {delay['p95']:.1f} ms")
            )
    if summary["clocks_differ_ms"] is not None:
        told = told_difference(summary["clocks_differ_ms"])
        rows.append(Row("latency from stamp", "-", told))
    for name in ("dropped", "without_pose", "rejected", "ignored", "bad_messages"):
        counts = summary[name]
        told = "; ".join(
            f"{count} x {reason or 'the only topic'}" for reason, count in counts.items()
        )
        rows.append(Row(name.replace("_", " "), str(sum(counts.values())), told))
    return result_table(f"{summary['source']} ({summary['capability'] or 'no scans'})", rows)
