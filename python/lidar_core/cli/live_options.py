"""What `lidar-core live` is told."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, TypeAlias

import typer

from lidar_core.cli.circles import NO_RETURN, TrustModel
from lidar_core.cli.common import READ, WRITTEN, OverwriteFile, Threads, given
from lidar_core.cli.detect import MAP, POINT_TIME
from lidar_core.cli.run_options import PipelineOptions
from lidar_core.cli.view import ALLOW_ORIGIN

if TYPE_CHECKING:
    from lidar_core.io import ReadOptions

_IN = (
    "zenoh, zenoh:tcp/HOST:PORT, foxglove, foxglove:ws://HOST:PORT, udp, udp:PORT (Velodyne's"
    " packets)."
)
_OUT = (
    "foxglove, foxglove:PORT, zenoh, zenoh:tcp/HOST:PORT, rerun, rerun:web, rerun:web:PORT,"
    " rerun:FILE.rrd, mcap:FILE; again for more."
)
_STREAM = "Single value of the model `live`, such as pose_wait=0.5; again for more."
_FOLDER = (
    "Folder to write: what `detect` or `circles` would leave of the scans that were processed."
)
_CAPABILITY = "auto: flying objects if clouds arrive, circles if 2D scans do."

SourceName: TypeAlias = Annotated[str | None, typer.Option("--in", help=_IN, rich_help_panel=READ)]
Replay: TypeAlias = Annotated[
    Path | None, typer.Option(help="Play this recording instead.", rich_help_panel=READ)
]
Rate: TypeAlias = Annotated[
    float | None,
    typer.Option(
        min=0.01,
        show_default="1",
        help="Seconds of the recording per second, for --replay.",
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
    typer.Option("--cloud", help="Topic of a LiDAR; again for more.", rich_help_panel=READ),
]
Scans: TypeAlias = Annotated[
    list[str],
    typer.Option("--scan", help="Topic of a 2D LiDAR; again for more.", rich_help_panel=READ),
]
PointTime: TypeAlias = Annotated[str | None, typer.Option(help=POINT_TIME, rich_help_panel=READ)]
NoReturn: TypeAlias = Annotated[str | None, typer.Option(help=NO_RETURN, rich_help_panel=READ)]
KnownMap: TypeAlias = Annotated[
    Path | None, typer.Option("--map", help=f"{MAP} Only clouds count then.")
]
Domain: TypeAlias = Annotated[
    int | None,
    typer.Option(envvar="ROS_DOMAIN_ID", help="Domain of ROS 2 over Zenoh.", rich_help_panel=READ),
]
Stream: TypeAlias = Annotated[list[str], typer.Option(help=_STREAM)]
Seconds: TypeAlias = Annotated[float | None, typer.Option(min=0, help="End after this time \\[s].")]
Folder: TypeAlias = Annotated[
    Path | None, typer.Option("--output", "-o", help=_FOLDER, rich_help_panel=WRITTEN)
]


@dataclass(frozen=True, slots=True, kw_only=True)
class LiveOptions(PipelineOptions):
    """What it listens to, what it makes of that, and where that goes."""

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
    overwrite: OverwriteFile = False
    threads: Threads

    def read(self) -> "ReadOptions":
        """How messages are read."""
        from lidar_core.io import ReadOptions

        told = {"point_time": self.point_time, "no_return": self.no_return}
        return ReadOptions.load(given(told))
