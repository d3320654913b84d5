"""Options that commands on recordings share."""

from pathlib import Path
from typing import Annotated, TypeAlias

import typer

from lidar_core.cli.config import Mode

_POSE = (
    "auto: transforms or odometry of the recording; static: the sensor does not move; else a"
    " poses file, KITTI or TUM."
)
_MOUNTING = "Where a sensor sits: PARENT FRAME x y z roll pitch yaw \\[m, rad]; again for more."
_CONFIG = "TOML file; the run.toml of an earlier run will do."
_MCAP = "Write run.mcap for viewers; by default if the extra `viz` is there."

RecordingPath: TypeAlias = Annotated[Path, typer.Argument(help="File or folder to read.")]
Output: TypeAlias = Annotated[Path, typer.Option("--output", "-o", help="Folder to write.")]
Odom: TypeAlias = Annotated[str | None, typer.Option(help="Topic of the poses.")]
PoseSource: TypeAlias = Annotated[str | None, typer.Option(help=_POSE)]
FixedFrame: TypeAlias = Annotated[str | None, typer.Option(help="Frame of the map.")]
Mountings: TypeAlias = Annotated[list[str], typer.Option(help=_MOUNTING)]
ChosenMode: TypeAlias = Annotated[Mode, typer.Option(help="What works best, or the paper.")]
ConfigFile: TypeAlias = Annotated[Path | None, typer.Option(help=_CONFIG)]
Mcap: TypeAlias = Annotated[bool | None, typer.Option(help=_MCAP)]
Picture: TypeAlias = Annotated[bool, typer.Option(help="Draw picture.png (extra `plot`).")]
Overwrite: TypeAlias = Annotated[bool, typer.Option(help="Replace an earlier run in the folder.")]
