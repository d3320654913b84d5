"""`lidar-core config fit`: noise from recordings."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from lidar_core.cli.shared.common import (
    Mode,
    OverwriteFile,
    check_new,
    given_options,
    result_table,
)
from lidar_core.cli.shared.measurement_options import (
    AngleUnit,
    Azimuths,
    Clocks,
    ColumnNames,
    Method,
    Model,
    Scales,
    TimeUnit,
    Topics,
    azimuths_of,
    clocks_of,
    columns_of,
    scales_of,
    topics_of,
)
from lidar_core.cli.shared.run_options import ConfigFile, End, Start, Values

if TYPE_CHECKING:
    from lidar_core.fusion import FusionConfig
    from lidar_core.util.rows import Row

FORCE = "Continue even if the measurements contain mistakes; the fit treats them as noise."
FACTOR = 1000
"""How far a fit may go from where it begins, up or down."""
RECORDINGS = (
    "Measurements of one target each: text with lines L (LiDAR) and R (radar), a table (CSV,"
    " Parquet, .npz), a ROS recording (.bag, .db3, .mcap, folder)."
)


def command(
    recordings: Annotated[list[Path], typer.Argument(metavar="RECORDING", help=RECORDINGS)],
    *,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="File to write; default, or with -: standard output."),
    ] = None,
    model: Model = None,
    method: Method = None,
    column: ColumnNames = [],  # noqa: B006
    topic: Topics = [],  # noqa: B006
    time_unit: TimeUnit = None,
    angle_unit: AngleUnit = None,
    azimuth: Azimuths = [],  # noqa: B006
    clock: Clocks = [],  # noqa: B006
    scale: Scales = [],  # noqa: B006
    start: Start = 0.0,
    end: End = None,
    mode: Annotated[Mode, typer.Option(help="Defaults of best mode or of paper mode.")] = "best",
    config: ConfigFile = None,
    values: Values = [],  # noqa: B006
    force: Annotated[bool, typer.Option("--force", help=FORCE)] = False,
    overwrite: OverwriteFile = False,
) -> None:
    """Fit the noise of motion and sensors to recordings.

    No ground truth is needed. `fuse --config` takes the file that is written. Mistakes in the
    measurements, such as exchanged axes, end the fit with an error.
    """
    from lidar_core import runs
    from lidar_core.fusion import FusionConfig
    from lidar_core.io import Span
    from lidar_core.io.files.atomic import written_whole
    from lidar_core.parameters import commented_toml
    from lidar_core.runs.settings import config_of_run

    if output == Path("-"):
        output = None
    if output is not None:
        _check_output(output, recordings, overwrite=overwrite)
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
        azimuth=azimuths_of(azimuth),
        clock=clocks_of(clock),
        scale=scales_of(scale),
        span=Span.load(given_options({"start": start, "end": end})),
        force=force,
    )
    text = commented_toml(fitted)
    if output is None:
        print(text, end="")
        return
    with written_whole(output) as temporary:
        temporary.write_text(text, encoding="utf-8")
    from rich.console import Console

    rows = _rows(config_of_run(choice, FusionConfig, "fusion"), fitted)
    if rows:
        Console().print(result_table("Noise", rows))
    print(output)


def _check_output(output: Path, recordings: list[Path], *, overwrite: bool) -> None:
    """Refuse a file that exists, that cannot be written, or that is an input."""
    from lidar_core.errors import ConfigError
    from lidar_core.io.files.atomic import check_place

    check_new(output, overwrite=overwrite)
    check_place(output)
    if any(output.exists() and one.exists() and output.samefile(one) for one in recordings):
        raise ConfigError(f"{output}: is also an input; choose another file to write")


def _rows(before: "FusionConfig", fitted: "FusionConfig") -> list["Row | None"]:
    """Rows of the values that the fit changed."""
    from lidar_core.util.rows import Row

    rows: list[Row | None] = [
        Row(name, getattr(fitted, name), f"{getattr(before, name)} before")
        for name in ("model", "sensor_noise")
        if getattr(fitted, name) != getattr(before, name)
    ]
    for name in ("acceleration_noise", "jerk_noise", "turn_noise", "lidar_std", "radar_std"):
        old, new = (_numbers(getattr(config, name)) for config in (before, fitted))
        if old == new:
            continue
        remark = f"{_text(old)} before"
        factors = [b / a for a, b in zip(old, new, strict=True) if a > 0]
        if any(one >= 0.999 * FACTOR or one <= 1.001 / FACTOR for one in factors):
            remark += "; at the limit of the search"
        rows.append(Row(name, _text(new), remark))
    return rows


def _numbers(value: float | tuple[float, ...]) -> tuple[float, ...]:
    return value if isinstance(value, tuple) else (value,)


def _text(numbers: tuple[float, ...]) -> str:
    return ", ".join(f"{one:.4g}" for one in numbers)
