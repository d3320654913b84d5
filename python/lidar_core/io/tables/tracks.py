"""Tracks in tables and trajectory files."""

from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_core.io.files.atomic import written_whole
from lidar_core.io.tables.covariance import covariance_titles, upper_triangle
from lidar_core.io.tables.long_table import write_long_table
from lidar_core.messages import TrackKind
from lidar_core.objects import Tracks

STATE = ("x", "y", "z", "vx", "vy", "vz")
KIND_PROBABILITIES = tuple(f"p_{kind.name.lower()}" for kind in TrackKind)
"""Columns of the probabilities of kinds, in every table of tracks that has them."""
COLUMNS: dict[str, type] = {
    "t_ns": int,
    "track_id": int,
    "frame_id": str,
    **dict.fromkeys(STATE, float),
    "extent_x": float,
    "extent_y": float,
    "extent_z": float,
    "n_detections": int,
    "age": float,
    "existence": float,
    "kind": str,
    **dict.fromkeys(KIND_PROBABILITIES, float),
    **dict.fromkeys(covariance_titles(STATE), float),
}
"""Columns of the tracks table: SI units; covariance is of position and velocity."""


def write_tracks_table(
    path: str | Path, tracks: Iterable[Tracks], *, frame_id: str = "world"
) -> Path:
    """Write tracks as one long table, a row per track and time atomically.

    Parameters
    ----------
    path : str or Path
        Parquet, if it ends in .parquet and pyarrow is installed; otherwise CSV, ending in .csv.
    tracks : iterable of Tracks
        Tracks at successive times.
    frame_id : str
        Frame of the states.

    Returns
    -------
    path : Path
        File that was written.
    """
    return write_long_table(path, COLUMNS, _rows(tracks, frame_id))


def write_tum(folder: str | Path, tracks: Iterable[Tracks]) -> list[Path]:
    """Write one TUM trajectory (t x y z qx qy qz qw) per track into `folder`.

    Parameters
    ----------
    folder : str or Path
        Made if missing; files are named track_ID.txt.
    tracks : iterable of Tracks
        Tracks at successive times.

    Returns
    -------
    paths : list of Path
        Files that were written, in the order of the numbers of the tracks.

    Notes
    -----
    Times are in seconds, positions in metres in the frame of the tracks. The orientation is always
    the identity, 0 0 0 1.
    """
    return write_trajectories(folder, ((step.stamp_ns, step.id, step.position) for step in tracks))


def write_trajectories(
    folder: str | Path,
    steps: Iterable[tuple[int, NDArray[np.int64], NDArray[np.float64]]],
) -> list[Path]:
    """Write files track_ID.txt, from (stamp [ns], numbers (T,), positions (T, 3)) at each time."""
    lines: dict[int, list[str]] = defaultdict(list)
    for stamp_ns, numbers, positions in steps:
        seconds, nanoseconds = divmod(int(stamp_ns), 1_000_000_000)
        for number, position in zip(numbers.tolist(), positions.tolist(), strict=True):
            x, y, z = (f"{value:.6f}" for value in position)
            lines[number].append(f"{seconds}.{nanoseconds:09d} {x} {y} {z} 0 0 0 1\n")
    place = Path(folder)
    place.mkdir(parents=True, exist_ok=True)
    paths = []
    for number, text in sorted(lines.items()):
        path = place / f"track_{number}.txt"
        with written_whole(path) as temporary:
            temporary.write_text("".join(text), encoding="utf-8")
        paths.append(path)
    return paths


def _rows(tracks: Iterable[Tracks], frame_id: str) -> Iterator[Sequence[Any]]:
    for state in tracks:
        covariance = upper_triangle(state.covariance, len(STATE)).tolist()
        numbers = state.id.tolist()
        for row, number in enumerate(numbers):
            yield (
                int(state.stamp_ns),
                number,
                frame_id,
                *state.position[row].tolist(),
                *state.velocity[row].tolist(),
                *state.extent[row].tolist(),
                int(state.n_detections[row]),
                float(state.age[row]),
                float(state.existence[row]),
                TrackKind(state.kind[row]).name.lower(),
                *state.kind_probability[row].tolist(),
                *covariance[row],
            )
