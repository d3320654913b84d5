"""Scans with their results for viewers, in MCAP files and on servers."""

from typing import TYPE_CHECKING

import numpy as np

from lidar_core.io.write.mcap import FoxgloveLog
from lidar_core.messages import LaserScan, PointClass, Pose, PosedScan, Scan

if TYPE_CHECKING:
    from lidar_core.circles import CircleFrame
    from lidar_core.flying import FlyingFrame

CLASSES_TOPIC = "/classes"


def log_flying(
    log: FoxgloveLog, item: PosedScan[Scan], frame: "FlyingFrame", *, frame_id: str
) -> None:
    """Log pose, cloud and flying tracks of a scan; `intensity` holds the class of each point.

    Clouds hold the points with information.
    """
    scan = item.scan
    _log_pose(log, item, frame_id)
    shown = frame.shown_class
    is_point = shown != PointClass.INVALID
    log.write(
        Scan(
            stamp_ns=scan.stamp_ns,
            points=scan.points.reshape(-1, 3)[is_point],
            frame_id=scan.frame_id,
            intensity=shown[is_point].astype(np.float32),
            topic=CLASSES_TOPIC,
        )
    )
    log.write(frame.tracks.flying)


def log_circles(
    log: FoxgloveLog, item: PosedScan[LaserScan], frame: "CircleFrame", *, frame_id: str
) -> None:
    """Log pose and scan, and the circles and other shapes of the map after this scan."""
    _log_pose(log, item, frame_id)
    log.write(item.scan)
    log.write_circles(frame.map)
    log.write_shapes(frame.map_shapes)


def _log_pose(
    log: FoxgloveLog, item: PosedScan[Scan] | PosedScan[LaserScan], frame_id: str
) -> None:
    scan = item.scan
    if scan.frame_id != frame_id:
        pose = item.world_from_lidar.reshape(-1, 4, 4)[0]
        log.write(Pose(scan.stamp_ns, frame_id, scan.frame_id, pose))
