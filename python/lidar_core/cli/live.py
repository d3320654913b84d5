"""`lidar-core live`: process the scans of a running robot, or of a recording in real time."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeAlias

import typer

from lidar_core.cli.circles import NO_RETURN, TrustModel
from lidar_core.cli.detect import MAP
from lidar_core.cli.results.view import ALLOW_ORIGIN
from lidar_core.cli.shared.common import (
    INTERRUPTED,
    NOTHING_CAME,
    READ,
    WRITTEN,
    OverwriteFile,
    Threads,
    as_options,
    consoles,
    given_options,
    result_table,
    told_reasons,
    write_json,
)
from lidar_core.cli.shared.run_options import (
    POINT_TIME,
    Checkpoint,
    PipelineOptions,
    Resume,
    with_options,
)
from lidar_core.cli.shared.voice import tell as say
from lidar_core.errors import ConfigError
from lidar_core.util.rows import Row, number

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from lidar_core.io import ReadOptions
    from lidar_core.live import LiveConfig
    from lidar_core.live.stats import Delay, Report
    from lidar_core.runs import LiveResult


_IN = (
    "zenoh, zenoh:tcp/HOST:PORT, foxglove, foxglove:ws://HOST:PORT; packets: velodyne, livox (or"
    " with :PORT), ouster:HOST, ouster:FILE.json (or with @PORT)."
)
_OUT = (
    "foxglove, foxglove:PORT, zenoh, zenoh:tcp/HOST:PORT, rerun, rerun:web, rerun:web:PORT,"
    " rerun:FILE.rrd, mcap:FILE, arrow:FILE; may be repeated."
)
_STREAM = "Set one value of the model `live`, such as pose_wait=0.5; may be repeated."
_FOLDER = "Folder to write, as `detect` or `circles` writes it."
_TAPE = "Record the input: .mcap, .npz or .bag."
_METRICS = "Prometheus metrics: PORT or HOST:PORT."
_CAPABILITY = "auto: flying for clouds, circles for 2D scans."

SourceName: TypeAlias = Annotated[str | None, typer.Option("--in", help=_IN, rich_help_panel=READ)]
Replay: TypeAlias = Annotated[
    Path | None, typer.Option(help="Play this recording instead of a stream.", rich_help_panel=READ)
]
Rate: TypeAlias = Annotated[
    float | None,
    typer.Option(
        min=0.01,
        show_default="1",
        help="Speed of --replay: recorded seconds per second.",
        rich_help_panel=READ,
    ),
]
OutputNames: TypeAlias = Annotated[
    list[str], typer.Option("--out", help=_OUT, rich_help_panel=WRITTEN)
]
AllowOrigin: TypeAlias = Annotated[
    list[str], typer.Option(help=ALLOW_ORIGIN, rich_help_panel=WRITTEN)
]
Capability: TypeAlias = Annotated[
    Literal["auto", "flying", "circles"], typer.Option(help=_CAPABILITY)
]
Clouds: TypeAlias = Annotated[
    list[str],
    typer.Option("--cloud", help="Topic of a LiDAR; may be repeated.", rich_help_panel=READ),
]
Scans: TypeAlias = Annotated[
    list[str],
    typer.Option("--scan", help="Topic of a 2D LiDAR; may be repeated.", rich_help_panel=READ),
]
PointTime: TypeAlias = Annotated[str | None, typer.Option(help=POINT_TIME, rich_help_panel=READ)]
NoReturn: TypeAlias = Annotated[str | None, typer.Option(help=NO_RETURN, rich_help_panel=READ)]
KnownMap: TypeAlias = Annotated[
    Path | None, typer.Option("--map", help=f"{MAP} Only with 3D LiDARs.")
]
Domain: TypeAlias = Annotated[
    int | None,
    typer.Option(envvar="ROS_DOMAIN_ID", help="ROS 2 domain, for zenoh.", rich_help_panel=READ),
]
Stream: TypeAlias = Annotated[list[str], typer.Option(help=_STREAM)]
Seconds: TypeAlias = Annotated[float | None, typer.Option(min=0, help="End after this time \\[s].")]
Folder: TypeAlias = Annotated[
    Path | None, typer.Option("--output", "-o", help=_FOLDER, rich_help_panel=WRITTEN)
]


Tape: TypeAlias = Annotated[
    Path | None, typer.Option("--record", help=_TAPE, rich_help_panel=WRITTEN)
]
Metrics: TypeAlias = Annotated[str | None, typer.Option(help=_METRICS, rich_help_panel=WRITTEN)]


@dataclass(frozen=True, slots=True, kw_only=True)
class LiveOptions(PipelineOptions):
    """Options of source, pipeline and outputs."""

    source: SourceName = None
    replay: Replay = None
    rate: Rate = None
    outputs: OutputNames = field(default_factory=list)
    allow_origin: AllowOrigin = field(default_factory=list)
    capability: Capability = "auto"
    clouds: Clouds = field(default_factory=list)
    scans: Scans = field(default_factory=list)
    point_time: PointTime = None
    no_return: NoReturn = None
    known_map: KnownMap = None
    domain: Domain = None
    stream: Stream = field(default_factory=list)
    seconds: Seconds = None
    trust_model: TrustModel = False
    output: Folder = None
    record: Tape = None
    metrics: Metrics = None
    overwrite: OverwriteFile = False
    checkpoint: Checkpoint = None
    resume: Resume = False
    threads: Threads

    def read(self) -> "ReadOptions":
        """Return the options for reading messages."""
        from lidar_core.io import ReadOptions

        told = {"point_time": self.point_time, "no_return": self.no_return}
        return ReadOptions.load(given_options(told))


@with_options(LiveOptions)
def command(options: LiveOptions) -> None:
    """Process scans as they arrive; only the newest scan is kept, skipped scans are counted.

    Each second, a line shows rate, latency (median and 95th percentile, from the stamp and from
    the arrival of a scan to the end of the outputs) and skipped scans. Ctrl-C or SIGTERM ends
    with a summary. If no scan arrives, the topics found are listed; status 3 if none ever came.
    """
    from lidar_core import runs

    # Longer than other functions: every option is handed to the run by its name.
    out, errors = consoles(options.json)

    def tell(text: str) -> None:
        say(errors, as_options(text))

    result = runs.live(
        options.source,
        options.choice(),
        options.output,
        replay=options.replay,
        rate=options.rate,
        outputs=options.outputs,
        allow_origin=options.allow_origin,
        capability=options.capability,
        clouds=options.clouds,
        scans=options.scans,
        pose=options.poses(),
        read=options.read(),
        stream=live_config(options.domain, options.stream),
        known_map=options.known_map,
        threads=options.threads,
        allow_untrusted=options.trust_model,
        seconds=options.seconds,
        record=options.record,
        metrics=options.metrics,
        overwrite=options.overwrite,
        checkpoint=options.checkpoint,
        resume=options.resume,
        on_message=tell,
        on_report=lambda report: _tell(errors, report),
    )
    for note in result.notes:
        tell(note)
    _write_result(out, result, options)
    if isinstance(result.ended_by, OSError):
        raise result.ended_by
    if result.heard_nothing:
        raise typer.Exit(NOTHING_CAME)
    if result.ended_by is not None:
        raise typer.Exit(INTERRUPTED)


def _write_result(out: "Console", result: "LiveResult", options: LiveOptions) -> None:
    out.print(_table(result.summary))
    if result.files:
        files = ", ".join(result.files)
        out.print(f"{options.output}: {files}", highlight=False, soft_wrap=True)
    for note in result.summary["notes"]:
        out.print(f"note: {as_options(note)}", markup=False, highlight=False, soft_wrap=True)
    more = {} if options.output is None else {"files": result.files}
    write_json({**result.summary, **more}, options.json)


def live_config(domain: int | None, stream: Sequence[str]) -> "LiveConfig":
    """Return the values that --domain and --stream set.

    Raises
    ------
    ConfigError
        A value is unknown or outside its range.
    """
    from lidar_core.live import LiveConfig
    from lidar_core.runs.settings import with_assignments

    set_by_name = with_assignments({}, stream, argument="stream", example="pose_wait=0.5")
    try:
        config = LiveConfig.load(set_by_name)
    except ConfigError as error:
        known = ", ".join(LiveConfig.model_fields)
        raise ConfigError(f"--stream {error}; known names: {known}") from error
    return config if domain is None else LiveConfig.load({"domain": domain} | set_by_name)


def _tell(console: "Console", report: "Report") -> None:
    """Print a report about the run on one line."""
    parts = [
        f"{report.elapsed_s:7.1f} s",
        f"{report.rate_hz:5.1f} scans/s",
        f"latency {_delay(report.from_arrival)}, from stamp {_since_stamp(report)}",
        *(f"{count} {what}" for what, count in report.counts.items()),
        f"{report.objects} objects",
        *([report.trouble] if report.trouble else []),
    ]
    say(
        console,
        " | ".join(parts),
        seconds=round(report.elapsed_s, 3),
        scans_per_second=round(report.rate_hz, 3),
        latency_ms=None if report.from_arrival is None else round(report.from_arrival.p95, 3),
        objects=report.objects,
        **{name.replace(" ", "_"): count for name, count in report.counts.items()},
    )


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
            f"{count} x {topic or 'the only topic'}" for topic, count in counts.items()
        )
        if name == "rejected":
            told = told_reasons(counts)
        rows.append(Row(name.replace("_", " "), str(sum(counts.values())), told))
    return result_table(f"{summary['source']} ({summary['capability'] or 'no scans'})", rows)
