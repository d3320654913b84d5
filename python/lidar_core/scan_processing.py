"""One posed scan through a pipeline, with all that is known about it; what viewers get of it."""

from collections.abc import Mapping

import numpy as np

from lidar_core.circles import CircleFrame, CirclePipeline, CirclesConfig, Scanner
from lidar_core.errors import ConfigError, FormatError
from lidar_core.flying import FlyingFrame, FlyingObjectDetector
from lidar_core.io.poses.posed import PosedScan
from lidar_core.io.write.mcap import FoxgloveLog
from lidar_core.messages import LaserScan, PointClass, Pose, Scan
from lidar_core.sensors import SENSORS

CLASSES_TOPIC = "/classes"


def detect(detector: FlyingObjectDetector, item: PosedScan[Scan], *, sensor: str) -> FlyingFrame:
    """Flying objects in one scan of the LiDAR `sensor`."""
    scan = item.scan
    return detector.process(
        scan.points,
        item.world_from_lidar,
        scan.stamp_ns,
        no_return=scan.no_return,
        directions=scan.directions,
        point_time_ns=scan.point_time_ns,
        pose_stamps_ns=item.pose_stamps_ns,
        pose_covariance=item.pose_covariance,
        sensor=sensor,
    )


def map_circles(pipeline: CirclePipeline, item: PosedScan[LaserScan]) -> CircleFrame:
    """Circles in one scan, and the map after it."""
    scan, stamps = item.scan, item.pose_stamps_ns
    rays = np.arange(len(scan.ranges), dtype=np.int64)
    return pipeline.process(
        scan.ranges,
        item.world_from_lidar,
        scan.stamp_ns,
        ray_time_ns=None if stamps is None else scan.stamp_ns + scan.time_increment_ns * rays,
        pose_stamps_ns=stamps,
        scanner=scanner_name(scan, pipeline.config.scanners),
    )


def sensor_name(scan: Scan | LaserScan) -> str:
    """Name of a scan's LiDAR: its topic, or its frame where it has none."""
    return scan.topic or scan.frame_id


def scanner_name(scan: LaserScan, scanners: Mapping[str, Scanner]) -> str:
    """Name of a scan's LiDAR among the `scanners` of the pipeline.

    One that delivers scans of several lengths is several LiDARs to the pipeline.
    """
    name = sensor_name(scan)
    other = layout_name(name, len(scan.ranges))
    return other if other in scanners else name


def layout_name(name: str, rays: int) -> str:
    """Name of the scans of LiDAR `name` that have another number of rays than most."""
    return f"{name}, {rays} rays"


def scanner_of(scan: LaserScan, config: CirclesConfig, place: str) -> Scanner:
    """Rays of the LiDAR that gave `scan`, within the range limits of `config.scanner`.

    Raises
    ------
    FormatError
        No pipeline can use its scans; the text begins with `place`.
    """
    limits = config.scanner
    try:
        return Scanner(
            angle_min=scan.angle_min,
            angle_increment=scan.angle_increment,
            n_beams=len(scan.ranges),
            range_min=max(scan.range_min, limits.range_min),
            range_max=min(scan.range_max, limits.range_max),
        )
    except ConfigError as error:
        raise FormatError(f"{place}: scans that cannot be used: {error}") from error


def check_no_rays(config: CirclesConfig) -> None:
    """Refuse rays in `config.scanner`, which the scans would override.

    Those of a preset are none: they are nominal, and stand in files that start from one.

    Raises
    ------
    ConfigError
        There are some.
    """
    nominal = [
        Scanner.load({"preset": name}) for name, sensor in SENSORS.items() if sensor.is_planar
    ]
    if config.scanners or any(_rays(one) == _rays(config.scanner) for one in nominal):
        return
    usual = _rays(Scanner())
    for name, value in _rays(config.scanner).items():
        if value != usual[name]:
            raise ConfigError(
                f"scanner.{name}: expected no value, since the recording states it; to have"
                f' another, name the scanner: --set scanners."TOPIC".{name}=...'
            )


def _rays(scanner: Scanner) -> dict[str, float]:
    return {name: getattr(scanner, name) for name in ("n_beams", "angle_min", "angle_increment")}


def log_flying(
    log: FoxgloveLog, item: PosedScan[Scan], frame: FlyingFrame, *, frame_id: str
) -> None:
    """Pose, cloud and tracks of one scan; `intensity` is the `PointClass` of the point.

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
    log.write(frame.tracks)


def log_circles(
    log: FoxgloveLog, item: PosedScan[LaserScan], frame: CircleFrame, *, frame_id: str
) -> None:
    """Pose and scan, circles and other shapes of the map after it."""
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
