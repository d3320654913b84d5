"""Reader of the Autoferry recordings: LiDAR and radar detections of boats, with the truth."""

import json
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from lidar_core.errors import FormatError, TruthWarning
from lidar_core.fusion.measurement import Measurement
from lidar_core.fusion.recordings.folders import check_sizes
from lidar_core.io.files.guard import reading
from lidar_core.io.options import NS
from lidar_core.util.steps import LONGEST_STEP_NS, between

DETECTIONS, TRUTH = "_detections.json", "_groundTruth.json"
SOURCES = {1: "lidar", 2: "radar"}
DELAYS = {"lidar": 0.6, "radar": 1.7}
"""How much later than their measurement entries are stamped [s]: detections of moving boats lie as
far behind the true places, along their way.

Source: scenarios 2 and 13, differences from the truth over the true velocity.
"""
MAX_TIME = 9e9
"""Largest time that int64 nanoseconds hold [s]."""
LIDAR_STD, RADAR_STD = 3.0, 5.0
"""Standard deviations of x and y [m]: the recordings state none.

Source: differences from the truth in scenarios 2 and 13, antennas and hulls included.
"""
RADAR_BEARING_STD = 0.02
"""Standard deviation of the radar's bearing, added across the line of sight [rad]; same source."""

Target: TypeAlias = tuple[int, int, NDArray[np.float64]]
"""Number, time [ns] and true place (east, north) of a target [m]."""
Way: TypeAlias = tuple[NDArray[np.int64], NDArray[np.float64]]
"""Times (K,) [ns] and places (K, 2) of a target."""


@dataclass(frozen=True, slots=True)
class DetectionScan:
    """Detections of one scanner at one time.

    Attributes
    ----------
    stamp_ns : int
        Time of the scan [ns].
    source : str
        "lidar" or "radar".
    measurements : list of Measurement
        Positions in the world, each with its covariance.
    sensor : ndarray, shape (2,)
        Position of the scanner [m].
    truth : mapping of int to ndarray, shape (2,)
        Positions of the targets [m]; targets without a known position are left out.
    """

    stamp_ns: int
    source: str
    measurements: list[Measurement]
    sensor: NDArray[np.float64]
    truth: Mapping[int, NDArray[np.float64]]


def read_autoferry(path: str | Path) -> list[DetectionScan]:
    """Read the LiDAR and radar scans of a scenario; x is east and y north of its origin.

    Parameters
    ----------
    path : str or Path
        NAME_detections.json; NAME_groundTruth.json is read where it lies beside it.

    Returns
    -------
    scans : list of DetectionScan
        Scans by time, including empty ones, with the time of measurement: the radar's entries are
        1.7 s late, the LiDAR's 0.6 s. Cameras are left out.

    Raises
    ------
    FormatError
        The file has another format; the text names the entry.
    LimitError
        More than 256 MiB.

    Warns
    -----
    TruthWarning
        A true place that is not finite, which is left out, or more than 2 s between two of a
        target, between which it is in no truth.

    Notes
    -----
    True positions are interpolated to the times of the scans, between places that are at most 2 s
    apart; before the first and after the last one a target is in no truth.

    Source: Helgesen et al., "Heterogeneous multi-sensor tracking for an autonomous surface
    vehicle in a littoral environment", Ocean Engineering 252, 2022.
    """
    place = Path(path)
    entries = _entries(place)
    beside = place.with_name(place.name.replace(DETECTIONS, TRUTH))
    truths = _entries(beside) if beside != place and beside.is_file() else [[]] * len(entries)
    if len(truths) != len(entries):
        raise FormatError(
            f"{beside}: expected {len(entries)} entries as {place.name} has, got {len(truths)}"
        )
    scans, targets = [], _targets(place, beside, entries, truths)
    ways = _ways(targets)
    for number, (entry, known) in enumerate(zip(entries, targets, strict=True)):
        at = f"{place}, entry {number}"
        with reading(at):
            if int(entry["sensorID"]) in SOURCES:
                own = {key: ways[key] for key, *_ in known if key in ways}
                scans.append(_scan(entry, own, at))
    scans.sort(key=lambda scan: scan.stamp_ns)
    for doubt in (_unknown_places(targets), _long_steps(ways, scans)):
        if doubt:
            warnings.warn(f"{beside}: {doubt}", TruthWarning, stacklevel=2)
    return scans


def _targets(
    place: Path, beside: Path, entries: Sequence[Any], truths: Sequence[Any]
) -> list[list[Target]]:
    """Targets of every entry; unknown positions are NaN."""
    found = []
    for number, (entry, truth) in enumerate(zip(entries, truths, strict=True)):
        if not isinstance(entry, dict):
            raise FormatError(f"{place}, entry {number}: expected an object")
        at = f"{beside}, entry {number}"
        with reading(at):
            rows = truth if isinstance(truth, list) else [truth]
            found.append([_target(one, entry.get("time"), at) for one in rows])
    return found


def _target(one: Mapping[str, Any], usual_time: object, place: str) -> Target:
    at = np.array(one["position"][1::-1], np.float64)  # north, east; null is NaN
    if at.shape != (2,):
        raise FormatError(f"{place}: expected a position, north and east, got {one['position']}")
    return int(one["targetID"]), _stamp_ns(one.get("time", usual_time), place), at


def _stamp_ns(time: Any, place: str) -> int:
    """Convert a time [s] into nanoseconds."""
    if not abs(float(time)) <= MAX_TIME:
        raise FormatError(f"{place}: expected a time in seconds, got {time}")
    return round(float(time) * NS)


def _ways(targets: Sequence[Sequence[Target]]) -> dict[int, Way]:
    """Return for every target the times [ns] and positions [m] that are known."""
    rows: dict[int, dict[int, NDArray[np.float64]]] = {}
    for number, stamp_ns, at in (one for known in targets for one in known):
        if np.isfinite(at).all():
            rows.setdefault(number, {})[stamp_ns] = at
    return {
        number: (np.array(sorted(own), np.int64), np.array([own[stamp] for stamp in sorted(own)]))
        for number, own in rows.items()
    }


def _place_at(way: Way, stamp_ns: int) -> NDArray[np.float64] | None:
    """Position of a target at a time [ns], by interpolation [m]; None if it is unknown."""
    stamps, places = way
    found, is_known = between(stamps, places, np.array([stamp_ns]), longest_ns=LONGEST_STEP_NS)
    return found[0] if is_known[0] else None


def _unknown_places(targets: Sequence[Sequence[Target]]) -> str | None:
    """Return a warning about true positions that are not finite; None without them."""
    bad = [
        (entry, number)
        for entry, known in enumerate(targets)
        for number, _, at in known
        if not np.isfinite(at).all()
    ]
    if not bad:
        return None
    entry, number = bad[0]
    return (
        f"entry {entry}: the true place of target {number} is not finite;"
        f" {len(bad)} such places are left out"
    )


def _long_steps(ways: Mapping[int, Way], scans: Sequence[DetectionScan]) -> str | None:
    """Return a warning about scans in times without true positions; None without them."""
    told = []
    seen = np.array([scan.stamp_ns for scan in scans], np.int64)
    start = int(seen.min()) if seen.size else 0
    for number, (stamps, _) in sorted(ways.items()):
        for row in np.flatnonzero(np.diff(stamps) > LONGEST_STEP_NS).tolist():
            first, last = stamps[row : row + 2].tolist()
            count = int(((seen > first) & (seen < last)).sum())
            if count:
                told.append(
                    f"target {number} has no true place for {(last - first) / NS:.3g} s,"
                    f" {(first - start) / NS:.1f} s after the start: {count} scans are without it"
                )
    return "; ".join(told[:3]) + (f"; and {len(told) - 3} more" if told[3:] else "") or None


def _entries(place: Path) -> list[Any]:
    check_sizes(place, [place], what="a file")
    with reading(str(place)):
        entries = json.loads(place.read_text("utf-8"))
    if not isinstance(entries, list):
        raise FormatError(f"{place}: expected a list of detections")
    return entries


def _scan(entry: Mapping[str, Any], ways: Mapping[int, Way], place: str) -> DetectionScan:
    source = SOURCES[int(entry["sensorID"])]
    stamp_ns = _stamp_ns(entry["time"], place) - round(DELAYS[source] * NS)
    sensor = np.array(entry["ownshipPosition"], np.float64)[1::-1]  # north, east
    offsets = np.array(entry["measurement"], np.float64).reshape(2, -1)[::-1].T
    if sensor.shape != (2,) or not (np.isfinite(sensor).all() and np.isfinite(offsets).all()):
        raise FormatError(f"{place}: expected finite positions, north and east")
    places = {number: _place_at(way, stamp_ns) for number, way in ways.items()}
    known = {number: at for number, at in places.items() if at is not None}
    measurements = [
        Measurement(
            stamp_ns,
            "lidar",
            sensor + offset,
            _covariance(offset, source),
            seen_from=sensor if source == "radar" else None,
        )
        for offset in offsets
    ]
    return DetectionScan(stamp_ns, source, measurements, sensor, known)


def _covariance(offset: NDArray[np.float64], source: str) -> NDArray[np.float64]:
    if source == "lidar":
        return np.eye(2) * LIDAR_STD**2
    across = np.array([-offset[1], offset[0]]) * RADAR_BEARING_STD  # as long as the range
    covariance: NDArray[np.float64] = np.eye(2) * RADAR_STD**2 + np.outer(across, across)
    return covariance
