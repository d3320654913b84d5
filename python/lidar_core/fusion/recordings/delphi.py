"""Reader of the object lists of Delphi's ESR radar, as CSV."""

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lidar_core.errors import FormatError
from lidar_core.fusion.measurement import Measurement
from lidar_core.fusion.recordings.autoferry import DetectionScan
from lidar_core.fusion.recordings.columns.cells import numbers_in
from lidar_core.fusion.recordings.folders import check_sizes, files_of, head_of
from lidar_core.io.tables.columns import at_row, read_columns

TIME, SLOT = "time_ns", "trackID"
VALUES = ("track_range_m", "track_angle_rad", "track_range_rate_m_per_s")
SOURCE = "radar"
STD = (0.25, 0.0087, 0.12)
"""Standard deviations of range [m], angle [rad] and range rate [m/s]: the lists state none.

Source: what a tracker of many targets measures beside what it expects, in a recording of a moving
car; medians, so that slots that pass to another object do not count.
"""
PAUSE_NS = 5_000_000
"""A longer pause between two rows is one between two scans."""


def is_delphi(path: str | Path) -> bool:
    """True if a file, or the first CSV file of a folder, has the columns of such lists."""
    head = head_of(_files(Path(path)))
    names = head.partition(b"\n")[0].decode("utf-8-sig", "replace")
    return VALUES[0] in [name.strip(' \r"') for name in re.split("[,;\t]", names)]


def read_delphi(path: str | Path) -> list[DetectionScan]:
    """Read the objects that an ESR radar tracked, scan by scan.

    Parameters
    ----------
    path : str or Path
        A CSV file, or a folder of them. A row is a slot of a scan: time_ns [ns], trackID,
        track_range_m [m], track_angle_rad [rad] and track_range_rate_m_per_s [m/s]; other columns
        are not read. Slots without an object have range 0.

    Returns
    -------
    scans : list of DetectionScan
        Scans by time, including empty ones: range, bearing and range rate in the frame of the
        radar, x ahead and y to the left; the radar itself counts angles to the right. All rows of a
        scan have the stamp of its first row.

    Raises
    ------
    FormatError
        The files have no such lists; the text names file, column and row.
    LimitError
        More than 256 MiB.

    Notes
    -----
    The radar reuses slots for other objects, so the number of a slot does not identify an object.
    The radar filters its objects already: their errors are correlated over time.
    """
    place = Path(path)
    files = _files(place)
    if not files:
        raise FormatError(f"{place}: expected a CSV file of objects, or a folder of them")
    check_sizes(place, files, what="object lists")
    rows = np.concatenate([_rows(file) for file in files])
    rows = rows[np.argsort(rows["stamp"], kind="stable")]
    return [_scan(rows[start:end]) for start, end in _bounds(rows)]


def _files(place: Path) -> list[Path]:
    """List the CSV files of a folder; a single file may have any ending."""
    return files_of(place, ".csv") if place.is_dir() else [place]


def _rows(place: Path) -> NDArray[np.void]:
    """Rows of one file: stamp, slot, range, angle, rate."""
    columns = read_columns(place)
    missing = [name for name in (TIME, SLOT, *VALUES) if name not in columns]
    if missing:
        raise FormatError(f"{place}: no column {missing[0]} among {', '.join(columns) or 'none'}")
    whole = columns[TIME]
    if not len(whole):
        raise FormatError(f"{place}: no rows in this file")
    if whole.dtype.kind != "i":
        # Float64 does not hold nanoseconds of today.
        bad = [row for row, text in enumerate(whole.tolist()) if not str(text).isdecimal()]
        row = bad[0] if bad else 0
        raise FormatError(
            f"{at_row(place, row)}: column {TIME}: expected whole nanoseconds, got {whole[row]}"
        )
    numbers = {name: numbers_in(place, columns, name) for name in (SLOT, *VALUES)}
    for name, column in numbers.items():
        wrong = ~np.isfinite(column)
        if wrong.any():
            row = int(np.argmax(wrong))
            raise FormatError(
                f"{at_row(place, row)}: column {name}: expected a number, got {columns[name][row]}"
            )
    made = np.zeros(len(whole), [("stamp", "i8"), ("slot", "f8"), ("values", "f8", 3)])
    made["stamp"], made["slot"] = whole, numbers[SLOT]
    made["values"] = np.stack([numbers[name] for name in VALUES], axis=1)
    return made


def _bounds(rows: NDArray[np.void]) -> Sequence[tuple[int, int]]:
    """Return the first row of every scan and the row after its last one.

    A scan ends at a pause, and before a slot that it already contains.
    """
    starts, slots = [0], {float(rows["slot"][0])}
    for row in range(1, len(rows)):
        slot = float(rows["slot"][row])
        if rows["stamp"][row] - rows["stamp"][row - 1] > PAUSE_NS or slot in slots:
            starts.append(row)
            slots = set()
        slots.add(slot)
    return list(zip(starts, [*starts[1:], len(rows)], strict=True))


def _scan(rows: NDArray[np.void]) -> DetectionScan:
    stamp = int(rows["stamp"][0])
    noise = np.diag(np.square(STD))
    found = [
        Measurement(stamp, "radar", [far, -angle, rate], noise)
        for far, angle, rate in rows["values"].tolist()
        if far > 0
    ]
    return DetectionScan(stamp, SOURCE, found, np.zeros(2), {})
