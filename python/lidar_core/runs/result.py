"""Result of a run: its folder, its summary, its files, and the cause of an early end."""

from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from lidar_core.errors import FormatError, LidarCoreError, MissingExtraError
from lidar_core.extras import require
from lidar_core.io.options import NS

MCAP = "run.mcap"
OnProgress: TypeAlias = Callable[[str, int, int | None], None]
"""Is called with what is done, how much of it, and of how much, where that is known."""
Picture: TypeAlias = tuple[Path, Callable[[OnProgress], object]]
"""A file, and what draws it."""


@dataclass(frozen=True, slots=True)
class RunResult:
    """Result of a run.

    Attributes
    ----------
    folder : Path or None
        Folder that was written; None for a live run without one.
    summary : dict
        Plain values, as in summary.json.
    files : tuple of str
        Names of the files in the folder, sorted.
    notes : tuple of str
        Warnings, and files that could not be written because an extra is missing.
    ended_by : KeyboardInterrupt, LidarCoreError or OSError, optional
        Cause of an early end; the files hold the scans up to there.
    """

    folder: Path | None
    summary: dict[str, Any] = field(repr=False)
    files: tuple[str, ...]
    notes: tuple[str, ...] = ()
    ended_by: KeyboardInterrupt | LidarCoreError | OSError | None = None

    def raise_if_failed(self) -> None:
        """Raise the cause of an early end, or an error if most scans were rejected.

        Raises
        ------
        FormatError
            More than half of the scans were rejected.
        KeyboardInterrupt, LidarCoreError, OSError
            `ended_by`.
        """
        if self.ended_by is not None:
            raise self.ended_by
        scans = self.summary.get("scans", {})
        rejected = Counter(scans.get("rejected", {}))
        posed = scans.get("received", 0) - sum(self.summary.get("without_pose", {}).values())
        if 2 * rejected.total() > posed:
            raise FormatError(
                f"{rejected.total()} of {posed} scans were rejected, most of them:"
                f" {rejected.most_common(1)[0][0]}; the files hold the others"
            )


def count_unposed(summary: dict[str, Any]) -> None:
    """Count the scans without a pose as received, too: the pipeline never sees them."""
    summary["scans"]["received"] += sum(summary.get("without_pose", {}).values())


def wants_mcap(mcap: bool | None) -> bool:
    """Return whether run.mcap is written; `mcap` None: if the package for it is installed.

    Raises
    ------
    MissingExtraError
        `mcap` is true, and the package is not installed.
    """
    if mcap:
        require("foxglove", extra="viz", purpose="writing MCAP")
    return find_spec("foxglove") is not None if mcap is None else mcap


def no_mcap_of(stamps: NDArray[np.int64]) -> str | None:
    """Return why results at these times [ns] cannot be written to run.mcap; None if they can."""
    first = int(stamps.min(initial=0))
    if first >= 0:
        return None
    return f"no {MCAP}: MCAP holds no times below 0, and the first is {first / NS:g} s"


def no_progress(what: str, done: int, total: int | None) -> None:
    """Ignore the progress of a run."""


def draw(
    pictures: Iterable[Picture], on_progress: OnProgress = no_progress
) -> tuple[list[str], list[str]]:
    """Draw pictures and films; return names of those drawn, and a note if matplotlib is missing."""
    names: list[str] = []
    try:
        for path, paint in pictures:
            paint(on_progress)
            names.append(path.name)
    except MissingExtraError as error:
        return names, [f"no picture: {error}"]
    return names, []
