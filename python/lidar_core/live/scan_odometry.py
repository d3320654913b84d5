"""Poses of a stream without any: KISS-ICP places its clouds as they are processed."""

from collections.abc import Callable

from lidar_core.errors import ConfigError, InputError
from lidar_core.io import NoTransformError, PosedScan
from lidar_core.messages import Scan, ScanT


class ScanOdometry:
    """Odometry from the clouds of one LiDAR, in the frame at the end of the first one.

    Scans that are dropped in favour of a newer one get no pose: their motion is part of the next
    step.

    Parameters
    ----------
    note : callable, optional
        Called with the text of every warning.

    Raises
    ------
    MissingExtraError
        kiss-icp is not installed.
    """

    def __init__(self, note: Callable[[str], None] | None = None) -> None:
        from lidar_core.io.poses.odometry import KissOdometry

        self._odometry = KissOdometry(note)
        self._lidar: tuple[str, str] | None = None

    def posed(self, scan: ScanT) -> PosedScan[ScanT]:
        """Return `scan` with its estimated pose, or with two over its time, and their covariance.

        Raises
        ------
        NoTransformError
            The pose cannot be estimated, or the scan is not later than the one before.
        ConfigError
            The scan is a 2D scan, or is of another LiDAR than those before.
        """
        if not isinstance(scan, Scan):
            raise ConfigError(
                "pose: kiss works for clouds, not for 2D scans; expected auto or static for a"
                " stream of"
                " 2D scans"
            )
        lidar = scan.topic, scan.frame_id
        if self._lidar is None:
            self._lidar = lidar
        if lidar != self._lidar:
            first, other = (" ".join(filter(None, one)) for one in (self._lidar, lidar))
            raise ConfigError(
                f"pose: kiss works for one LiDAR, got scans of {first} and {other}; choose one"
                " with clouds=[TOPIC]"
            )
        try:
            placed = self._odometry.place(scan)
        except InputError as error:
            raise NoTransformError(
                "KISS-ICP: expected scans in order of time, got one not later than the one before"
            ) from error
        if placed is None:
            raise NoTransformError("KISS-ICP lost track")
        return PosedScan(scan, placed.poses, placed.stamps_ns, placed.covariance)
