"""Curves of a report over time, as SVG: errors, NIS, time per scan."""

import io
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_core.estimation import chi2_quantile
from lidar_core.evaluation import Estimates, Truth, pair
from lidar_core.evaluation.config import EvaluationConfig
from lidar_core.io.tables.columns import read_columns
from lidar_core.run_folder import table_in
from lidar_core.viz.drawing.marks import colours_of
from lidar_core.viz.figure import figure_with_style

SIZE, DPI = (9.5, 2.6), 90
SHARE = 0.95
GAP = 2.5
"""A curve is interrupted if two values are more than this number of usual time steps apart."""
MOST_DRAWN = 5000
"""Largest number of values of one chart that are drawn as lines; more become one small picture."""
MOST_TARGETS = 20
"""Largest number of curves of one chart: more cannot be distinguished."""


def error_chart(
    tracks: Estimates, truth: Truth, start_ns: int, config: EvaluationConfig
) -> str | None:
    """Draw the distance between each target and its track as SVG; None if nothing was paired."""
    pairing = pair(tracks, truth, config=config)
    rows = pairing.found
    if not len(rows):
        return None
    ours = pairing.estimate_of[rows]
    away: NDArray[np.float64] = np.linalg.norm(tracks.position[ours] - truth.position[rows], axis=1)
    seconds = (truth.stamp_ns[rows] - start_ns) * 1e-9
    is_picture = len(rows) > MOST_DRAWN

    def draw(panel: Any) -> None:
        for number, colour in _coloured(np.unique(truth.id[rows]).tolist()).items():
            chosen = np.flatnonzero(truth.id[rows] == number)
            line = {"ms": 3, "lw": 1.0, "color": colour, "label": f"target {number}"}
            curve = _with_gaps(seconds[chosen], away[chosen])
            panel.plot(*curve, ".-", rasterized=is_picture, **line)
        panel.set(ylabel="position error [m]", ylim=(0, None))
        panel.legend(loc="upper right", ncols=4, fontsize=8)

    return _svg(draw)


def nis_chart(folder: Path, start_ns: int) -> str | None:
    """Draw the NIS of every measurement of `fuse` with its 95 % limit as SVG; None for others."""
    table = table_in(folder, "states")
    columns = {} if table is None else read_columns(table)
    if not {"t_ns", "sensor", "nis"} <= columns.keys():
        return None
    nis = np.asarray(columns["nis"], float)
    known = np.isfinite(nis)
    if not known.any():
        return None
    parts = [np.asarray(column, float) for name, column in columns.items() if _is_part(name)]
    degrees = np.isfinite(parts).sum(axis=0) if parts else np.zeros(len(nis), int)
    seconds = (columns["t_ns"] - start_ns) * 1e-9
    sensors = np.asarray(columns["sensor"]).astype(str)
    is_picture = len(nis) > MOST_DRAWN

    def draw(panel: Any) -> None:
        for sensor, colour in _coloured(np.unique(sensors[known]).tolist()).items():
            chosen = known & (sensors == sensor)
            dots = {"ms": 2.5, "color": colour, "label": sensor, "rasterized": is_picture}
            panel.plot(seconds[chosen], nis[chosen], ".", **dots)
            for count in np.unique(degrees[chosen & (degrees > 0)]).tolist():
                limit = float(chi2_quantile(SHARE, degrees=count))
                name = f"95 % limit, {count} values"
                panel.axhline(limit, color=colour, lw=1.0, ls="--", label=name)
        panel.set(ylabel="NIS", yscale="symlog", ylim=(0, None))
        panel.legend(loc="upper right", ncols=4, fontsize=8)

    return _svg(draw)


def timing_chart(folder: Path, start_ns: int) -> str | None:
    """Draw the time of every scan by stage as SVG; None if the run has no such table."""
    table = table_in(folder, "timing")
    columns: Mapping[str, NDArray[Any]] = {} if table is None else read_columns(table)
    stages = [name for name in columns if name.endswith("_ms") and name != "total_ms"]
    if not stages or not len(columns["t_ns"]):
        return None
    seconds = (columns["t_ns"] - start_ns) * 1e-9
    is_picture = len(seconds) * len(stages) > MOST_DRAWN

    def draw(panel: Any) -> None:
        named = _coloured([name.removesuffix("_ms") for name in stages])
        panel.stackplot(
            seconds,
            [columns[name] for name in stages],
            labels=list(named),
            colors=list(named.values()),
            alpha=0.85,
            lw=0,
            rasterized=is_picture,
        )
        panel.set(ylabel="time per scan [ms]", ylim=(0, None))
        panel.legend(loc="upper right", ncols=6, fontsize=8)

    return _svg(draw)


def _with_gaps(
    seconds: NDArray[np.floating[Any]], values: NDArray[np.float64]
) -> tuple[NDArray[np.floating[Any]], NDArray[np.float64]]:
    """Return the curve with NaN where values are missing, so that no line crosses the gap."""
    steps = np.diff(seconds)
    gaps = np.flatnonzero(steps > GAP * np.median(steps)) + 1 if len(steps) else np.empty(0, int)
    return np.insert(seconds, gaps, np.nan), np.insert(values, gaps, np.nan)


def _is_part(name: str) -> bool:
    """Return whether a column holds one component of the innovations."""
    return re.fullmatch(r"innovation_\d+", name) is not None


def _coloured(names: list[Any]) -> dict[Any, str]:
    return colours_of(names[:MOST_TARGETS])


def _svg(draw: Callable[[Any], None]) -> str:
    """Return the panel that `draw` fills as an SVG element."""
    with figure_with_style(size=SIZE, dpi=DPI) as figure:
        figure.set_layout_engine("constrained")
        panel = figure.add_subplot()
        draw(panel)
        panel.set_xlabel("time [s]")
        panel.grid(visible=True)
        text = io.StringIO()
        figure.savefig(text, format="svg", metadata={"Date": None, "Creator": None})
    svg = text.getvalue()
    return svg[svg.index("<svg") :]
