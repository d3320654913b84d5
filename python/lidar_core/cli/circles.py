"""`lidar-core circles`: a map of the round obstacles in a recording of 2D scans."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias

import typer

from lidar_core.cli.shared import completion
from lidar_core.cli.shared.common import (
    READ,
    WRITTEN,
    consoles,
    given_options,
    left_out,
    report,
    result_table,
    shown_progress,
    stage_rows,
)
from lidar_core.cli.shared.run_options import PlanarRunOptions, ScanRate, Stamps, with_options
from lidar_core.util.rows import Row

if TYPE_CHECKING:
    from rich.table import Table

SCAN = "Topic of a 2D LiDAR; may be repeated."
NO_RETURN = "What marks a ray without return, besides +inf: auto, zero, nan, max or none."
SWEEP = "Times of rays. auto: as the scans state them; none: all rays have the time of the scan."
TRUST = "Run an ONNX file from elsewhere. A model is a program: use only files you trust."
TrustModel: TypeAlias = Annotated[bool, typer.Option("--trust-model", help=TRUST)]
MOST_MOVERS = 6  # named in the table
FILM = "Also draw film.mp4, or film.gif if ffmpeg is not installed."


@with_options(PlanarRunOptions)
def command(
    options: PlanarRunOptions,
    *,
    scan: Annotated[
        list[str],
        typer.Option(help=SCAN, rich_help_panel=READ, autocompletion=completion.SCANS),
    ] = [],  # noqa: B006
    no_return: Annotated[str | None, typer.Option(help=NO_RETURN, rich_help_panel=READ)] = None,
    point_time: Annotated[str | None, typer.Option(help=SWEEP, rich_help_panel=READ)] = None,
    stamps: Stamps = None,
    scan_rate: ScanRate = None,
    trust_model: TrustModel = False,
    film: Annotated[bool, typer.Option("--film", help=FILM, rich_help_panel=WRITTEN)] = False,
) -> None:
    """Map the round obstacles in RECORDING; write tables, trajectories and picture.

    The recording states the geometry of its scanners; `scanner` of the configuration limits
    their range. A scan is rejected if its number of rays occurs in less than 5 % of the scans.
    The command fails if it rejects more than half of the scans. Ctrl-C ends the run early; the
    files are complete up to that scan.
    """
    from lidar_core import runs
    from lidar_core.io import ReadOptions

    read = {"no_return": no_return, "point_time": point_time}
    with shown_progress(consoles(options.json)[1]) as on_progress:
        result = runs.circles(
            options.recording,
            options.choice(),
            options.output,
            pose=options.poses(),
            read=ReadOptions.load(
                given_options({**read, "stamps": stamps, "scan_rate": scan_rate})
            ),
            scans=scan,
            allow_untrusted=trust_model,
            mcap=options.mcap,
            picture=options.picture,
            film=film,
            overwrite=options.overwrite,
            checkpoint=options.checkpoint,
            resume=options.resume,
            on_progress=on_progress,
        )
    table = _table(result.summary, options.recording.name)
    report(result, table, options.json, notes=result.summary["notes"])


def _left_out(too_near: int) -> str:
    return "in all scans" + (f", {too_near} more too near" if too_near else "")


def _told_movers(moving: Sequence[Mapping[str, Any]]) -> str:
    """Text with the IDs of the elements that move, and their speeds."""
    told = [f"{one['id']} ({one['speed']:.1f} m/s)" for one in moving[:MOST_MOVERS]]
    left = len(moving) - len(told)
    return ", ".join(told) + (f", and {left} slower" if left else "")


def _table(summary: Mapping[str, Any], name: str) -> "Table":
    scans, moving = summary["scans"], summary["moving_at_end"]
    rows = (
        Row("scans", str(scans["processed"]), ", ".join(left_out(summary))),
        Row("poses", "", summary["poses"]),
        Row("circles", str(summary["circles"]), _left_out(summary["too_near"])),
        Row("elements", str(summary["elements"]), f"{summary['elements_at_end']} at the end"),
        Row("moving at the end", str(len(moving)), _told_movers(moving)),
        Row("persons", str(summary["persons"]), "elements that were probably persons for 1 s"),
        Row(
            "walls and other shapes",
            str(summary["shapes"]),
            f"{summary['shapes_at_end']} at the end",
        ),
        None,
        *stage_rows(summary["ms_per_scan"]),
    )
    return result_table(f"{name} ({summary['format']})", rows)
