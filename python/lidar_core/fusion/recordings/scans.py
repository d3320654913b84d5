"""Scans of several targets, from recordings and tables."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lidar_core.fusion.recordings.autoferry import DetectionScan
from lidar_core.fusion.recordings.table import MeasurementLog


@dataclass(frozen=True, slots=True)
class TargetScans:
    """Detections of many targets, with the kind of their recording.

    `unused` names columns of a table that give no detection.
    """

    scans: list[DetectionScan]
    source: str
    unused: str | None = None


def scans_of(log: MeasurementLog) -> list[DetectionScan]:
    """Group the measurements by time and sensor, in the order of time; poses before the other ones.

    Parameters
    ----------
    log : MeasurementLog
        Measurements of several targets: every row is a detection. True positions belong to the IDs
        in the column true_id; without it they are left out, because their targets are unknown.

    Returns
    -------
    scans : list of DetectionScan
        `source` is the sensor.

    Examples
    --------
    >>> from lidar_core.fusion import Measurement
    >>> seen = [Measurement(0, "lidar", [1.0, 2.0]), Measurement(0, "lidar", [5.0, 2.0])]
    >>> [len(scan.measurements) for scan in scans_of(MeasurementLog(seen, None, "table"))]
    [2]
    """
    order = {"pose": 0, "pose-3d": 0, "gyro": 1}
    found: dict[tuple[int, int, str], DetectionScan] = {}
    truth: dict[tuple[int, int, str], dict[int, NDArray[np.float64]]] = {}
    for row, m in enumerate(log.measurements):
        key = (m.stamp_ns, order.get(m.sensor, 2), m.sensor)
        places = truth.setdefault(key, {})
        scan = found.setdefault(key, DetectionScan(m.stamp_ns, m.sensor, [], np.zeros(2), places))
        scan.measurements.append(m)
        if log.truth is not None and log.targets is not None and log.targets[row] >= 0:
            places[int(log.targets[row])] = log.truth.position[row]
    return [found[key] for key in sorted(found)]
