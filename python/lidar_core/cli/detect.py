"""`lidar-core detect`: flying objects in a recording."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lidar_core.cli.shared import completion
from lidar_core.cli.shared.common import (
    READ,
    Threads,
    consoles,
    given_options,
    left_out,
    map_rows,
    report,
    result_table,
    shown_progress,
    stage_rows,
)
from lidar_core.cli.shared.run_options import (
    METADATA,
    POINT_TIME,
    RunOptions,
    ScanRate,
    Stamps,
    with_options,
)
from lidar_core.util.rows import Row

if TYPE_CHECKING:
    from rich.table import Table

NO_RETURN = "What marks a ray without return: auto, zero, nan or none."
MAP = (
    "Known map in the fixed frame: map.lcvm of an earlier run, or a cloud,"
    " mesh or OctoMap as .pcd, .ply, .las, .laz, .bt, .stl, .obj."
)
STATIC_MAP = (
    "Write a map without moving objects: .lcvm (voxels of 0.1 m), .pcd or .ply (points in the"
    " fixed frame). Processing then takes more time."
)
REPEAT = "Process the recording this many times, so that a short one completes the burn-in."


@with_options(RunOptions)
def command(
    options: RunOptions,
    *,
    cloud: Annotated[
        list[str],
        typer.Option(
            help="Topic of a LiDAR; may be repeated.",
            rich_help_panel=READ,
            autocompletion=completion.CLOUDS,
        ),
    ] = [],  # noqa: B006
    point_time: Annotated[str | None, typer.Option(help=POINT_TIME, rich_help_panel=READ)] = None,
    no_return: Annotated[str | None, typer.Option(help=NO_RETURN, rich_help_panel=READ)] = None,
    metadata: Annotated[str | None, typer.Option(help=METADATA, rich_help_panel=READ)] = None,
    stamps: Stamps = None,
    scan_rate: ScanRate = None,
    repeat: Annotated[int, typer.Option(min=1, help=REPEAT, rich_help_panel=READ)] = 1,
    known_map: Annotated[Path | None, typer.Option("--map", help=MAP)] = None,
    static_map: Annotated[Path | None, typer.Option(metavar="OUT", help=STATIC_MAP)] = None,
    threads: Threads,
) -> None:
    """Find and track flying objects in RECORDING; write tables, trajectories, map and picture.

    A recording that is too short for the burn-in is not an error: the table then states why
    nothing was reported. Ctrl-C ends the run early; the files are complete up to that scan.
    """
    from lidar_core import runs
    from lidar_core.config import toml_values
    from lidar_core.files import read_whole
    from lidar_core.io import ReadOptions
    from lidar_core.run_folder import RUN_FILE

    read = {"point_time": point_time, "no_return": no_return, "metadata": metadata}
    with shown_progress(consoles(options.json)[1]) as on_progress:
        result = runs.detect(
            options.recording,
            options.choice(),
            options.output,
            pose=options.poses(),
            read=ReadOptions.load(
                given_options({**read, "stamps": stamps, "scan_rate": scan_rate})
            ),
            clouds=cloud,
            repeat=repeat,
            known_map=known_map,
            static_map=static_map,
            threads=threads,
            mcap=options.mcap,
            picture=options.picture,
            overwrite=options.overwrite,
            checkpoint=options.checkpoint,
            resume=options.resume,
            on_progress=on_progress,
        )
    file = options.output / RUN_FILE
    note = toml_values(read_whole(file), file)
    reach = note["config"]["flying"]["voxel_map"]["max_range"]
    table = _table(result.summary, options.recording.name, reach)
    report(result, table, options.json, notes=result.summary["notes"])


SKY = {
    "given": "of the rays: the recording marks rays without return",
    "pattern": "of the rays: estimated from the rows of the sensor",
    "density": "of the rays: estimated from the density of the returns",
    "unknown": "not known: objects in front of open sky are not found",
}
"""What `frame.status.sky` says, for people."""
POINT_TIMES = {
    "given": "by the recording",
    "estimated": "where the sensor moves, from the order of the points in a turn",
    "none": "all points of a scan are taken to be of one time",
}
"""What `frame.status.point_times` says, for people."""


def _told_movers(summary: Mapping[str, Any], reach: float) -> str:
    """Text on how many scans have points that move on the ground, and how far they are searched."""
    scans = summary["scans_moving"]
    found = f"in {scans} of {summary['scans']['processed']} scans" if scans else "in no scan"
    return f"moving points {found}, searched up to {reach:g} m"


def _table(summary: Mapping[str, Any], name: str, reach: float) -> "Table":
    scans, gate, shares = summary["scans"], summary["gate"], summary["class_shares"]
    opened = f"since scan {gate['opened_at_scan']}" if gate["open"] else gate["reason"]
    rows = (
        Row("scans", str(scans["processed"]), ", ".join(left_out(summary))),
        Row("poses", "", summary["poses"]),
        *(Row(f"points {kind}", f"{100 * share:.2f} %", "") for kind, share in shares.items()),
        Row("gate", "open" if gate["open"] else "closed", opened),
        Row("open sky", f"{100 * summary['sky_share']:.0f} %", SKY[summary["sky"]]),
        Row("own body", f"{100 * summary['own_body']:.1f} %", "of the rays"),
        Row("point times", summary["point_times"], POINT_TIMES[summary["point_times"]]),
        Row("detections", str(summary["detections"]), ""),
        Row("tracks, flying", str(summary["tracks"]), ""),
        Row("tracks, on the ground", str(summary["tracks_ground"]), _told_movers(summary, reach)),
        None,
        *stage_rows(summary["ms_per_scan"]),
        *map_rows(summary["map"]),
    )
    return result_table(f"{name} ({summary['format']})", rows)
