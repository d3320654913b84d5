"""Estimates and truth from files: run folders, simulated recordings, tables of tracks."""

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_core.config import as_config, toml_values
from lidar_core.errors import FormatError, InputError
from lidar_core.evaluation.bins import norms
from lidar_core.evaluation.config import EvaluationConfig
from lidar_core.evaluation.matching.interpolation import columns_at_scans, supposed_scans
from lidar_core.evaluation.matching.overlap import sides
from lidar_core.evaluation.matching.pairing import checked_estimates, checked_truth, rows_of
from lidar_core.evaluation.metrics.latency import Latency
from lidar_core.evaluation.types import Estimates, Truth
from lidar_core.files import read_whole
from lidar_core.io.tables.columns import Columns, at_row, read_columns, tables_of
from lidar_core.io.tables.covariance import covariance_titles, symmetric
from lidar_core.run_folder import RUN_FILE, table_in

RECORDINGS = (".mcap", ".npz")
AXES, RATES = ("x", "y", "z"), ("vx", "vy", "vz")


@dataclass(frozen=True, slots=True)
class Prediction:
    """Tracks and detections of a run.

    Attributes
    ----------
    tracks : Estimates
        Tracks of the run.
    detections : Estimates or None
        Detections of the run, if they are known.
    latency : Latency or None
        Time per scan, where it is known.
    burn_in_scans : int or None
        Number of scans at the start in which the run reports nothing, if it is known.
    is_planar : bool
        The tracks are elements of a circle map: in the plane, with radii.
    scan_ns : ndarray, shape (S,), int64, or None
        Times of all scans of the run [ns], increasing, if they are known.
    """

    tracks: Estimates
    detections: Estimates | None = None
    latency: Latency | None = None
    burn_in_scans: int | None = None
    is_planar: bool = False
    scan_ns: NDArray[np.int64] | None = None

    @property
    def has_heights(self) -> bool:
        """False if all tracks have the height zero, as those of `fuse` in the plane."""
        return not self.is_planar and (
            not len(self.tracks.position) or bool(self.tracks.position[:, 2].any())
        )


def read_prediction(path: str | Path) -> Prediction:
    """Read a run folder, or a table of tracks.

    Parameters
    ----------
    path : str or Path
        Folder that `lidar-core detect`, `circles`, `fuse` or `demo` wrote, or its table of tracks
        (for flying objects, the tracks of kind flying count), or another file for
        `lidar_core.io.read_columns` with columns t_ns, track_id, x, y, z and, if known, vx, vy, vz
        and the upper triangle of the covariance, cov_x_x to cov_vz_vz. Without z and vz and with
        radius it is the table of a circle map.

    Raises
    ------
    FormatError
        Something is missing or cannot be read; the text names the file and the column.
    """
    place = Path(path)
    if place in _tables_of_tracks(place.parent):
        place = place.parent  # what is known of the run counts, too: its burn-in, its kinds
    if not (place / RUN_FILE).is_file():
        return _of_table(place)
    table = next(iter(_tables_of_tracks(place)), None)
    detections, timing = table_in(place, "detections"), table_in(place, "timing")
    if table is None:
        raise FormatError(f"{place}: the run folder holds no table of tracks; run it again")
    found = _of_table(table, kind="flying")
    return replace(
        found,
        detections=None
        if detections is None
        else _estimates(detections, read_columns(detections), has_id=False),
        latency=None if timing is None else _latency(timing),
        burn_in_scans=0 if found.is_planar else _burn_in(place),
        scan_ns=_scan_times(place, found.tracks),
    )


def _scan_times(folder: Path, tracks: Estimates) -> NDArray[np.int64] | None:
    """Times of all scans of a run [ns], even empty ones; None if no table has them."""
    tables = (table_in(folder, name) for name in ("timing", "states"))
    for table in (one for one in tables if one is not None):
        columns = read_columns(table)
        # States of many targets have rows only where there are tracks.
        if "t_ns" in columns and "track_id" not in columns:
            return np.union1d(_integers(table, columns, "t_ns"), tracks.stamp_ns)
    return None


def _tables_of_tracks(folder: Path) -> list[Path]:
    """Tables of tracks in the folder of a run; an empty list for other folders."""
    if not (folder / RUN_FILE).is_file():
        return []
    found = (table_in(folder, name) for name in ("tracks", "circles"))
    return [table for table in found if table is not None]


def _of_table(place: Path, kind: str | None = None) -> Prediction:
    """Read the tracks of a table; of a table of flying objects only those of `kind`, if given."""
    columns = read_columns(place)
    many = len(set(columns.get("recording", np.empty(0)).tolist()))
    if many > 1:
        raise FormatError(f"{place}: tracks of {many} recordings; give the table of one")
    # Runs of one recording, such as those of a batch that varies a parameter.
    if "recording" in columns and place.is_dir() and len(tables := tables_of(place)) > 1:
        raise FormatError(f"{place}: {len(tables)} tables, such as {tables[0].name}; give one")
    if kind is not None and {"kind", "extent_z"} <= set(columns):
        chosen = columns["kind"] == kind
        columns = {name: column[chosen] for name, column in columns.items()}
    return Prediction(_estimates(place, columns, has_id=True), is_planar=_is_planar(columns))


def read_truth(
    path: str | Path,
    *,
    config: EvaluationConfig | None = None,
    is_planar: bool = False,
    run: Prediction | None = None,
) -> Truth:
    """Read the targets of a recording, and select those that are required to be found.

    A target has to be found after the burn-in, within `max_distance` where the file has the
    columns sensor_x, sensor_y, sensor_z, and with `min_hits` points where it has the column hits.

    Parameters
    ----------
    path : str or Path
        NAME.truth.csv of `lidar-core simulate`, or the recording beside it; a folder of `lidar-core
        demo`; or a file for `lidar_core.io.read_columns` with columns t_ns, target_id or track_id,
        x, y, z and, if known, vx, vy, vz. Without z and with radius it is a truth in the plane.
    config : EvaluationConfig, optional
        `max_distance`, `min_hits`, `burn_in_scans`.
    is_planar : bool
        Leave out heights, because the estimates have none.
    run : Prediction, optional
        Run to compare. If the truth has other times than its scans and is not sparser, its
        values are interpolated to the times of the scans (`Truth.is_interpolated`). Targets before
        its first and after its last scan are left out, if its scans are known and some targets are
        between them (`Truth.n_before`, `n_after`). If all its heights are zero, the truth needs no
        z.

    Raises
    ------
    FormatError
        Something is missing or cannot be read; the text names the file and the column.
    """
    config = as_config(config, EvaluationConfig)
    place = _truth_file(Path(path))
    columns = read_columns(place)
    is_planar = is_planar or _is_planar(columns)
    if is_planar or _needs_no_heights(place, columns, run):
        columns = _flat(columns)
    _rows(place, columns, AXES)
    scans = None if run is None else run.scan_ns
    side = sides(_integers(place, columns, "t_ns"), scans, config.time_tolerance)
    columns, is_interpolated, scan_ns = _at_scans(place, columns, run, config)
    if is_interpolated is None:  # else it is at the scans alone
        columns = {name: column[side == 0] for name, column in columns.items()}
    stamps, numbers = _integers(place, columns, "t_ns"), _integers(place, columns, _id_in(columns))
    position, velocity = _rows(place, columns, AXES), _rows_if_known(place, columns, RATES)
    sensor = _rows_if_known(place, columns, tuple(f"sensor_{axis}" for axis in AXES))
    radius = None
    if is_planar and "radius" in columns:
        radius = _floats(place, columns, "radius")
    counts = _after_burn_in(stamps, config.burn_in_scans, scan_ns)
    if "hits" in columns:
        counts &= _integers(place, columns, "hits") >= config.min_hits
    if sensor is not None:
        counts &= norms(position - sensor) <= config.max_distance
    beyond = int((side < 0).sum()), int((side > 0).sum())
    table = Truth(
        stamps, numbers, position, counts, velocity, sensor, radius, is_interpolated, *beyond
    )
    try:
        return checked_truth(table)
    except InputError as error:
        raise FormatError(f"{place}: {error}") from error


def _id_in(columns: Columns) -> str:
    return "target_id" if "target_id" in columns else "track_id"


def _needs_no_heights(place: Path, columns: Columns, run: Prediction | None) -> bool:
    """Return whether the truth lacks z as the planar run does; a run with heights needs z."""
    if run is None or not {"x", "y"} <= set(columns) or "z" in columns:
        return False
    if run.has_heights:
        raise FormatError(f"{place}: no column z: add z; only a run in the plane needs none")
    return True


def _at_scans(
    place: Path, columns: Columns, run: Prediction | None, config: EvaluationConfig
) -> tuple[Columns, NDArray[np.bool_] | None, NDArray[np.int64] | None]:
    """Return the truth at the times of the scans, which rows are interpolated, and these times.

    The last two are None if the truth is used at its own times.
    """
    if run is None:
        return columns, None, None
    name = _id_in(columns)
    columns = columns | {key: _integers(place, columns, key) for key in ("t_ns", name)}
    scan_ns = run.scan_ns
    if scan_ns is None:
        scan_ns = supposed_scans(run.tracks.stamp_ns, columns["t_ns"])
    found = columns_at_scans(
        columns,
        name,
        scan_ns,
        track_ns=run.tracks.stamp_ns,
        tolerance=config.time_tolerance,
    )
    return (columns, None, None) if found is None else (*found, scan_ns)


def _truth_file(place: Path) -> Path:
    """Find the table of the truth: the file itself, beside a recording, or in a run folder."""
    if (place / RUN_FILE).is_file():
        table = table_in(place, "truth")
        if table is None:
            raise FormatError(
                f"{place}: the run folder holds no truth; give NAME.truth.csv of the simulation;"
                " the run itself is the first argument, the truth the second"
            )
        return table
    beside = place.with_suffix(".truth.csv")
    return beside if place.suffix in RECORDINGS and beside.is_file() else place


def _estimates(place: Path, columns: Columns, *, has_id: bool) -> Estimates:
    is_planar = _is_planar(columns)
    if is_planar:
        columns = _flat(columns)
    if has_id and "track_id" not in columns and "target_id" in columns:
        raise FormatError(
            f"{place}: target_id instead of track_id: this is a table of true targets; the first"
            " argument is the run or its tracks, the second the truth: exchange them"
        )
    stamps, position = _integers(place, columns, "t_ns"), _rows(place, columns, AXES)
    numbers = _integers(place, columns, "track_id") if has_id else None
    velocity = _rows_if_known(place, columns, RATES)
    # Targets in a plane may have heights, but none in their covariances.
    spans = [(*AXES[:2], *RATES[:2]), AXES[:2]]
    if not is_planar:
        spans = [(*AXES, *RATES), AXES, *spans]
    known = (_covariance(place, columns, names) for names in spans)
    covariance = next((one for one in known if one is not None), None)
    radius = _numbers(place, columns, "radius") if is_planar else None
    # Tracks are states at the time of the scan, detections are measured during it.
    is_timed = not has_id and "time_ns" in columns
    times = _integers(place, columns, "time_ns") if is_timed else None
    table = Estimates(stamps, position, numbers, velocity, covariance, times, radius)
    try:
        return checked_estimates(_last_rows(table))
    except InputError as error:
        raise FormatError(f"{place}: {error}") from error


def _is_planar(columns: Columns) -> bool:
    return "z" not in columns and "radius" in columns


def _flat(columns: Columns) -> Columns:
    """Return the columns with all heights zero."""
    zero = np.zeros(len(next(iter(columns.values()), [])))
    heights = {"z": zero, "vz": zero} | ({"sensor_z": zero} if "sensor_x" in columns else {})
    return columns | heights


def _last_rows(table: Estimates) -> Estimates:
    """Return the table with only the last row of each track and time."""
    if table.id is None:
        return table
    last = {key: row for row, key in enumerate(zip(table.stamp_ns, table.id, strict=True))}
    kept = np.array(sorted(last.values()), np.int64)
    return table if len(kept) == len(table.id) else rows_of(table, kept)


def _covariance(
    place: Path, columns: Columns, names: tuple[str, ...]
) -> NDArray[np.float64] | None:
    """Read symmetric matrices from the columns of their upper triangle; None if one is missing."""
    titles = covariance_titles(names)
    if any(title not in columns for title in titles):
        return None
    values = np.stack([_numbers(place, columns, title) for title in titles], axis=1)
    matrices = symmetric(values, len(names))
    smallest = np.linalg.eigvalsh(matrices)[:, 0]
    if (smallest <= 0).any():
        row = int(np.argmax(smallest <= 0))
        raise FormatError(
            f"{at_row(place, row)}: its covariance is not positive definite; without the columns"
            " cov_* the table is scored without NEES"
        )
    return matrices


def _latency(place: Path) -> Latency | None:
    columns = read_columns(place)
    stages = {
        name.removesuffix("_ms"): _numbers(place, columns, name)
        for name in columns
        if name.endswith("_ms") and name != "total_ms"
    }
    return Latency.of(_numbers(place, columns, "total_ms"), stages)


def _burn_in(place: Path) -> int | None:
    """Number of burn-in scans that the run counted, else the configured one; None if unknown."""
    run_file, summary = place / RUN_FILE, place / "summary.json"
    try:
        gate = json.loads(read_whole(summary))["gate"] if summary.is_file() else {}
        if "burn_in_scans" in gate:
            return int(gate["burn_in_scans"])
        note = toml_values(read_whole(run_file), run_file)
        return int(note["config"]["flying"]["seed"]["burn_in_scans"])
    except (ValueError, OverflowError) as error:
        raise FormatError(f"{run_file}: cannot be read: {error}") from error
    except (KeyError, TypeError):
        return None


def _after_burn_in(
    stamps: NDArray[np.int64], scans: int, scan_ns: NDArray[np.int64] | None
) -> NDArray[np.bool_]:
    """Return which `stamps` are after the first `scans` of `scan_ns`, or of `stamps` if None."""
    when = np.unique(stamps) if scan_ns is None else scan_ns
    after: NDArray[np.bool_] = np.searchsorted(when, stamps) >= scans
    return after


def _rows(place: Path, columns: Columns, names: tuple[str, ...]) -> NDArray[np.float64]:
    return np.stack([_numbers(place, columns, name) for name in names], axis=1)


def _rows_if_known(
    place: Path, columns: Columns, names: tuple[str, ...]
) -> NDArray[np.float64] | None:
    return _rows(place, columns, names) if set(names) <= set(columns) else None


def _numbers(place: Path, columns: Columns, name: str) -> NDArray[np.float64]:
    column = _floats(place, columns, name)
    if not np.isfinite(column).all():
        raise FormatError(f"{place}: column {name}: expected finite numbers")
    return column


def _floats(place: Path, columns: Columns, name: str) -> NDArray[np.float64]:
    column = _column(place, columns, name)
    if column.dtype.kind not in "fiu":
        raise FormatError(f"{place}: column {name}: expected numbers, got text")
    return column.astype(np.float64)


def _integers(place: Path, columns: Columns, name: str) -> NDArray[np.int64]:
    column = _column(place, columns, name)
    if column.dtype.kind not in "iu":
        raise FormatError(f"{place}: column {name}: expected integers, got {column.dtype}")
    if column.dtype == np.uint64 and (column > np.iinfo(np.int64).max).any():
        raise FormatError(f"{place}: column {name}: expected integers below 2^63")
    return column.astype(np.int64)


def _column(place: Path, columns: Columns, name: str) -> NDArray[Any]:
    if name not in columns:
        raise FormatError(
            f"{place}: no column {name} among {', '.join(columns) or 'none'}; expected t_ns,"
            " track_id or target_id, x, y, z and, if known, vx, vy, vz"
        )
    return columns[name]
