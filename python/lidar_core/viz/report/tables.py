"""Tables of a report: objects, summary, times, parameters."""

import json
import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from lidar_core.errors import FormatError
from lidar_core.files import read_whole
from lidar_core.io.tables.columns import read_columns
from lidar_core.run_folder import RUN_FILE, table_in
from lidar_core.util.rows import Row, number
from lidar_core.viz.playback import Playback

MOST_OBJECTS = 500
"""Lines of the table of objects; the longest seen come first."""
DIGITS = 4
ELSEWHERE = ("track_scores", "detection_scores", "identity_scores", "latency_ms", "warnings")
"""Parts of a summary with a section of their own, and those that evaluation computes again."""


def read_summary(folder: Path) -> dict[str, Any]:
    """Read summary.json of a run; empty if the run has none."""
    path = folder / "summary.json"
    if not path.is_file():
        return {}
    try:
        summary = json.loads(read_whole(path))
    except ValueError as error:
        raise FormatError(f"{path}: expected JSON, {error}") from error
    if not isinstance(summary, dict):
        raise FormatError(f"{path}: expected an object, got {type(summary).__name__}")
    return summary


def read_note(folder: Path) -> tuple[str, dict[str, Any]]:
    """Read run.toml of a run; return it as text and as values."""
    path = folder / RUN_FILE
    try:
        text = read_whole(path).decode("utf-8")
        return text, tomllib.loads(text)
    except ValueError as error:
        raise FormatError(f"{path}: expected TOML, {error}") from error


def summary_rows(summary: Mapping[str, Any]) -> list[Row]:
    """Return every value of a summary, by its path, except those in other sections."""
    kept = {name: value for name, value in summary.items() if name not in ELSEWHERE}
    return [Row(path.replace("_", " "), _shown(value), "") for path, value in flat(kept)]


def flat(values: Mapping[str, Any], path: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the values of nested tables by their paths; empty tables are left out."""
    for name, value in values.items():
        if isinstance(value, dict):
            yield from flat(value, f"{path}{name}: ")
        else:
            yield f"{path}{name}", value


def object_rows(run: Playback) -> tuple[list[str], list[list[str]]]:
    """Header and rows of the table of objects: one row per ID, longest in sight first."""
    ways: dict[int, list[tuple[float, Any, float, float]]] = {}
    start = None
    for stamp_ns, objects in run.steps():
        start = stamp_ns if start is None else start
        spread = np.sqrt(np.maximum(np.trace(objects.covariance, axis1=1, axis2=2), 0.0))
        speed = np.linalg.norm(objects.velocity, axis=1)
        rows = zip(objects.id.tolist(), objects.position, speed, spread, strict=True)
        for name, position, fast, wide in rows:
            ways.setdefault(name, []).append(((stamp_ns - start) * 1e-9, position, fast, wide))
    heads = ["number", "first [s]", "last [s]", "times", "way [m]", "speed [m/s]", "sd [m]"]
    lines = []
    for name, way in sorted(ways.items(), key=lambda item: (-len(item[1]), item[0])):
        times, positions, speeds, spreads = zip(*way, strict=True)
        length = np.linalg.norm(np.diff(np.array(positions), axis=0), axis=1).sum()
        values = (times[0], times[-1]), (float(length), np.median(speeds), np.median(spreads))
        lines.append(
            [
                str(name),
                *(f"{value:.1f}" for value in values[0]),
                str(len(way)),
                *(f"{value:.2f}" for value in values[1][:2]),
                f"{values[1][2]:.2g}",  # 2 mm are not 0.00 m
            ]
        )
    return heads, lines


def timing_rows(folder: Path) -> list[Row]:
    """Rows of the times per stage of a run; empty if the run has no such table."""
    table = table_in(folder, "timing")
    if table is None:
        return []
    columns = read_columns(table)
    return [
        Row(
            name.removesuffix("_ms"),
            f"{np.median(values):.2f} ms",
            f"95 % below {np.quantile(values, 0.95):.2f}, longest {np.max(values):.2f}",
        )
        for name, values in columns.items()
        if name.endswith("_ms") and len(values)
    ]


def nis_rows(summary: Mapping[str, Any]) -> list[Row]:
    """Rows of the normalised innovations per sensor of `fuse`; empty for other runs."""
    found = summary.get("nis")
    if not isinstance(found, dict):
        return []
    return [
        Row(
            f"NIS {sensor}",
            number(of.get("mean"), 2),
            f"{100 * of['share_below_limit']:.0f} % below the limit of 95 %"
            if of.get("share_below_limit") is not None
            else "",
        )
        for sensor, of in found.items()
        if isinstance(of, dict)
    ]


def _shown(value: Any) -> str:
    if value is None:
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.{DIGITS}g}" if abs(value) < 10**DIGITS else f"{value:,.0f}"
    if isinstance(value, int):
        return f"{value:,}"
    if isinstance(value, list):
        return ", ".join(map(_shown, value)) or "none"
    return str(value)
