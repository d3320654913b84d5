"""Conversion of a raw 2D scan to the horizontal plane: range limitation and projection."""

from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lidar_core import _core
from lidar_core.arrays import as_finite_rows, as_poses, as_rows, as_stamp
from lidar_core.errors import InputError

Ranges = NDArray[np.float64]


def limit_range(
    ranges: ArrayLike,
    bearings: ArrayLike,
    world_from_lidar: ArrayLike,
    *,
    planes: ArrayLike,
    stamp_ns: int | None = None,
    ray_time_ns: ArrayLike | None = None,
    pose_stamps_ns: ArrayLike | None = None,
) -> Ranges:
    """Limit a scan to an operating volume.

    Parameters
    ----------
    ranges : array_like, shape (B,), float
        Range of every ray [m]; +inf is a miss, NaN no information, as is -inf (too close).
    bearings : array_like, shape (B,), float
        Direction of every ray in the scan's plane, counter-clockwise from x [rad].
    world_from_lidar : array_like, shape (4, 4) or (K, 4, 4), float64
        Pose of the scanner, or a stream of poses with `pose_stamps_ns` and `ray_time_ns`.
    planes : array_like, shape (P, 4), float64
        (a, b, c, d) each: inside is where a x + b y + c z <= d [m], world frame; (a, b, c) is
        not 0.
    stamp_ns : int, optional
        Time of the scan [ns]; none: that of the first ray.
    ray_time_ns : array_like, shape (B,), int64, optional
        Time of every ray [ns].
    pose_stamps_ns : array_like, shape (K,), int64, optional
        Time of every pose [ns], increasing.

    Returns
    -------
    ranges : ndarray, shape (B,), float64
        Range of every ray [m]. Surfaces outside the volume become misses (+inf), because their rays
        have passed the volume; surfaces that hide the volume become no information (NaN).

    Raises
    ------
    InputError
        Wrong shape, dtype or value.

    Notes
    -----
    Source: Sanchez-Lopez et al., eq. 4. Deterministic; releases the GIL.

    Examples
    --------
    >>> limit_range([2, 5, np.inf], [0, 0.1, 0.2], np.eye(4), planes=[[1, 0, 0, 3]])
    array([ 2., inf, inf])
    """
    scan, angles = as_scan(ranges, bearings)
    return _core.limit_range(
        scan,
        angles,
        as_poses(world_from_lidar),
        planes=as_finite_rows(planes, name="planes", rows=None, shape=(4,)),
        **times(len(scan), stamp_ns, ray_time_ns, pose_stamps_ns),
    )


def project_horizontal(
    ranges: ArrayLike,
    bearings: ArrayLike,
    world_from_lidar: ArrayLike,
    *,
    mode: Literal["exact", "paper"] = "exact",
    stamp_ns: int | None = None,
    ray_time_ns: ArrayLike | None = None,
    pose_stamps_ns: ArrayLike | None = None,
) -> tuple[Ranges, Ranges, Ranges]:
    """Project a scan into the level frame: the horizontal plane through the scanner.

    The level frame has its origin at the scanner at the time of the scan, z up, and the scanner's
    yaw (of the angles in ZYX order).

    Parameters
    ----------
    ranges, bearings, world_from_lidar, stamp_ns, ray_time_ns, pose_stamps_ns
        Same meaning as in `limit_range`. With a stream of poses, the motion during the sweep is
        corrected.
    mode : str
        "exact": every point as seen from above; "paper": ranges by cos(pitch) cos(roll), bearings
        as they are, eq. 5.

    Returns
    -------
    ranges : ndarray, shape (B,), float64
        Horizontal ranges [m]; misses and rays without information stay.
    bearings : ndarray, shape (B,), float64
        Bearings in the level frame [rad], continuous from ray to ray, not equally spaced.
    z : ndarray, shape (B,), float64
        Height of every hit above the scanner [m]; NaN for others.

    Raises
    ------
    InputError
        Wrong shape, dtype or value.
    ConfigError
        There is no such mode.

    Notes
    -----
    Source: Sanchez-Lopez et al., eq. 5. Deterministic; releases the GIL.

    Examples
    --------
    >>> pitched = [[0.8, 0, 0.6, 0], [0, 1, 0, 0], [-0.6, 0, 0.8, 0], [0, 0, 0, 1]]
    >>> ranges, _, _ = project_horizontal([5, 5], [0, np.pi / 2], pitched)
    >>> ranges
    array([4., 5.])
    """
    scan, angles = as_scan(ranges, bearings)
    return _core.project_horizontal(
        scan,
        angles,
        as_poses(world_from_lidar),
        mode=mode,
        **times(len(scan), stamp_ns, ray_time_ns, pose_stamps_ns),
    )


def as_scan(ranges: ArrayLike, bearings: ArrayLike) -> tuple[Ranges, Ranges]:
    """Check and return ranges (>= 0, +inf or NaN) and finite bearings, float64, of one length."""
    angles = as_finite_rows(bearings, name="bearings", rows=None, shape=())
    scan: Ranges = as_rows(ranges, name="ranges", rows=len(angles), shape=(), dtype=np.float64)
    if (bad := np.flatnonzero(scan < 0)).size:
        if (scan[bad] != -np.inf).any():
            row = int(bad[np.argmax(scan[bad] != -np.inf)])
            raise InputError(
                f"ranges: expected >= 0, +inf (a miss) or NaN, got {scan[row]} in ray {row}"
            )
        scan = np.where(scan < 0, np.nan, scan)  # too close to be measured
    return scan, angles


def times(
    rays: int,
    stamp_ns: int | None,
    ray_time_ns: ArrayLike | None,
    pose_stamps_ns: ArrayLike | None,
) -> dict[str, Any]:
    """Return the checked times of a scan as keyword arguments of the core."""
    of_rays = _stamps(ray_time_ns, "ray_time_ns", rays)
    of_poses = _stamps(pose_stamps_ns, "pose_stamps_ns", None)
    if stamp_ns is None:
        first = next((times[0] for times in (of_rays, of_poses) if times is not None), 0)
        stamp_ns = int(first)
    return {
        "stamp_ns": as_stamp(stamp_ns),
        "ray_time_ns": of_rays,
        "pose_stamps_ns": of_poses,
    }


def _stamps(values: ArrayLike | None, name: str, rows: int | None) -> NDArray[np.int64] | None:
    if values is None:
        return None
    stamps = as_rows(values, name=name, rows=rows, shape=(), dtype=np.int64)
    if not len(stamps):
        raise InputError(f"{name}: expected at least one stamp, got none")
    return stamps
