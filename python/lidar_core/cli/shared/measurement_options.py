"""Options of commands that read measurements of LiDAR and radar."""

from typing import Annotated, TypeAlias

import typer

from lidar_core.cli.shared import completion
from lidar_core.cli.shared.common import READ
from lidar_core.errors import ConfigError

_MODEL = "Motion model, such as cv, ctrv or paper; `config init --model fusion` lists all."
_METHOD = "Filter: kf, ekf, ukf, ckf, imm."
_COLUMN = "Column of a table, such as x=pos_x; may be repeated."
_TOPIC = "Topic of a ROS recording, such as radar=/front or pose=/odom; may be repeated."
_TIME_UNIT = "Unit of a table's times: ns, us, ms or s."
_ANGLE_UNIT = "Unit of a table's angles: rad or deg."
_AZIMUTH = (
    "Angle of a table that is not counter-clockwise from x, such as bearing=clockwise or"
    " pose_yaw=compass (clockwise from north); may be repeated."
)
_CLOCK = (
    "Seconds by which a sensor's clock in a table is ahead, such as radar=0.5; may be repeated."
)
_SCALE = (
    "Factor of a column of a table, such as range=0.001 for millimetres or range_rate=-1 for the"
    " other sign; may be repeated."
)

Model: TypeAlias = Annotated[str | None, typer.Option(help=_MODEL)]
Method: TypeAlias = Annotated[str | None, typer.Option(help=_METHOD)]
ColumnNames: TypeAlias = Annotated[
    list[str], typer.Option("--column", help=_COLUMN, rich_help_panel=READ)
]
Topics: TypeAlias = Annotated[
    list[str],
    typer.Option("--topic", help=_TOPIC, rich_help_panel=READ, autocompletion=completion.ALL),
]
TimeUnit: TypeAlias = Annotated[str | None, typer.Option(help=_TIME_UNIT, rich_help_panel=READ)]
Azimuths: TypeAlias = Annotated[
    list[str], typer.Option("--azimuth", help=_AZIMUTH, rich_help_panel=READ)
]
Clocks: TypeAlias = Annotated[list[str], typer.Option("--clock", help=_CLOCK, rich_help_panel=READ)]
Scales: TypeAlias = Annotated[list[str], typer.Option("--scale", help=_SCALE, rich_help_panel=READ)]
AngleUnit: TypeAlias = Annotated[str | None, typer.Option(help=_ANGLE_UNIT, rich_help_panel=READ)]


def columns_of(texts: list[str]) -> dict[str, str]:
    """Parse options --column OURS=THEIRS; the last one of a name counts."""
    found = _pairs("column", texts, "x=pos_x")
    return {ours: theirs[-1] for ours, theirs in found.items()}


def azimuths_of(texts: list[str]) -> dict[str, str]:
    """Parse options --azimuth WHAT=HOW."""
    found = _pairs("azimuth", texts, "bearing=clockwise")
    return {what: how[-1] for what, how in found.items()}


def clocks_of(texts: list[str]) -> dict[str, float]:
    """Parse options --clock SENSOR=SECONDS."""
    return _numbers("clock", texts, "radar=0.5", "seconds")


def scales_of(texts: list[str]) -> dict[str, float]:
    """Parse options --scale COLUMN=FACTOR."""
    return _numbers("scale", texts, "range=0.001", "a number")


def topics_of(texts: list[str]) -> dict[str, list[str]]:
    """Parse options --topic OURS=THEIRS; several may have the same left side."""
    return _pairs("topic", texts, "radar=/front")


def _numbers(option: str, texts: list[str], example: str, what: str) -> dict[str, float]:
    found = _pairs(option, texts, example)
    try:
        return {ours: float(theirs[-1]) for ours, theirs in found.items()}
    except ValueError as error:
        raise ConfigError(f"--{option} {' '.join(texts)}: expected {what}") from error


def _pairs(option: str, texts: list[str], example: str) -> dict[str, list[str]]:
    found: dict[str, list[str]] = {}
    for text in texts:
        ours, equals, theirs = text.partition("=")
        if not (ours and equals and theirs):
            raise ConfigError(f"--{option} {text}: expected OURS=THEIRS, such as {example}")
        found.setdefault(ours, []).append(theirs)
    return found
