"""Insertion of a simulated target into a posed recording whose sensor moves."""

from collections.abc import Iterable, Iterator
from itertools import chain, pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_core._core import SimTrajectory
from lidar_core.errors import InputError
from lidar_core.messages import PosedScan, Scan
from lidar_core.sim.insertion.inserted import (
    Poses,
    SolidTarget,
    insert_solid,
    labels_of,
    truth_of_one,
)
from lidar_core.sim.insertion.ray_pattern import RayPattern
from lidar_core.sim.insertion.ray_scan import SensorWay
from lidar_core.sim.motion.motions import Scripted
from lidar_core.sim.truth import SimulatedScan

STEP_NS = 1_000_000
"""Time over which the velocity of the target is computed [ns]."""


def with_moving_target(
    posed: Iterable[PosedScan[Scan]],
    shape: Any,
    motion: Scripted,
    *,
    seed: int,
    seconds: float = 3600.0,
    follows: bool = False,
    deskewed: bool = False,
    pattern: RayPattern | None = None,
    range_min: float = 0.0,
    range_max: float = 100.0,
    range_std: float = 0.02,
) -> Iterator[SimulatedScan]:
    """Insert a target with its own trajectory into the scans of a sensor that may move.

    Target and sensor are at their places at the time of each ray: the time of its point, or of the
    nearest point in azimuth for a ray that the driver dropped.

    Parameters
    ----------
    posed : iterable of PosedScan
        Scans with poses, as of `lidar_core.io.posed_scans`. Between single poses of successive
        scans, the sensor moves at constant velocity.
    shape : Solid, (vertices, faces), or a mesh
        Shape as for `insert_target`.
    motion : Motion
        Motion of the shape from the stamp of the first scan on, world frame.
    seed : int
        Seed of the noise.
    seconds : float
        Length of the path [s]; the target stays at its end.
    follows : bool
        The motion is relative to the sensor: the target moves along with it.
    deskewed : bool
        The motion was compensated in the clouds: their points are in the sensor's frame at the
        stamp.
    pattern : RayPattern, optional
        Rays that the scans leave out, as for `insert_target`.
    range_min, range_max, range_std : float
        Range limits and range noise of the sensor [m].

    Yields
    ------
    SimulatedScan
        The scan with its truth; labels are 0 for recorded points and 1 for the target.

    Raises
    ------
    InputError
        Poses and their times do not fit.
    """
    target = SolidTarget(shape)
    rng = np.random.default_rng([20240607, seed])
    way_of_target: SimTrajectory | None = None
    for now, after in _with_next(posed):
        if way_of_target is None:
            times, poses = motion.knots(seconds)
            stamps = now.scan.stamp_ns + np.round(times * 1e9).astype(np.int64)
            way_of_target = SimTrajectory(stamps, np.ascontiguousarray(poses))
        way = _way(now, after, deskewed=deskewed)
        places = _places(way_of_target, way if follows else None)
        done = insert_solid(
            now.scan,
            target,
            places,
            way=way,
            pattern=pattern,
            range_limits=(range_min, range_max),
            range_std=range_std,
            rng=rng,
        )
        start = np.array([now.scan.stamp_ns, now.scan.stamp_ns + STEP_NS], np.int64)
        position = places(start)[:, :3, 3]
        velocity = (position[1] - position[0]) / (STEP_NS * 1e-9)
        yield SimulatedScan(
            scan=done.scan,
            world_from_lidar=way.at(start[:1])[0],
            pose_stamps_ns=way.stamps_ns,
            poses=way.poses,
            truth=truth_of_one(done, position[0], velocity, target.radius),
            label=labels_of(done),
        )


def _with_next(
    posed: Iterable[PosedScan[Scan]],
) -> Iterator[tuple[PosedScan[Scan], PosedScan[Scan] | None]]:
    for now, after in pairwise(chain(posed, [None])):
        if now is not None:
            yield now, after


def _way(now: PosedScan[Scan], after: PosedScan[Scan] | None, *, deskewed: bool) -> SensorWay:
    """Return the trajectory of the sensor during a scan; `after` is the next scan."""
    poses: NDArray[np.float64] = np.asarray(now.world_from_lidar, np.float64).reshape(-1, 4, 4)
    if now.pose_stamps_ns is not None:
        if len(now.pose_stamps_ns) != len(poses):
            raise InputError(
                f"pose_stamps_ns: expected {len(poses)} as there are poses,"
                f" got {len(now.pose_stamps_ns)}"
            )
        return SensorWay(np.asarray(now.pose_stamps_ns, np.int64), poses, deskewed)
    stamps = np.array([now.scan.stamp_ns], np.int64)
    if after is not None and after.scan.stamp_ns > now.scan.stamp_ns and len(poses) == 1:
        following = np.asarray(after.world_from_lidar, np.float64).reshape(-1, 4, 4)[:1]
        stamps = np.append(stamps, after.scan.stamp_ns)
        poses = np.concatenate([poses, following])
    return SensorWay(stamps, poses, deskewed)


def _places(target: SimTrajectory, sensor: SensorWay | None) -> Poses:
    def at(stamps_ns: NDArray[np.int64]) -> NDArray[np.float64]:
        own = target.poses_at(stamps_ns)
        return own if sensor is None else sensor.at(stamps_ns) @ own

    return at
