"""`lidar-core fuse`: targets from the LiDAR and radar of a recording."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lidar_core.cli.shared.common import JsonFile, given_options, report, result_table
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
from lidar_core.cli.shared.run_options import (
    Checkpoint,
    ChosenMode,
    ConfigFile,
    End,
    Mcap,
    Output,
    Overwrite,
    Picture,
    Resume,
    Start,
    Values,
)
from lidar_core.util.rows import Row, number

if TYPE_CHECKING:
    from rich.table import Table

RECORDING = (
    "Text with lines L (LiDAR) and R (radar), a table (CSV, TSV, Parquet, .npz), a ROS recording"
    " (.bag, .db3, .mcap, folder), or detections of many targets (Autoferry, nuScenes, Delphi,"
    " Continental)."
)
ASSOCIATION = "Data association of many targets: integrated (JIPDA), nearest, or joint (JPDA)."
LAG = (
    "Smooth the states of one target: each state also uses the measurements of this time after it"
    " \\[s]."
)
FIT = (
    "First fit the noise of motion and sensors to the measurements, like `config fit`. If neither"
    " model nor method is given, the fit also chooses the model (ct or ctrv)."
)
FORCE = "Continue even if the NIS of the measurements or the unit of their times is implausible."


def command(
    recording: Annotated[Path, typer.Argument(help=RECORDING)],
    *,
    output: Output,
    model: Model = None,
    method: Method = None,
    lag: Annotated[float | None, typer.Option(help=LAG)] = None,
    association: Annotated[str | None, typer.Option(help=ASSOCIATION)] = None,
    column: ColumnNames = [],  # noqa: B006
    topic: Topics = [],  # noqa: B006
    time_unit: TimeUnit = None,
    angle_unit: AngleUnit = None,
    azimuth: Azimuths = [],  # noqa: B006
    clock: Clocks = [],  # noqa: B006
    scale: Scales = [],  # noqa: B006
    start: Start = 0.0,
    end: End = None,
    mode: ChosenMode = "best",
    config: ConfigFile = None,
    values: Values = [],  # noqa: B006
    fit_noise: Annotated[bool, typer.Option("--fit-noise", help=FIT)] = False,
    force: Annotated[bool, typer.Option("--force", help=FORCE)] = False,
    mcap: Mcap = None,
    picture: Picture = True,
    overwrite: Overwrite = False,
    checkpoint: Checkpoint = None,
    resume: Resume = False,
    json: JsonFile = None,
) -> None:
    """Track one or many targets in RECORDING; write states, covariances, NIS and a picture.

    If the recording holds ground truth, the table and the summary show the errors. If the
    measurements of one target have an implausible NIS, the run ends with an error that names
    likely causes; --force continues.
    """
    from lidar_core import runs
    from lidar_core.io import Span

    result = runs.fuse(
        recording,
        runs.ConfigChoice(mode, config, tuple(values)),
        output,
        model=model,
        method=method,
        association=association,
        lag=lag,
        columns=columns_of(column),
        topics=topics_of(topic),
        time_unit=time_unit,
        angle_unit=angle_unit,
        azimuth=azimuths_of(azimuth),
        clock=clocks_of(clock),
        scale=scales_of(scale),
        span=Span.load(given_options({"start": start, "end": end})),
        fit_noise=fit_noise,
        force=force,
        mcap=mcap,
        picture=picture,
        overwrite=overwrite,
        checkpoint=checkpoint,
        resume=resume,
    )
    report(result, _table(result.summary, recording.name), json)


def _table(summary: Mapping[str, Any], name: str) -> "Table":
    rows = _many_rows(summary) if "targets" in summary else _one_rows(summary)
    ways = [summary[key] for key in ("model", "method", "association") if key in summary]
    title = f"{name} ({summary['format']}): {', '.join(ways)}"
    return result_table(title, rows)


def _many_rows(summary: Mapping[str, Any]) -> list[Row | None]:
    counts = ", ".join(f"{count} {source}" for source, count in summary["scans"].items())
    rows: list[Row | None] = [
        Row("scans", str(sum(summary["scans"].values())), counts),
        Row("detections", str(summary["measurements"]), ""),
        Row("time", f"{summary['duration']:.1f} s", ""),
        Row("tracks", str(summary["tracks"]), ""),
        None,
    ]
    for target, scores in summary["targets"].items():
        share = scores["share"]
        covered = "-" if share is None else f"{100 * share:.1f} %"
        remark = f"RMSE {number(scores['rmse'], 1, ' m')}, {scores['n_ids']} tracks"
        rows.append(Row(f"target {target} tracked", covered, remark))
    rows += _nis_rows(summary)
    if summary["gospa"]:
        parts = {name: summary["gospa"][name] for name in ("localisation", "missed", "false")}
        remark = ", ".join(f"{name} {value:.0f}" for name, value in parts.items())
        empty = f"{summary['gospa_empty']['distance']:.1f} m"
        rows += [
            Row("GOSPA", f"{summary['gospa']['distance']:.1f} m", remark),
            Row("GOSPA of an empty output", empty, "no tracks at all"),
        ]
    return [*rows, None, Row("time per scan", f"{summary['us_per_scan']:.0f} us", "")]


def _nis_rows(summary: Mapping[str, Any]) -> list[Row]:
    return [
        Row(
            f"NIS {sensor}",
            f"{values['mean']:.2f}",
            f"{100 * values['share_below_limit']:.0f} % below the limit of 95 %",
        )
        for sensor, values in summary["nis"].items()
    ]


def _one_rows(summary: Mapping[str, Any]) -> list[Row | None]:
    counts, values = summary["measurements"], summary["measured"]
    outcomes = ", ".join(f"{count} {what}" for what, count in summary["outcomes"].items())
    rows: list[Row | None] = [
        Row(
            "measurements",
            str(sum(counts.values())),
            ", ".join(f"{count} {sensor}" for sensor, count in counts.items()),
        ),
        *(Row(f"{sensor} measured", "", ", ".join(names)) for sensor, names in values.items()),
        Row("time", f"{summary['duration']:.1f} s", ""),
        Row("what became of them", "", outcomes),
        *(Row("invalid", str(count), reason) for reason, count in summary["invalid"].items()),
    ]
    rows += _nis_rows(summary)
    rmse = summary["rmse"]
    if rmse is not None:
        rows += [
            None,
            *(
                Row(f"RMSE {axis}", number(rmse[axis], 4, " m" if axis in "xy" else " m/s"), "")
                for axis in ("x", "y", "vx", "vy")
                if rmse[axis] is not None
            ),
            Row("NEES of the position", number(rmse["position_nees"], 2), "2 is expected"),
        ]
    return [*rows, None, Row("time per measurement", f"{summary['us_per_measurement']:.1f} us", "")]
