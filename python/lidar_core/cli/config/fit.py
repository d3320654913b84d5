"""`lidar-core config fit`: noise from recordings."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from lidar_core.cli.shared.common import Mode, OverwriteFile, given, result_table
from lidar_core.cli.shared.measurement_options import (
    AngleUnit,
    ColumnNames,
    Method,
    Model,
    TimeUnit,
    Topics,
    columns_of,
    topics_of,
)
from lidar_core.cli.shared.run_options import ConfigFile, End, Start, Values

if TYPE_CHECKING:
    from lidar_core.fusion import FusionConfig
    from lidar_core.util.rows import Row

RECORDINGS = (
    "Measurements of one target each: L/R text, a table (CSV, Parquet, .npz), a ROS recording"
    " (.bag, .db3, .mcap, folder)."
)


def command(
    recordings: Annotated[list[Path], typer.Argument(metavar="RECORDING", help=RECORDINGS)],
    *,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="File to write; without it printed.")
    ] = None,
    model: Model = None,
    method: Method = None,
    column: ColumnNames = [],  # noqa: B006
    topic: Topics = [],  # noqa: B006
    time_unit: TimeUnit = None,
    angle_unit: AngleUnit = None,
    start: Start = 0.0,
    end: End = None,
    mode: Annotated[Mode, typer.Option(help="Whose defaults.")] = "best",
    config: ConfigFile = None,
    values: Values = [],  # noqa: B006
    overwrite: OverwriteFile = False,
) -> None:
    """Find the noise of motion and sensors under which RECORDINGs are most likely.

    No truth is needed. The file that is written is for `fuse --config`.
    """
    from lidar_core import runs
    from lidar_core.errors import ConfigError
    from lidar_core.fusion import FusionConfig
    from lidar_core.io import Span
    from lidar_core.io.files.atomic import written_whole
    from lidar_core.parameters import commented_toml
    from lidar_core.runs.settings import config_of_run

    if output is not None and output.exists() and not overwrite:
        raise ConfigError(f"{output}: exists; --overwrite replaces it")
    choice = runs.ConfigChoice(mode, config, tuple(values))
    fitted = runs.fit_config(
        recordings,
        choice,
        model=model,
        method=method,
        columns=columns_of(column),
        topics=topics_of(topic),
        time_unit=time_unit,
        angle_unit=angle_unit,
        span=Span.load(given({"start": start, "end": end})),
    )
    text = commented_toml(fitted)
    if output is None:
        print(text, end="")
        return
    with written_whole(output) as temporary:
        temporary.write_text(text, encoding="utf-8")
    from rich.console import Console

    before = config_of_run(choice, FusionConfig, "fusion")
    Console().print(result_table("Noise", _rows(before, fitted)))
    print(output)


def _rows(before: "FusionConfig", fitted: "FusionConfig") -> list["Row | None"]:
    """Values that the fit changed."""
    from lidar_core.util.rows import Row

    noise = ("acceleration_noise", "jerk_noise", "turn_noise", "lidar_std", "radar_std")
    return [
        Row(name, _text(getattr(fitted, name)), f"{_text(getattr(before, name))} before")
        for name in noise
        if getattr(fitted, name) != getattr(before, name)
    ]


def _text(value: float | tuple[float, ...]) -> str:
    numbers = value if isinstance(value, tuple) else (value,)
    return ", ".join(f"{one:.4g}" for one in numbers)
