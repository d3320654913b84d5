"""Items of `lidar-core reproduce`: their definition, their request and their results."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, NamedTuple, TypeAlias

from lidar_core.config import Config

Draw: TypeAlias = Callable[[Any], None]
"""Draws into an empty matplotlib Figure."""


class Row(NamedTuple):
    """Row of a table: one quantity with the paper's value and those of the modes; None if unknown.

    `paper_mode` is the algorithm as printed. `equations_corrected` is the same algorithm with
    corrections where its printed equations contradict each other; most items have no such column. A
    curve is one row per point: `recall@10m`.
    """

    name: str
    unit: str
    paper: float | None = None
    paper_mode: float | None = None
    best_mode: float | None = None
    equations_corrected: float | None = None

    def to_dict(self) -> dict[str, Any]:
        """Return the row as `--json` writes it: from the paper's value to the package's."""
        return {name: getattr(self, name) for name in ("name", "unit", *COLUMNS)}


COLUMNS = {
    "paper": "paper",
    "paper_mode": "paper mode",
    "equations_corrected": "equations corrected",
    "best_mode": "best mode",
}
"""Columns of numbers as `--json` calls them, and as a table does."""


@dataclass(frozen=True, slots=True)
class Request:
    """Options for the run of an item.

    Attributes
    ----------
    seed : int
        Seed of all random numbers, >= 0.
    scans : int
        Length of the run in the unit of the item, >= 1. An item may run slightly more or less:
        whole flights.
    threads : int
        Processes or threads to use, >= 1; the rows do not depend on it.
    parts : Path, optional
        Folder for finished parts of a long run, see `jobs.run`; None keeps none.
    is_fresh : bool
        Compute parts again even if they exist.
    advance : callable
        Called with the number of `scans` that were done since the last call.
    """

    seed: int
    scans: int
    threads: int
    parts: Path | None = None
    is_fresh: bool = False
    advance: Callable[[int], None] = lambda done: None


@dataclass(frozen=True, slots=True)
class Result:
    """Result of an item.

    Attributes
    ----------
    rows : tuple of Row
        The table.
    draw : callable
        Draws the picture into an empty matplotlib Figure.
    scans : int
        Number of scans that were really run.
    note : str
        Note for readers of the table.
    config : mapping
        Configurations in force, by name, for the note beside the results.
    """

    rows: tuple[Row, ...]
    draw: Draw
    scans: int
    note: str = ""
    config: Mapping[str, Config] = field(default_factory=dict)

    def to_dict(self, *, item: str, seed: int, command: str) -> dict[str, Any]:
        """Return the result as `--json` writes it."""
        rows = [row.to_dict() for row in self.rows]
        return {"item": item, "seed": seed, "command": command, "rows": rows}


@dataclass(frozen=True, slots=True)
class Measured:
    """Measurements of an item.

    Attributes
    ----------
    data : tuple
        Input of the rows: the arguments of `Item.rows`.
    scans, note, config
        See `Result`.
    drawn : tuple, optional
        Input of the picture: the arguments of `Item.draw` after the figure; None for the same as
        the rows.
    """

    data: tuple[Any, ...]
    scans: int
    note: str = ""
    config: Mapping[str, Config] = field(default_factory=dict)
    drawn: tuple[Any, ...] | None = None


@dataclass(frozen=True, slots=True)
class Item:
    """One table or figure.

    Attributes
    ----------
    name : str
        Name of the item on the command line.
    title : str
        Subject of the item in one line.
    scans : int
        Length of the full run.
    minutes : float
        Duration of the full run on two cores [min].
    measure : callable
        Function that does the work of a request.
    rows : callable
        Function that makes the table from the measurements.
    draw : callable
        Draws the measurements into an empty matplotlib Figure, its first argument.
    heading : str
        Above the picture; empty if `draw` writes its own.
    grid : {"both", "x", "y", ""}
        Grid lines behind the drawing: across both axes, one, or none.
    counts : str
        Unit that `scans` counts.
    data : tuple of str
        Recordings that it needs, see `recordings.recording`.
    """

    name: str
    title: str
    scans: int
    minutes: float
    measure: Callable[[Request], Measured]
    rows: Callable[..., Iterable[Row]]
    draw: Callable[..., None]
    heading: str = ""
    grid: Literal["both", "x", "y", ""] = "both"
    counts: str = "scans"
    data: tuple[str, ...] = ()

    def run(self, request: Request) -> Result:
        """Measure, and make the table; the picture is drawn on request."""
        found = self.measure(request)

        def draw(figure: Any) -> None:
            if self.heading:
                figure.suptitle(self.heading, x=0.06, ha="left", fontweight="bold")
            self.draw(figure, *(found.data if found.drawn is None else found.drawn))
            for axes in figure.axes if self.grid else ():
                axes.grid(visible=True, axis=self.grid)

        return Result(tuple(self.rows(*found.data)), draw, found.scans, found.note, found.config)

    def duration(self, scans: int) -> str:
        """Return how long `scans` take on two cores, in words."""
        seconds = self.minutes * 60 * scans / self.scans
        if seconds < 90:
            return f"{max(1, round(seconds))} s"
        return f"{seconds / 60:.0f} min" if seconds < 7200 else f"{seconds / 3600:.1f} h"
