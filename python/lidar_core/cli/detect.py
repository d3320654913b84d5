"""`lidar-core detect`: flying objects in a recording."""

from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lidar_core.cli.common import (
    INTERRUPTED,
    JsonFile,
    Row,
    Threads,
    consoles,
    map_rows,
    result_table,
    stage_rows,
    write_json,
)
from lidar_core.cli.config import Mode
from lidar_core.cli.settings import flying_config

if TYPE_CHECKING:
    from rich.table import Table

    from lidar_core.cli.detect_job import DetectJob

POSE = (
    "auto: transforms or odometry of the recording; static: the sensor does not move; else a"
    " poses file, KITTI or TUM."
)
POINT_TIME = "Time of each point as field:unit:reference, auto or none."
NO_RETURN = "What marks a ray without return: auto, zero, nan or none."
MOUNTING = "Where a sensor sits: PARENT FRAME x y z roll pitch yaw [m, rad]; again for more."
METADATA = "JSON file of an Ouster capture, if not beside it."
SCAN_RATE = "Scans per second of a folder without times [Hz]."
MAP = "Map to start from: map.lcvm of an earlier run in the same frame."
REPEAT = "Play the recording this often: lets a short one open the gate of the background."
CONFIG = "TOML file; the run.toml of an earlier run will do."
SET = "Single value, such as voxel_map.voxel_size=0.5; again for more."
MCAP = "Write run.mcap for viewers; by default if the extra `viz` is there."


def command(
    recording: Annotated[Path, typer.Argument(help="File or folder to read.")],
    *,
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder to write.")],
    cloud: Annotated[list[str], typer.Option(help="Topic of a LiDAR; again for more.")] = [],  # noqa: B006
    odom: Annotated[str | None, typer.Option(help="Topic of the poses.")] = None,
    pose: Annotated[str | None, typer.Option(help=POSE)] = None,
    fixed_frame: Annotated[str | None, typer.Option(help="Frame of the map.")] = None,
    mounting: Annotated[list[str], typer.Option(help=MOUNTING)] = [],  # noqa: B006
    point_time: Annotated[str | None, typer.Option(help=POINT_TIME)] = None,
    no_return: Annotated[str | None, typer.Option(help=NO_RETURN)] = None,
    metadata: Annotated[str | None, typer.Option(help=METADATA)] = None,
    scan_rate: Annotated[float | None, typer.Option(help=SCAN_RATE)] = None,
    repeat: Annotated[int, typer.Option(min=1, help=REPEAT)] = 1,
    known_map: Annotated[Path | None, typer.Option("--map", help=MAP)] = None,
    mode: Annotated[Mode, typer.Option(help="What works best, or the paper.")] = "best",
    config: Annotated[Path | None, typer.Option(help=CONFIG)] = None,
    values: Annotated[list[str], typer.Option("--set", help=SET)] = [],  # noqa: B006
    threads: Threads,
    mcap: Annotated[bool | None, typer.Option(help=MCAP)] = None,
    picture: Annotated[bool, typer.Option(help="Draw picture.png (extra `plot`).")] = True,
    overwrite: Annotated[bool, typer.Option(help="Replace an earlier run in the folder.")] = False,
    json: JsonFile = None,
) -> None:
    """Find and track flying objects in RECORDING; write tables, trajectories, map and picture.

    A recording that is too short for the burn-in is no error: the table says which gate stayed
    closed, and why. Ctrl-C ends the run early and leaves whole files.
    """
    from lidar_core.cli.detect_job import DetectJob
    from lidar_core.io import PoseOptions, ReadOptions
    from lidar_core.run_folder import RunFolder

    read = {"point_time": point_time, "no_return": no_return, "metadata": metadata}
    poses = {"pose": pose, "fixed_frame": fixed_frame, "odom": odom, "mounting": mounting}
    job = DetectJob(
        recording=recording,
        folder=RunFolder(output, overwrite=overwrite),
        config=flying_config(mode, config, values),
        read=ReadOptions.load(_given({**read, "scan_rate": scan_rate})),
        pose=PoseOptions.load(_given(poses)),
        clouds=tuple(cloud),
        repeat=repeat,
        known_map=known_map,
        threads=threads,
        writes_mcap=find_spec("foxglove") is not None if mcap is None else mcap,
        draws=picture,
    )
    _run(job, json)


def _run(job: "DetectJob", json: Path | None) -> None:
    """Do the job, print what came out, and end as it ended."""
    from lidar_core.cli.detect_job import detect

    out, errors = consoles(json)
    result = detect(job, errors)
    out.print(_table(result.summary, job.recording.name))
    for note in result.summary["notes"]:
        out.print(f"note: {note}", markup=False, highlight=False, soft_wrap=True)
    out.print(f"{job.folder.path}: {', '.join(result.files)}", highlight=False, soft_wrap=True)
    write_json({**result.summary, "files": result.files}, json)
    if isinstance(result.end, KeyboardInterrupt):
        errors.print("interrupted: the files hold the scans up to here")
        raise typer.Exit(INTERRUPTED)
    if result.end is not None:
        raise result.end


def _given(options: Mapping[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in options.items() if value is not None}


def _table(summary: Mapping[str, Any], name: str) -> "Table":
    scans, gate, shares = summary["scans"], summary["gate"], summary["class_shares"]
    left_out = [
        f"{count} {what}"
        for what, count in (
            ("without pose", sum(summary["without_pose"].values())),
            ("held for their pose", scans["held"]),
            ("rejected", sum(scans["rejected"].values())),
        )
        if count
    ]
    opened = f"since scan {gate['opened_at_scan']}" if gate["open"] else gate["reason"]
    sky = (
        ("cleared", "rays without return are known")
        if summary["clears_sky"]
        else (
            "not cleared",
            "rays without return are missing; --set sensor.beams=... rebuilds them",
        )
    )
    rows = (
        Row("scans", str(scans["processed"]), ", ".join(left_out)),
        Row("poses", "", summary["poses"]),
        *(Row(f"points {kind}", f"{100 * share:.2f} %", "") for kind, share in shares.items()),
        Row("gate", "open" if gate["open"] else "closed", opened),
        Row("open sky", *sky),
        Row("detections", str(summary["detections"]), ""),
        Row("tracks", str(summary["tracks"]), ""),
        None,
        *stage_rows(summary["ms_per_scan"]),
        *map_rows(summary["map"]),
    )
    return result_table(f"{name} ({summary['format']})", rows)
