"""Items of the papers run again, and the files of each."""

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from lidar_core.io.files.atomic import written_whole
from lidar_core.reproduce import Item, Request, Result
from lidar_core.run_folder import command_line, note_of
from lidar_core.runs.result import OnProgress, draw
from lidar_core.viz.figure import write_figure

PARTS = "parts"
PICTURE = (11.0, 6.5)
"""Width and height of a picture [inch]."""


@dataclass(slots=True)
class ReproduceJob:
    """Runs items and writes ITEM.json, ITEM.toml and ITEM.png into `folder`."""

    folder: Path
    seed: int
    scans: int | None
    threads: int
    is_fresh: bool
    draws: bool
    files: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.folder.mkdir(parents=True, exist_ok=True)

    def run(self, item: Item, on_progress: OnProgress) -> Result:
        """Run one item."""
        scans, done = self.scans or item.scans, 0

        def advance(more: int) -> None:
            nonlocal done
            done += more
            on_progress(item.name, done, scans)

        on_progress(item.name, 0, scans)
        request = Request(
            seed=self.seed,
            scans=scans,
            threads=self.threads,
            parts=self.folder / PARTS,
            is_fresh=self.is_fresh,
            advance=advance,
        )
        return item.run(request)

    def write(self, item: Item, result: Result) -> tuple[dict[str, Any], list[str]]:
        """Write the files of one item; return its JSON, and a note if matplotlib is missing."""
        values = result.to_dict(item=item.name, seed=self.seed, command=command_line())
        self._write(f"{item.name}.json", json.dumps(values, indent=2) + "\n")
        inputs = {"item": item.name, "seed": self.seed, "scans": result.scans}
        self._write(f"{item.name}.toml", note_of(inputs, result.config))
        if self.draws:
            path = self.folder / f"{item.name}.png"
            names, notes = draw([(path, lambda _: write_figure(path, result.draw, size=PICTURE))])
            self.files += names
            return values, notes
        return values, []

    def _write(self, name: str, text: str) -> None:
        with written_whole(self.folder / name) as temporary:
            temporary.write_text(text, encoding="utf-8")
        self.files.append(name)
