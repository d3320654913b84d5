"""The page of a report: sections, the 3-D view, and a policy that forbids every request."""

from base64 import b64encode
from collections.abc import Sequence
from dataclasses import dataclass
from hashlib import sha256
from html import escape
from importlib.resources import files
from json import dumps
from os import PathLike
from pathlib import Path
from string import Template
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_core._core import __version__
from lidar_core.config import checked
from lidar_core.evaluation import EvaluationConfig, evaluate, read_prediction, read_truth
from lidar_core.evaluation.score_rows import all_rows, consistency_warnings, counted_caption
from lidar_core.evaluation.types import Truth
from lidar_core.files import read_whole
from lidar_core.io.files.atomic import check_place, written_whole
from lidar_core.run_folder import table_in
from lidar_core.util.rows import Row
from lidar_core.viz.playback import Playback
from lidar_core.viz.playback_picture import draw_moment
from lidar_core.viz.report.charts import error_chart, nis_chart, timing_chart
from lidar_core.viz.report.scene import map_note, scene_of
from lidar_core.viz.report.tables import (
    MOST_OBJECTS,
    nis_rows,
    object_rows,
    read_note,
    read_summary,
    summary_rows,
    timing_rows,
)

NAME = "report.html"
DOCTYPE = b"<!doctype html>"


@checked
def write_report(
    run: str | PathLike[str],
    output: str | PathLike[str] | None = None,
    *,
    truth: str | PathLike[str] | None = None,
) -> Path:
    """Write everything about a run into one HTML file.

    The page holds the warnings, a 3-D view with a time slider, the pictures, the objects, the
    errors where the truth is known, NEES and NIS, times per stage, and the configuration. It needs
    no network: its Content-Security-Policy forbids all requests.

    Parameters
    ----------
    run : str or Path
        Folder that `detect`, `circles`, `fuse` or `demo` wrote.
    output : str or Path, optional
        File to write atomically; without it report.html in the folder.
    truth : str or Path, optional
        Ground truth, as `lidar_core.evaluation.read_truth` takes it; without it that of the
        folder, if there is one.

    Returns
    -------
    path : Path

    Raises
    ------
    ConfigError
        An argument of another type.
    FileNotFoundError
        No such folder.
    FileExistsError
        `output` is a file that is no report.
    FormatError
        The folder is no run of these commands, or one of its files cannot be read.
    MissingExtraError
        matplotlib is not installed.
    """
    played = Playback(Path(run))
    folder = played.folder
    place = folder / NAME if output is None else Path(output)
    _check_replaceable(place)
    summary, (note, made_by) = read_summary(folder), read_note(folder)
    first = next(iter(played.steps()), None)
    if first is None:
        raise played.nothing_to("report")
    start_ns = first[0]
    held_against = _held_against(folder, truth)
    told = [*_texts(summary.get("warnings")), *_texts(summary.get("notes"))]
    known = {} if held_against is None else held_against.ways(start_ns)
    has_known_map = bool(made_by.get("input", {}).get("map"))
    scene = scene_of(played, known, start_ns=start_ns, has_known_map=has_known_map)
    sections = [_view_section(map_note(scene)), _picture_section(played)]
    if held_against is not None:
        warnings, section = held_against.section(start_ns)
        told += [text for text in warnings if text not in told]
        sections.append(section)
    sections += [
        _objects_section(played),
        _nis_section(folder, summary, start_ns),
        _timing_section(folder, start_ns),
        _table_section("Summary", summary_rows(summary)),
        _note_section(note),
    ]
    page = _page(
        title=f"{folder.resolve().name}: {played.capability}",
        command=str(made_by.get("command", "")),
        warnings=told,
        sections=sections,
        scene=scene,
    )
    place.parent.mkdir(parents=True, exist_ok=True)
    with written_whole(place) as temporary:
        temporary.write_text(page, encoding="utf-8")
    return place


def _check_replaceable(place: Path) -> None:
    """Refuse, before any work, to replace a file that is no report."""
    if place.exists():
        check_place(place)
        with place.open("rb") as file:
            if file.read(len(DOCTYPE)) != DOCTYPE:
                raise FileExistsError(f"{place}: exists and is no report; name another file")


@dataclass(frozen=True, slots=True)
class _Section:
    """Section of the page: headline and body as HTML; it is left out if the body is empty."""

    title: str
    body: str


@dataclass(frozen=True, slots=True)
class _HeldAgainst:
    """Run together with its ground truth and the configuration of the evaluation."""

    folder: Path
    truth: Truth
    config: EvaluationConfig

    def section(self, start_ns: int) -> tuple[list[str], _Section]:
        """Return warnings, and the section with the scores and the chart of errors."""
        predicted = read_prediction(self.folder)
        report = evaluate(
            self.truth,
            tracks=predicted.tracks,
            detections=predicted.detections,
            config=self.config,
        )
        chart = error_chart(predicted.tracks, self.truth, start_ns, self.config)
        caption = f"<p>{escape(counted_caption(self.config))}</p>"
        body = (chart or "") + _rows_table(all_rows(report)) + caption
        return [*consistency_warnings(report), *report.warnings], _Section("Errors", body)

    def ways(self, start_ns: int) -> dict[int, NDArray[np.float64]]:
        """Return times [s] and positions [m] of every target, shape (S, 4)."""
        seconds = (self.truth.stamp_ns - start_ns) * 1e-9
        table = np.column_stack([seconds, self.truth.position])
        return {
            number: table[self.truth.id == number] for number in np.unique(self.truth.id).tolist()
        }


def _held_against(folder: Path, truth: str | PathLike[str] | None) -> _HeldAgainst | None:
    """Return the run with the given truth, else with that of its folder; None without truth."""
    place = Path(truth) if truth is not None else table_in(folder, "truth")
    if place is None:
        return None
    predicted = read_prediction(folder)
    burn_in = predicted.burn_in_scans
    config = EvaluationConfig() if burn_in is None else EvaluationConfig(burn_in_scans=burn_in)
    targets = read_truth(place, config=config, is_planar=predicted.is_planar, run=predicted)
    return _HeldAgainst(folder, targets, config)


def _view_section(note: str) -> _Section:
    told = f'<p class="note">{escape(note)}</p>' if note else ""
    return _Section("View", _resource("view.html") + told)


def _picture_section(run: Playback) -> _Section:
    """Section with picture.png of the run, else its last scan; empty if it kept neither."""
    path = run.folder / "picture.png"
    if not path.is_file() and not run.times():
        return _Section("Picture", "")
    if path.is_file():
        data = read_whole(path)
    else:
        with TemporaryDirectory(prefix="lidar-core-report-") as folder:
            data = draw_moment(run, Path(folder) / "last.png").read_bytes()
    source = f"data:image/png;base64,{b64encode(data).decode('ascii')}"
    return _Section("Picture", f'<img alt="Picture of the whole run" src="{source}">')


def _objects_section(run: Playback) -> _Section:
    heads, lines = object_rows(run)
    if not lines:
        return _Section("Objects", "<p>None was found.</p>")
    more = len(lines) - MOST_OBJECTS
    caption = f"<p>{more} more, seen less often.</p>" if more > 0 else ""
    return _Section(f"Objects ({len(lines)})", _table(lines[:MOST_OBJECTS], heads=heads) + caption)


def _nis_section(folder: Path, summary: dict[str, Any], start_ns: int) -> _Section:
    chart = nis_chart(folder, start_ns)
    return _Section("Consistency", (chart or "") + _rows_table(nis_rows(summary)))


def _timing_section(folder: Path, start_ns: int) -> _Section:
    chart = timing_chart(folder, start_ns)
    return _Section("Time per scan", (chart or "") + _rows_table(timing_rows(folder)))


def _table_section(title: str, rows: Sequence[Row]) -> _Section:
    return _Section(title, _rows_table(rows))


def _note_section(note: str) -> _Section:
    text = f"<details><summary>run.toml</summary><pre>{escape(note)}</pre></details>"
    return _Section("Configuration and versions", text)


def _rows_table(rows: Sequence[Row | None]) -> str:
    """HTML of one table from its rows; None begins the next group."""
    return _table([[""] if row is None else list(row) for row in rows])


def _table(lines: Sequence[Sequence[str]], *, heads: Sequence[str] = ()) -> str:
    if not lines:
        return ""
    head = f"<tr>{''.join(f'<th>{escape(one)}</th>' for one in heads)}</tr>" if heads else ""
    body = "".join(
        f"<tr>{''.join(f'<td>{escape(one)}</td>' for one in line)}</tr>" for line in lines
    )
    return f'<div class="wide"><table>{head}{body}</table></div>'


def _texts(values: Any) -> list[str]:
    return [str(value) for value in values] if isinstance(values, list) else []


def _page(
    *,
    title: str,
    command: str,
    warnings: Sequence[str],
    sections: Sequence[_Section],
    scene: dict[str, Any],
) -> str:
    """Return the whole page as HTML.

    Text is escaped. The policy permits only the scripts of this package, by their digest.
    """
    script = _resource("view.js")
    digest = b64encode(sha256(script.encode("utf-8")).digest()).decode("ascii")
    shown = [section for section in sections if section.body]
    told = "".join(f'<p class="warning">{escape(text)}</p>' for text in warnings)
    return Template(_resource("page.html")).substitute(
        digest=digest,
        title=escape(title),
        command=escape(command),
        version=escape(__version__),
        warnings=told or "<p>No warnings and no notes.</p>",
        sections="".join(
            f"<section><h2>{escape(section.title)}</h2>{section.body}</section>"
            for section in shown
        ),
        # A "<" in data could end the element: JSON has another way to write it.
        scene=dumps(scene, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c"),
        script=script,
    )


def _resource(name: str) -> str:
    return files(__package__).joinpath(name).read_text(encoding="utf-8")
