"""Reader of the Autoferry recordings: LiDAR and radar detections of boats, with the truth."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_core.errors import FormatError
from lidar_core.fusion.measurement import Measurement
from lidar_core.fusion.recordings.folders import check_sizes
from lidar_core.io.files.guard import reading

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


@dataclass(frozen=True, slots=True)
class DetectionScan:
    """What one scanner saw at one time.

    Attributes
    ----------
    stamp_ns : int
        [ns].
    source : str
        "lidar" or "radar".
    measurements : list of Measurement
        Positions in the world, each with its covariance.
    sensor : ndarray, shape (2,)
        Where the scanner was [m].
    truth : mapping of int to ndarray, shape (2,)
        Where the targets were [m]; empty without truth.
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
        By time, empty ones included, stamped with the time of their measurement: the radar's
        entries are 1.7 s late, the LiDAR's 0.6 s. Cameras are left out.

    Raises
    ------
    FormatError
        Not such a file; the text names the entry.
    LimitError
        More than 256 MiB.

    Notes
    -----
    True positions are interpolated to the times of the scans.

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
    scans, ways = [], _ways(beside, entries, truths)
    for number, (entry, truth) in enumerate(zip(entries, truths, strict=True)):
        with reading(f"{place}, entry {number}"):
            if int(entry["sensorID"]) in SOURCES:
                scans.append(_scan(entry, {key: ways[key] for key, *_ in _targets(entry, truth)}))
    return sorted(scans, key=lambda scan: scan.stamp_ns)


def _targets(entry: Any, truth: Any) -> list[tuple[int, float, NDArray[np.float64]]]:
    """Number, time [s] and place (east, north) of the targets of an entry."""
    return [
        (
            int(one["targetID"]),
            float(one["time"] if "time" in one else entry["time"]),
            np.array(one["position"][1::-1], np.float64),
        )
        for one in (truth if isinstance(truth, list) else [truth])
    ]


def _ways(
    place: Path, entries: Sequence[Any], truths: Sequence[Any]
) -> dict[int, NDArray[np.float64]]:
    """Times and places (K, 3) of every target, by time."""
    rows: dict[int, dict[float, NDArray[np.float64]]] = {}
    with reading(str(place)):
        for entry, truth in zip(entries, truths, strict=True):
            for number, time, at in _targets(entry, truth):
                rows.setdefault(number, {})[time] = at
        return {
            number: np.array([[time, *own[time]] for time in sorted(own)])
            for number, own in rows.items()
        }


def _entries(place: Path) -> list[Any]:
    check_sizes(place, [place], what="a file")
    with reading(str(place)):
        entries = json.loads(place.read_text("utf-8"))
    if not isinstance(entries, list):
        raise FormatError(f"{place}: expected a list of detections")
    return entries


def _scan(entry: Mapping[str, Any], ways: Mapping[int, NDArray[np.float64]]) -> DetectionScan:
    time = float(entry["time"])
    if not abs(time) <= MAX_TIME:
        raise FormatError(f"expected a time in seconds, got {time}")
    source = SOURCES[int(entry["sensorID"])]
    stamp_ns = round(time * 1e9) - round(DELAYS[source] * 1e9)
    sensor = np.array(entry["ownshipPosition"], np.float64)[1::-1]  # north, east
    offsets = np.array(entry["measurement"], np.float64).reshape(2, -1)[::-1].T
    if sensor.shape != (2,) or not (np.isfinite(sensor).all() and np.isfinite(offsets).all()):
        raise FormatError("expected finite positions, north and east")
    places = {
        number: np.array([np.interp(stamp_ns * 1e-9, way[:, 0], way[:, axis]) for axis in (1, 2)])
        for number, way in ways.items()
    }
    measurements = [
        Measurement(stamp_ns, "lidar", sensor + offset, _covariance(offset, source))
        for offset in offsets
    ]
    return DetectionScan(stamp_ns, source, measurements, sensor, places)


def _covariance(offset: NDArray[np.float64], source: str) -> NDArray[np.float64]:
    if source == "lidar":
        return np.eye(2) * LIDAR_STD**2
    across = np.array([-offset[1], offset[0]]) * RADAR_BEARING_STD  # as long as the range
    covariance: NDArray[np.float64] = np.eye(2) * RADAR_STD**2 + np.outer(across, across)
    return covariance
