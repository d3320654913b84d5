"""`lidar-core fuse`: targets from the LiDAR and radar of a recording."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lidar_core.cli.common import JsonFile, Row, consoles, given, number, result_table, write_json
from lidar_core.cli.config import Mode
from lidar_core.cli.run_options import (
    ChosenMode,
    ConfigFile,
    Output,
    Overwrite,
    Picture,
    Values,
)
from lidar_core.cli.settings import run_config
from lidar_core.errors import ConfigError

if TYPE_CHECKING:
    from rich.table import Table

    from lidar_core.cli.fuse_many_run import ManyRun
    from lidar_core.cli.fuse_run import TargetRun

RECORDING = "L/R text, a table (CSV, Parquet, .npz), or detections of Autoferry (.json)."
MODEL = "How targets move: cv, ca, ct, ctrv, ctra, ctrv-drone, paper."
METHOD = "Filter: kf, ekf, ukf, ckf, imm."
LAG = "Smooth: every state knows what came up to this much later \\[s]."
COLUMN = "Name of a table's column, such as x=pos_x; again for more."
TIME_UNIT = "Unit of a table's times: ns, us, ms or s."
ANGLE_UNIT = "Unit of a table's angles: rad or deg."


def command(
    recording: Annotated[Path, typer.Argument(help=RECORDING)],
    *,
    output: Output,
    model: Annotated[str | None, typer.Option(help=MODEL)] = None,
    method: Annotated[str | None, typer.Option(help=METHOD)] = None,
    lag: Annotated[float | None, typer.Option(help=LAG)] = None,
    column: Annotated[list[str], typer.Option(help=COLUMN)] = [],  # noqa: B006
    time_unit: Annotated[str | None, typer.Option(help=TIME_UNIT)] = None,
    angle_unit: Annotated[str | None, typer.Option(help=ANGLE_UNIT)] = None,
    mode: ChosenMode = "best",
    config: ConfigFile = None,
    values: Values = [],  # noqa: B006
    picture: Picture = True,
    overwrite: Overwrite = False,
    json: JsonFile = None,
) -> None:
    """Track the target of RECORDING, or all boats; write states, covariances, NIS and a picture.

    With the truth in the recording, the table and the summary hold what was right.
    """
    from lidar_core.run_folder import RunFolder, fingerprint

    options = given({"model": model, "method": method})
    units = {"time_unit": time_unit, "angle_unit": angle_unit}
    folder = RunFolder(output, overwrite=overwrite)
    table = {"columns": _column_map(column), **given(units)}
    run: TargetRun | ManyRun
    if recording.suffix == ".json":
        run = _many(recording, mode, config, [*values, *_texts("target.", options)], lag)
    else:
        run = _one(recording, mode, config, [*values, *_texts("", options)], lag, table)
    out, errors = consoles(json)
    folder.begin()
    files = run.write(folder)
    summary = {"command": "fuse", "recording": str(recording), **run.summary()}
    folder.write_summary(summary)
    folder.write_note({"recording": fingerprint(recording)}, run.configs)
    if picture:
        files += run.draw(folder, recording.name, errors)
    files = sorted([*files, "run.toml", "summary.json"])
    out.print(_table(summary, recording.name))
    out.print(f"{folder.path}: {', '.join(files)}", highlight=False, soft_wrap=True)
    write_json({**summary, "files": files}, json)


def _one(
    recording: Path,
    mode: Mode,
    file: Path | None,
    values: list[str],
    lag: float | None,
    table: dict[str, Any],
) -> "TargetRun":
    from lidar_core.cli.fuse_run import TargetRun
    from lidar_core.fusion import FusionConfig, TableOptions, read_measurements

    base = FusionConfig() if mode == "best" else FusionConfig.paper()
    chosen = run_config(base, "fusion", file, values)
    options = TableOptions.load(table)
    return TargetRun.of(read_measurements(recording, options), chosen, options, lag=lag)


def _many(
    recording: Path, mode: Mode, file: Path | None, values: list[str], lag: float | None
) -> "ManyRun":
    from lidar_core.cli.fuse_many_run import ManyRun
    from lidar_core.fusion import AutoferryOptions, MultiTargetConfig

    if lag is not None or mode == "paper":
        raise ConfigError(f"{recording}: many targets; --lag and --mode paper are for one")
    chosen = run_config(MultiTargetConfig.boats(), "fusion_many", file, values)
    return ManyRun.of(recording, chosen, AutoferryOptions())


def _texts(prefix: str, options: Mapping[str, Any]) -> list[str]:
    return [f'{prefix}{name}="{value}"' for name, value in options.items()]


def _column_map(texts: list[str]) -> dict[str, str]:
    pairs = [text.partition("=") for text in texts]
    for text, (ours, equals, theirs) in zip(texts, pairs, strict=True):
        if not (ours and equals and theirs):
            raise ConfigError(f"--column {text}: expected OURS=THEIRS, such as x=pos_x")
    return {ours: theirs for ours, _, theirs in pairs}


def _table(summary: Mapping[str, Any], name: str) -> "Table":
    rows = _many_rows(summary) if "targets" in summary else _one_rows(summary)
    title = f"{name} ({summary['format']}): {summary['model']}, {summary['method']}"
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
    if summary["gospa"]:
        parts = {name: summary["gospa"][name] for name in ("localisation", "missed", "false")}
        remark = ", ".join(f"{name} {value:.0f}" for name, value in parts.items())
        rows.append(Row("GOSPA", f"{summary['gospa']['distance']:.1f} m", remark))
    return [*rows, None, Row("time per scan", f"{summary['us_per_scan']:.0f} us", "")]


def _one_rows(summary: Mapping[str, Any]) -> list[Row | None]:
    counts = summary["measurements"]
    outcomes = ", ".join(f"{count} {what}" for what, count in summary["outcomes"].items())
    rows: list[Row | None] = [
        Row("measurements", str(sum(counts.values())),
            ", ".join(f"{count} {sensor}" for sensor, count in counts.items())),
        Row("time", f"{summary['duration']:.1f} s", ""),
        Row("what became of them", "", outcomes),
    ]  # fmt: skip
    rows += [
        Row(f"NIS {sensor}", f"{values['mean']:.2f}",
            f"{100 * values['share_below_limit']:.0f} % below the limit of 95 %")
        for sensor, values in summary["nis"].items()
    ]  # fmt: skip
    rmse = summary["rmse"]
    if rmse is not None:
        rows += [
            None,
            *(Row(f"RMSE {axis}", number(rmse[axis], 4, " m" if axis in "xy" else " m/s"), "")
              for axis in ("x", "y", "vx", "vy")),
            Row("NEES of the position", number(rmse["position_nees"], 2), "2 is expected"),
        ]  # fmt: skip
    return [*rows, None, Row("time per measurement", f"{summary['us_per_measurement']:.1f} us", "")]
