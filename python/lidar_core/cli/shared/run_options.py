"""Options that commands on recordings share."""

from collections.abc import Callable
from dataclasses import MISSING, Field, dataclass, field, fields
from functools import wraps
from inspect import Parameter, Signature, signature
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias, get_type_hints

import typer

from lidar_core.cli.shared import completion
from lidar_core.cli.shared.common import READ, WRITTEN, JsonFile, Mode, given_options

if TYPE_CHECKING:
    from lidar_core.io import PoseOptions
    from lidar_core.runs import ConfigChoice

_POSE = (
    "auto: transforms or odometry of the recording; static: the sensor does not move; kiss:"
    " KISS-ICP; or a file of poses (KITTI, TUM)."
)
_PLANAR_POSE = _POSE.replace(" kiss: KISS-ICP;", "")
_MOUNTING = "Mounting of a sensor: PARENT FRAME x y z roll pitch yaw \\[m, rad]; may be repeated."
_FIXED_FRAME = "Frame of the map; default: root of the transform tree."
_SET = "Set a value: SECTION.NAME=VALUE, as in `config show`; may be repeated."
_CONFIG = "TOML file; the run.toml of an earlier run is also accepted."
_START = "Start this long after the first stamp \\[s]."
_END = "End this long after the first stamp \\[s]."
_MCAP = "Write run.mcap for viewers; default: yes, if the extra `viz` is installed."

POINT_TIME = "Time of each point: FIELD:UNIT:REFERENCE such as t:ns:start, auto or none."
_NO_RETURN = "What marks a ray without return: auto, zero, nan, max or none."
METADATA = "JSON metadata of an Ouster capture, if it is not beside the capture."
_RECOVER = (
    "Read the complete parts of an MCAP file that is cut off or was not closed, or of a folder with"
    " damaged files."
)

_STAMPS = "Times of scans: own (as stated), recorded (when stored) or counted (by --scan-rate)."
_SCAN_RATE = "Scans per second for counted times, or for a folder without times \\[Hz]."

RecordingPath: TypeAlias = Annotated[Path, typer.Argument(help="File or folder to read.")]
Output: TypeAlias = Annotated[
    Path, typer.Option("--output", "-o", help="Folder to write.", rich_help_panel=WRITTEN)
]
PointTime: TypeAlias = Annotated[str | None, typer.Option(help=POINT_TIME)]
NoReturn: TypeAlias = Annotated[str | None, typer.Option(help=_NO_RETURN)]
Metadata: TypeAlias = Annotated[str | None, typer.Option(help=METADATA)]
Stamps: TypeAlias = Annotated[str | None, typer.Option(help=_STAMPS, rich_help_panel=READ)]
ScanRate: TypeAlias = Annotated[float | None, typer.Option(help=_SCAN_RATE, rich_help_panel=READ)]
Recover: TypeAlias = Annotated[bool, typer.Option("--recover", help=_RECOVER)]
Start: TypeAlias = Annotated[float, typer.Option(min=0, help=_START, rich_help_panel=READ)]
End: TypeAlias = Annotated[float | None, typer.Option(min=0, help=_END, rich_help_panel=READ)]
Odom: TypeAlias = Annotated[
    str | None,
    typer.Option(
        help="Topic of odometry or poses.",
        rich_help_panel=READ,
        autocompletion=completion.POSES,
    ),
]
PoseSource: TypeAlias = Annotated[str | None, typer.Option(help=_POSE, rich_help_panel=READ)]
PlanarPoseSource: TypeAlias = Annotated[
    str | None, typer.Option(help=_PLANAR_POSE, rich_help_panel=READ)
]
FixedFrame: TypeAlias = Annotated[str | None, typer.Option(help=_FIXED_FRAME, rich_help_panel=READ)]
Mountings: TypeAlias = Annotated[list[str], typer.Option(help=_MOUNTING, rich_help_panel=READ)]
ChosenMode: TypeAlias = Annotated[
    Mode, typer.Option(help="best: measured best; paper: as published.")
]
ConfigFile: TypeAlias = Annotated[Path | None, typer.Option(help=_CONFIG)]
Values: TypeAlias = Annotated[list[str], typer.Option("--set", help=_SET)]
Mcap: TypeAlias = Annotated[bool | None, typer.Option(help=_MCAP, rich_help_panel=WRITTEN)]
Picture: TypeAlias = Annotated[
    bool, typer.Option(help="Draw picture.png (extra `plot`).", rich_help_panel=WRITTEN)
]
Overwrite: TypeAlias = Annotated[
    bool,
    typer.Option(
        "--overwrite", help="Replace an earlier run in the folder.", rich_help_panel=WRITTEN
    ),
]
Checkpoint: TypeAlias = Annotated[
    float | None,
    typer.Option(
        metavar="SECONDS",
        help="Time between checkpoints, for --resume \\[s]; no run.mcap is written.",
        rich_help_panel=WRITTEN,
    ),
]
Resume: TypeAlias = Annotated[
    bool,
    typer.Option(
        "--resume",
        help="Continue a run that was killed; one that ended with Ctrl-C is complete.",
        rich_help_panel=WRITTEN,
    ),
]


@dataclass(frozen=True, slots=True, kw_only=True)
class PipelineOptions:
    """Options of every command that processes scans with a pipeline."""

    odom: Odom = None
    pose: PoseSource = None
    fixed_frame: FixedFrame = None
    mounting: Mountings = field(default_factory=list)
    mode: ChosenMode = "best"
    config: ConfigFile = None
    values: Values = field(default_factory=list)
    json: JsonFile = None

    def poses(self) -> "PoseOptions":
        """Return the source of the poses, and the part of a recording that is used."""
        from lidar_core.io import PoseOptions

        names = [name for name in PoseOptions.model_fields if hasattr(self, name)]
        return PoseOptions.load(given_options({name: getattr(self, name) for name in names}))

    def choice(self) -> "ConfigChoice":
        """Return the choice of the pipeline's configuration."""
        from lidar_core.runs import ConfigChoice

        return ConfigChoice(self.mode, self.config, tuple(self.values))


@dataclass(frozen=True, slots=True, kw_only=True)
class RunOptions(PipelineOptions):
    """Options of commands that process a recording and write a run folder."""

    recording: RecordingPath
    output: Output
    start: Start = 0.0
    end: End = None
    mcap: Mcap = None
    picture: Picture = True
    overwrite: Overwrite = False
    checkpoint: Checkpoint = None
    resume: Resume = False


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanarRunOptions(RunOptions):
    """Options of a command for 2D scans, from which KISS-ICP finds no poses."""

    pose: PlanarPoseSource = None


@dataclass(frozen=True, slots=True, kw_only=True)
class DecodingOptions:
    """Options for decoding messages, of commands that only read a recording."""

    point_time: PointTime = None
    no_return: NoReturn = None
    metadata: Metadata = None
    stamps: Stamps = None
    scan_rate: ScanRate = None
    recover: Recover = False

    def to_values(self) -> dict[str, Any]:
        """Return the given values for `ReadOptions`."""
        values = {one.name: getattr(self, one.name) for one in fields(self)}
        return given_options(values | {"recover": self.recover or None})


def with_options(
    sort: type[PipelineOptions | DecodingOptions],
) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Decorate a command so that typer offers every field of its first argument, a `sort`."""
    hints = get_type_hints(sort, include_extras=True)
    shared = [
        Parameter(
            one.name, Parameter.KEYWORD_ONLY, default=_default(one), annotation=hints[one.name]
        )
        for one in fields(sort)
    ]

    def decorated(command: Callable[..., None]) -> Callable[..., None]:
        @wraps(command)
        def called(**values: Any) -> None:
            options = sort(**{one.name: values.pop(one.name) for one in shared})
            command(options, **values)

        own = list(signature(command).parameters.values())[1:]
        called.__signature__ = Signature([*shared, *own])  # type: ignore[attr-defined]
        return called

    return decorated


def _default(option: Field[Any]) -> Any:
    if option.default_factory is not MISSING:
        return option.default_factory()
    return Parameter.empty if option.default is MISSING else option.default
