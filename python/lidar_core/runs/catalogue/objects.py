"""Objects of a run as rows that name their recording, and events: first sight, closest, lost."""

import tomllib
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from lidar_core.errors import FormatError
from lidar_core.files import read_text
from lidar_core.io.tables.columns import Columns, read_columns
from lidar_core.io.tables.covariance import covariance_titles
from lidar_core.run_folder import RUN_FILE, table_in

_STATE = ("x", "y", "z", "vx", "vy", "vz")
_SIZE = ("extent_x", "extent_y", "extent_z")
_MEASURED = (*_STATE, "speed", "distance", *_SIZE, *covariance_titles(("x", "y", "z")))
OBJECTS: Final[dict[str, type]] = {
    "recording": str,
    "run": str,
    "t_ns": int,
    "time": float,
    "track_id": int,
    "kind": str,
    "existence": float,
    **dict.fromkeys(_MEASURED, float),
}
"""Columns of the table of objects: SI units, world frame; NaN where a run does not know a value.

time is since the first scan of the run. distance from the sensor and kind, such as flying, are
those at that time; kind is empty where a run has no kinds.
"""
EVENTS: Final[dict[str, type]] = {
    "recording": str,
    "run": str,
    "track_id": int,
    "kind": str,
    "kind_then": str,
    "event": str,
    "t_ns": int,
    "time": float,
    **dict.fromkeys((*_STATE, "speed", "distance"), float),
    "duration": float,
    "rows": int,
}
"""Columns of the table of events. duration and rows are those of the whole track.

kind is that of the track where it ends, when most is known; kind_then is that at the event.
event is first_sight, closest_approach, or lost: the track ends before the run does.
"""


def has_objects(folder: str | Path) -> bool:
    """Return whether a folder is that of a run with tracks or circles."""
    place = Path(folder)
    return (place / RUN_FILE).is_file() and _table_of(place) is not None


def objects_of(folder: str | Path, *, recording: str | None = None, run: str = "") -> Columns:
    """Return all objects of a run at all times.

    Parameters
    ----------
    folder : str or Path
        Folder that `detect`, `circles`, `fuse` or `demo` wrote.
    recording : str, optional
        Name of the recording; without it that of run.toml.
    run : str
        Name of the run.

    Returns
    -------
    columns : dict of ndarray
        Columns with the names of `OBJECTS`.

    Raises
    ------
    FormatError
        No run of these commands.
    """
    place = Path(folder)
    table = _table_of(place)
    if table is None or not has_objects(place):
        raise FormatError(f"{place}: expected the folder of a run, with tracks or circles")
    columns = read_columns(table)
    count = len(columns["t_ns"])
    stamps = np.asarray(columns["t_ns"], np.int64)

    def of(name: str) -> NDArray[np.float64]:
        unknown = np.full(count, np.nan)
        return np.asarray(columns[name], np.float64) if name in columns else unknown

    state, sizes = {name: of(name) for name in _STATE}, {name: of(name) for name in _SIZE}
    if "radius" in columns:  # a map in the plane
        state |= {"z": np.zeros(count), "vz": np.zeros(count)}
        sizes |= {"extent_x": 2 * of("radius"), "extent_y": 2 * of("radius")}
    covariance = {name: of(name) for name in covariance_titles(("x", "y", "z"))}
    velocity = np.stack([state[name] for name in _STATE[3:]])
    position = np.stack([state[name] for name in _STATE[:3]], axis=1)
    first = int(min(stamps.min(initial=2**62), _scan_stamps(place).min(initial=2**62)))
    name = _recording_of(place) if recording is None else recording
    return {
        "recording": np.full(count, name),
        "run": np.full(count, run),
        "t_ns": stamps,
        "time": (stamps - first) * 1e-9,
        "track_id": np.asarray(columns["track_id"], np.int64),
        "kind": np.asarray(columns.get("kind", np.full(count, "")), np.str_),
        "existence": of("existence"),
        **state,
        "speed": np.sqrt(np.square(velocity).sum(axis=0)),
        "distance": _distances(place, stamps, position),
        **sizes,
        **covariance,
    }


def events_of(folder: str | Path, *, recording: str | None = None, run: str = "") -> Columns:
    """Return the events of the objects of a run: at most three rows per track.

    Parameters
    ----------
    folder : str or Path
        Folder that `detect`, `circles`, `fuse` or `demo` wrote.
    recording : str, optional
        Name of the recording; without it that of run.toml.
    run : str
        Name of the run.

    Returns
    -------
    columns : dict of ndarray
        Columns with the names of `EVENTS`, by track and time.

    Raises
    ------
    FormatError
        No run of these commands.
    """
    return objects_and_events(folder, recording=recording, run=run)[1]


def objects_and_events(
    folder: str | Path, *, recording: str | None = None, run: str = ""
) -> tuple[Columns, Columns]:
    """Return both tables of a run, which is read once: see `objects_of` and `events_of`."""
    objects = objects_of(folder, recording=recording, run=run)
    last = int(max(objects["t_ns"].max(initial=0), _scan_stamps(Path(folder)).max(initial=0)))
    kind = objects["kind"].copy()  # of each row, where its track ends
    chosen: list[tuple[int, str, float, int]] = []
    for number in np.unique(objects["track_id"]).tolist():
        rows = np.flatnonzero(objects["track_id"] == number)
        rows = rows[np.argsort(objects["t_ns"][rows], kind="stable")]
        kind[rows] = kind[rows[-1]]
        seconds = float(objects["time"][rows[-1]] - objects["time"][rows[0]])
        chosen.append((int(rows[0]), "first_sight", seconds, len(rows)))
        distance = objects["distance"][rows]
        if np.isfinite(distance).any():
            nearest = int(rows[np.nanargmin(distance)])
            chosen.append((nearest, "closest_approach", seconds, len(rows)))
        if objects["t_ns"][rows[-1]] < last:
            chosen.append((int(rows[-1]), "lost", seconds, len(rows)))
    picked = np.array([row for row, *_ in chosen], np.int64)
    told: dict[str, NDArray[Any]] = {
        "kind": kind[picked],
        "kind_then": objects["kind"][picked],
        "event": np.array([one[1] for one in chosen], np.str_),
        "duration": np.array([one[2] for one in chosen], np.float64),
        "rows": np.array([one[3] for one in chosen], np.int64),
    }
    events = {name: told[name] if name in told else objects[name][picked] for name in EVENTS}
    return objects, events


def _table_of(folder: Path) -> Path | None:
    return table_in(folder, "circles") or table_in(folder, "tracks")


def _recording_of(folder: Path) -> str:
    """Name of the recording in run.toml; that of the folder where the run read none."""
    note = tomllib.loads(read_text(folder / RUN_FILE)).get("input", {})
    read = note.get("recording", {})
    return str(read["path"]) if isinstance(read, dict) and "path" in read else folder.name


def _scan_stamps(folder: Path) -> NDArray[np.int64]:
    table = table_in(folder, "timing")
    empty = np.empty(0, np.int64)
    return empty if table is None else np.asarray(read_columns(table)["t_ns"], np.int64)


def _distances(
    folder: Path, stamps: NDArray[np.int64], position: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Distances of objects from the sensor [m]; NaN where the sensor's position is unknown.

    Of runs of `fuse` on one target they are known only if the sensor stands in the origin.
    """
    planar = np.nan_to_num(position)
    timing, states = table_in(folder, "timing"), table_in(folder, "states")
    if timing is not None:
        columns = read_columns(timing)
        if "sensor_x" not in columns or not len(columns["t_ns"]):
            return np.full(len(stamps), np.nan)
        sensor = np.stack([columns[f"sensor_{axis}"] for axis in "xyz"], axis=1)
        if table_in(folder, "circles") is not None:
            sensor[:, 2] = 0.0
        at = np.searchsorted(columns["t_ns"], stamps, side="right") - 1
        return np.asarray(np.linalg.norm(planar - sensor[np.maximum(at, 0)], axis=1))
    columns = {} if states is None else read_columns(states)
    if "sensor_x" in columns:  # of many targets: the tables have the same rows
        sensor = np.stack([columns[f"sensor_{axis}"] for axis in "xy"], axis=1)
        return np.asarray(np.linalg.norm(planar[:, :2] - sensor, axis=1))
    if "sensor" in columns and not np.isin(columns["sensor"], ["pose"]).any():
        return np.asarray(np.linalg.norm(planar, axis=1))
    return np.full(len(stamps), np.nan)
