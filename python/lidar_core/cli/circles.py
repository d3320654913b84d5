"""`lidar-core circles`: a map of the round obstacles in a recording of 2D scans."""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias

import typer

from lidar_core.cli.common import READ, WRITTEN, Row, consoles, given, result_table, stage_rows
from lidar_core.cli.run_options import RunOptions, ScanRate, Stamps, with_options
from lidar_core.cli.settings import run_config

if TYPE_CHECKING:
    from rich.table import Table

    from lidar_core.circles import CirclesConfig
    from lidar_core.io import ReadOptions, Span
    from lidar_core.messages import LaserScan

SHARE = 0.05  # of a LiDAR's scans that have a length which is no defect
SCAN = "Topic of a 2D LiDAR; again for more."
NO_RETURN = "What marks a ray without return, besides +inf: auto, zero, nan, max or none."
SWEEP = "auto: rays have the times that the scans state; none: all rays at the stamp."
TRUST = "Run an ONNX file that was not exported here: a model is a program."
TrustModel: TypeAlias = Annotated[bool, typer.Option("--trust-model", help=TRUST)]
FILM = "Draw film.mp4, or film.gif without ffmpeg, beside the picture."


@with_options(RunOptions)
def command(
    options: RunOptions,
    *,
    scan: Annotated[list[str], typer.Option(help=SCAN, rich_help_panel=READ)] = [],  # noqa: B006
    no_return: Annotated[str | None, typer.Option(help=NO_RETURN, rich_help_panel=READ)] = None,
    point_time: Annotated[str | None, typer.Option(help=SWEEP, rich_help_panel=READ)] = None,
    stamps: Stamps = None,
    scan_rate: ScanRate = None,
    trust_model: TrustModel = False,
    film: Annotated[bool, typer.Option("--film", help=FILM, rich_help_panel=WRITTEN)] = False,
) -> None:
    """Map the round obstacles in RECORDING; write tables, trajectories and picture.

    The scanners are those of the recording, within the range limits of the configuration's
    `scanner`; scans of one length that less than one in twenty have are rejected. The command
    fails if more than half of the scans were rejected. Ctrl-C ends the run early and leaves
    whole files.
    """
    from lidar_core.circles import CirclePipeline, CirclesConfig
    from lidar_core.cli.circles_run import CirclesRun
    from lidar_core.cli.recording_job import RecordingJob, do, report
    from lidar_core.io import ReadOptions
    from lidar_core.messages import LaserScan

    folder, recording = options.folder(), options.recording
    read = ReadOptions.load(
        given(
            {
                "no_return": no_return,
                "point_time": point_time,
                "stamps": stamps,
                "scan_rate": scan_rate,
            }
        )
    )
    base = CirclesConfig() if options.mode == "best" else CirclesConfig.paper()
    config = run_config(base, "circles", options.config, options.values)
    chosen = _with_scanners(config, recording, read, scan, options.poses())
    job = RecordingJob(
        command="circles",
        sort=LaserScan,
        options=options,
        folder=folder,
        config={"circles": chosen},
        read=read,
        topics=tuple(scan),
        note={"scans": scan},
    )
    out, errors = consoles(options.json)
    result = do(
        job, CirclesRun(CirclePipeline(chosen, allow_untrusted=trust_model), films=film), errors
    )
    report(result, _table(result.summary, recording.name), job, out)


def _with_scanners(
    config: "CirclesConfig",
    recording: Path,
    read: "ReadOptions",
    topics: Sequence[str],
    span: "Span",
) -> "CirclesConfig":
    """`config` with the scanners of the recording, where it does not name them itself.

    Their ranges are limited to those of `config.scanner`.
    """
    from lidar_core.io import open_recording, posed_laser_scans
    from lidar_core.scan_processing import check_no_rays, layout_name, scanner_of, sensor_name

    check_no_rays(config)
    found = dict(config.scanners)
    for topic in topics or (None,):
        with open_recording(recording, read) as opened:
            scans = posed_laser_scans(
                opened, cloud=topic, pose="static", start=span.start, end=span.end
            )
            if scans.cloud in config.scanners:
                continue
            layouts = _layouts(item.scan for item in scans)
        for number, scan in enumerate(layouts):
            name = sensor_name(scan)
            scanner = scanner_of(scan, config, f"{recording}: {name}")
            found.setdefault(layout_name(name, len(scan.ranges)) if number else name, scanner)
    return type(config).load(config.model_dump() | {"scanners": found})


def _layouts(scans: Iterable["LaserScan"]) -> list["LaserScan"]:
    """A scan of every length that is no exception, the most frequent length first."""
    first: dict[int, LaserScan] = {}
    counts: Counter[int] = Counter()
    for scan in scans:
        first.setdefault(len(scan.ranges), scan)
        counts[len(scan.ranges)] += 1
    usual = [rays for rays, count in counts.most_common() if count >= SHARE * counts.total()]
    return [first[rays] for rays in usual]


def _left_out(too_near: int) -> str:
    return "in all scans" + (f", {too_near} more too near" if too_near else "")


def _table(summary: Mapping[str, Any], name: str) -> "Table":
    from lidar_core.cli.recording_job import left_out

    scans = summary["scans"]
    rows = (
        Row("scans", str(scans["processed"]), ", ".join(left_out(summary))),
        Row("poses", "", summary["poses"]),
        Row("circles", str(summary["circles"]), _left_out(summary["too_near"])),
        Row("elements", str(summary["elements"]), f"{summary['elements_at_end']} at the end"),
        Row(
            "walls and other shapes",
            str(summary["shapes"]),
            f"{summary['shapes_at_end']} at the end",
        ),
        None,
        *stage_rows(summary["ms_per_scan"]),
    )
    return result_table(f"{name} ({summary['format']})", rows)
