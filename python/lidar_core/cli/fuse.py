"""`lidar-core fuse`: targets from the LiDAR and radar of a recording."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from lidar_core.cli.common import (
    READ,
    JsonFile,
    Row,
    consoles,
    given,
    number,
    result_table,
    write_json,
)
from lidar_core.cli.config import Mode
from lidar_core.cli.run_options import (
    ChosenMode,
    ConfigFile,
    End,
    Mcap,
    Output,
    Overwrite,
    Picture,
    Start,
    Values,
    wants_mcap,
)
from lidar_core.cli.settings import run_config
from lidar_core.errors import ConfigError, InputError

if TYPE_CHECKING:
    from rich.table import Table

    from lidar_core.cli.fuse_many_run import ManyRun
    from lidar_core.cli.fuse_run import TargetRun
    from lidar_core.config import Config
    from lidar_core.fusion import DetectionScan, MeasurementLog
    from lidar_core.io import Span

BAGS = (".bag", ".db3", ".mcap")
RECORDING = (
    "L/R text, a table (CSV, Parquet, .npz), a ROS recording (.bag, .db3, .mcap, folder), or"
    " detections of Autoferry (.json)."
)
MODEL = "How targets move: cv, ca, ct, ctrv, ctra, ctrv-drone, paper."
METHOD = "Filter: kf, ekf, ukf, ckf, imm."
ASSOCIATION = "Of many targets: nearest, or joint (JPDA)."
LAG = "Smooth: every state knows what came up to this much later \\[s]."
COLUMN = "Name of a table's column, such as x=pos_x; again for more."
TOPIC = "Topic of a ROS recording, such as radar=/front or pose=/odom; again for more."
TIME_UNIT = "Unit of a table's times: ns, us, ms or s."
ANGLE_UNIT = "Unit of a table's angles: rad or deg."
FORCE = "Go on with measurements whose NIS is beyond reason."


def command(
    recording: Annotated[Path, typer.Argument(help=RECORDING)],
    *,
    output: Output,
    model: Annotated[str | None, typer.Option(help=MODEL)] = None,
    method: Annotated[str | None, typer.Option(help=METHOD)] = None,
    lag: Annotated[float | None, typer.Option(help=LAG)] = None,
    association: Annotated[str | None, typer.Option(help=ASSOCIATION)] = None,
    column: Annotated[list[str], typer.Option(help=COLUMN, rich_help_panel=READ)] = [],  # noqa: B006
    topic: Annotated[list[str], typer.Option(help=TOPIC, rich_help_panel=READ)] = [],  # noqa: B006
    time_unit: Annotated[str | None, typer.Option(help=TIME_UNIT, rich_help_panel=READ)] = None,
    angle_unit: Annotated[str | None, typer.Option(help=ANGLE_UNIT, rich_help_panel=READ)] = None,
    start: Start = 0.0,
    end: End = None,
    mode: ChosenMode = "best",
    config: ConfigFile = None,
    values: Values = [],  # noqa: B006
    force: Annotated[bool, typer.Option("--force", help=FORCE)] = False,
    mcap: Mcap = None,
    picture: Picture = True,
    overwrite: Overwrite = False,
    json: JsonFile = None,
) -> None:
    """Track the target of RECORDING, or many; write states, covariances, NIS and a picture.

    With the truth in the recording, the table and the summary hold what was right. Measurements
    of one target whose NIS is beyond reason end the run; the text names the likely causes.
    """
    from lidar_core.io import Span
    from lidar_core.run_folder import RunFolder, fingerprint

    folder, writes_mcap = RunFolder(output, overwrite=overwrite, reads=recording), wants_mcap(mcap)
    read = {
        "columns": _pairs("column", column, "x=pos_x"),
        "topics": _pairs("topic", topic, "radar=/front"),
        **given({"time_unit": time_unit, "angle_unit": angle_unit}),
    }
    ways = given({"model": model, "method": method, "association": association})
    span = Span.load(given({"start": start, "end": end}))
    run = _run(_Asked(recording, mode, config, values, lag, ways, read, span, force))
    out, errors = consoles(json)
    if run.doubt:
        errors.print(f"note: {run.doubt}", markup=False, highlight=False, soft_wrap=True)
    folder.begin()
    files = run.write(folder)
    summary = {"command": "fuse", "recording": str(recording), **run.summary()}
    folder.write_summary(summary)
    folder.write_note({"recording": fingerprint(recording)}, run.configs)
    if writes_mcap and (mcap or not (run.stamps < 0).any()):
        files.append(run.write_mcap(folder))
    if picture:
        files += run.draw(folder, recording.name, errors)
    files = sorted([*files, "run.toml", "summary.json"])
    out.print(_table(summary, recording.name))
    out.print(f"{folder.path}: {', '.join(files)}", highlight=False, soft_wrap=True)
    write_json({**summary, "files": files}, json)


class _Asked(NamedTuple):
    """What to fuse, and how."""

    recording: Path
    mode: Mode
    file: Path | None
    values: list[str]
    lag: float | None
    ways: dict[str, str]
    read: dict[str, Any]
    span: "Span"
    force: bool

    def kept(self, stamps: Sequence[int]) -> list[int]:
        """Rows within the span, of those with these times.

        Raises
        ------
        InputError
            There are none.
        """
        from lidar_core.io.options import NS

        first = min(stamps, default=0)
        rows = [row for row, stamp in enumerate(stamps) if self.span.holds(stamp, first)]
        if stamps and not rows:
            end = (max(stamps) - first) / NS
            raise InputError(
                f"{self.recording}: no measurements {self.span}; they end at {end:g} s"
            )
        return rows


def _run(asked: _Asked) -> "TargetRun | ManyRun":
    from lidar_core.fusion import AutoferryOptions, TableOptions, read_autoferry, read_measurements
    from lidar_core.fusion.recordings.table import TABLES

    recording, read = asked.recording, asked.read
    if recording.suffix == ".json":
        _check_read(asked, "detections of Autoferry", ())
        reading = {"fusion_autoferry": AutoferryOptions()}
        return _many(asked, read_autoferry(recording), reading, "Autoferry")
    if recording.is_dir() or recording.suffix.lower() in BAGS:
        _check_read(asked, "a ROS recording", ("topics",))
        return _bag(asked)
    is_table = recording.suffix in TABLES
    of_tables = ("columns", "time_unit", "angle_unit")
    _check_read(asked, *(("a table", of_tables) if is_table else ("L/R text", ())))
    columns = {ours: theirs[-1] for ours, theirs in read["columns"].items()}
    units = {name: value for name, value in read.items() if name.endswith("_unit")}
    options = TableOptions.load({"columns": columns, **units})
    return _one(asked, read_measurements(recording, options), {"fusion_table": options})


def _check_read(asked: _Asked, what: str, used: tuple[str, ...]) -> None:
    """Refuse options of reading that would do nothing."""
    for name, value in asked.read.items():
        if value and name not in used:
            option = name.removesuffix("s").replace("_", "-")
            raise ConfigError(f"{asked.recording}: --{option} says nothing about {what}")


def _bag(asked: _Asked) -> "TargetRun | ManyRun":
    """One target, unless a message holds several or a way to share them out was asked for."""
    from lidar_core.fusion import BagOptions, MeasurementLog, read_bag

    options = BagOptions.load({"topics": asked.read["topics"]})
    scans, reading = read_bag(asked.recording, options), {"fusion_bag": options}
    if "association" in asked.ways or any(len(scan.measurements) > 1 for scan in scans):
        return _many(asked, scans, reading, "ROS")
    measurements = [m for scan in scans for m in scan.measurements]
    return _one(asked, MeasurementLog(measurements, None, "ROS"), reading)


def _one(asked: _Asked, log: "MeasurementLog", reading: Mapping[str, "Config"]) -> "TargetRun":
    from lidar_core.cli.fuse_run import TargetRun
    from lidar_core.fusion import FusionConfig
    from lidar_core.fusion.plausibility import implausible

    if "association" in asked.ways:
        raise ConfigError(f"{asked.recording}: one target; --association is for many")
    base = FusionConfig() if asked.mode == "best" else FusionConfig.paper()
    chosen = run_config(base, "fusion", asked.file, [*asked.values, *_texts(asked.ways)])
    kept = log.rows(asked.kept([m.stamp_ns for m in log.measurements]))
    if chosen.model == "ctrv-drone" and any(m.sensor == "pose" for m in kept.measurements):
        raise ConfigError(
            f"{asked.recording}: model ctrv-drone is for measurements without poses"
            " of the platform, which are here; ctrv takes them in"
        )
    made = TargetRun.of(kept, chosen, {**reading, "span": asked.span}, lag=asked.lag)
    doubt = None if asked.force else implausible(made.log.measurements, made.result, chosen)
    if doubt is not None:
        raise InputError(f"{asked.recording}: {doubt}. --force goes on nevertheless")
    return made


def _many(
    asked: _Asked, scans: "list[DetectionScan]", reading: Mapping[str, "Config"], source: str
) -> "ManyRun":
    from lidar_core.cli.fuse_many_run import ManyRun
    from lidar_core.fusion import MultiTargetConfig

    if asked.lag is not None or asked.mode == "paper":
        raise ConfigError(f"{asked.recording}: many targets; --lag and --mode paper are for one")
    base = MultiTargetConfig.boats() if source == "Autoferry" else MultiTargetConfig()
    ways = {
        name if name == "association" else f"target.{name}": value
        for name, value in asked.ways.items()
    }
    chosen = run_config(base, "fusion_many", asked.file, [*asked.values, *_texts(ways)])
    kept = [scans[row] for row in asked.kept([scan.stamp_ns for scan in scans])]
    return ManyRun.of(kept, chosen, {**reading, "span": asked.span}, source=source)


def _texts(options: Mapping[str, Any]) -> list[str]:
    return [f'{name}="{value}"' for name, value in options.items()]


def _pairs(option: str, texts: list[str], example: str) -> dict[str, list[str]]:
    """Options OURS=THEIRS; whatever is ours may have several."""
    found: dict[str, list[str]] = {}
    for text in texts:
        ours, equals, theirs = text.partition("=")
        if not (ours and equals and theirs):
            raise ConfigError(f"--{option} {text}: expected OURS=THEIRS, such as {example}")
        found.setdefault(ours, []).append(theirs)
    return found


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
            Row("GOSPA of an empty output", empty, "without a single track"),
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
    counts = summary["measurements"]
    outcomes = ", ".join(f"{count} {what}" for what, count in summary["outcomes"].items())
    rows: list[Row | None] = [
        Row(
            "measurements",
            str(sum(counts.values())),
            ", ".join(f"{count} {sensor}" for sensor, count in counts.items()),
        ),
        Row("time", f"{summary['duration']:.1f} s", ""),
        Row("what became of them", "", outcomes),
    ]
    rows += _nis_rows(summary)
    rmse = summary["rmse"]
    if rmse is not None:
        rows += [
            None,
            *(
                Row(f"RMSE {axis}", number(rmse[axis], 4, " m" if axis in "xy" else " m/s"), "")
                for axis in ("x", "y", "vx", "vy")
            ),
            Row("NEES of the position", number(rmse["position_nees"], 2), "2 is expected"),
        ]
    return [*rows, None, Row("time per measurement", f"{summary['us_per_measurement']:.1f} us", "")]
