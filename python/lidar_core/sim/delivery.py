"""Conversion to the output of a driver: dropped points, zeros, no directions, no mask."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from lidar_core.messages import Scan
from lidar_core.sim.lidar import LidarModel
from lidar_core.sim.truth import SimulatedScan


def delivered(made: SimulatedScan, lidar: LidarModel) -> SimulatedScan:
    """Convert a scan with all rays known to the output of the driver of `lidar`.

    Each label stays with its point; the truth of the targets does not change.
    """
    if lidar.ideal:
        return made
    scan = made.scan
    if not lidar.point_times:
        scan = replace(scan, point_time_ns=None)
    if lidar.delivery == "rays":
        return replace(made, scan=scan)
    scan = replace(scan, no_return=None, directions=None)
    if lidar.delivery == "organised":
        return replace(made, scan=scan)
    is_return = np.asarray(np.isfinite(scan.points.reshape(-1, 3)).all(axis=1))
    if lidar.delivery == "zeros":
        points = np.where(is_return[:, None], scan.points.reshape(-1, 3), np.float32(0))
        return replace(made, scan=replace(scan, points=points.reshape(scan.points.shape)))
    return replace(made, scan=_rows(scan, is_return), label=made.label[is_return])


def _rows(scan: Scan, is_kept: NDArray[np.bool_]) -> Scan:
    """Return the kept points of a scan as a list of shape (N, 3), no longer organised."""
    times, ring = scan.point_time_ns, scan.ring
    return replace(
        scan,
        points=scan.points.reshape(-1, 3)[is_kept],
        point_time_ns=None if times is None else times[is_kept],
        ring=None if ring is None else ring[is_kept],
    )
