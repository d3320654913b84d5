"""What `lidar-core reproduce` does for one item, and the files it leaves."""

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lidar_core.cli.common import progress_on
from lidar_core.errors import MissingExtraError
from lidar_core.io.files.atomic import written_whole
from lidar_core.reproduce import Item, Request, Result
from lidar_core.run_folder import command_line, note_of

if TYPE_CHECKING:
    from rich.console import Console

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

    def run(self, item: Item, console: "Console") -> Result:
        """Run one item, with a progress bar."""
        scans = self.scans or item.scans
        with progress_on(console, counts=item.counts) as progress:
            task = progress.add_task(item.name, total=scans)
            request = Request(
                seed=self.seed,
                scans=scans,
                threads=self.threads,
                parts=self.folder / PARTS,
                is_fresh=self.is_fresh,
                advance=lambda done: progress.advance(task, done),
            )
            return item.run(request)

    def write(self, item: Item, result: Result, console: "Console") -> dict[str, Any]:
        """Write the files of one item; return what its JSON holds."""
        values = result.to_dict(item=item.name, seed=self.seed, command=command_line())
        self._write(f"{item.name}.json", json.dumps(values, indent=2) + "\n")
        inputs = {"item": item.name, "seed": self.seed, "scans": result.scans}
        self._write(f"{item.name}.toml", note_of(inputs, result.config))
        if self.draws:
            from lidar_core.viz.figure import write_figure

            try:
                write_figure(self.folder / f"{item.name}.png", result.draw, size=PICTURE)
                self.files.append(f"{item.name}.png")
            except MissingExtraError as error:
                console.print(f"no picture: {error}", markup=False, soft_wrap=True)
        return values

    def _write(self, name: str, text: str) -> None:
        with written_whole(self.folder / name) as temporary:
            temporary.write_text(text, encoding="utf-8")
        self.files.append(name)
