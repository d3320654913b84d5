"""Rays of one recorded scan, each in the frame of the sensor at its own time."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lidar_core._core import SimTrajectory
from lidar_core.messages import Scan
from lidar_core.sim.insertion.ray_pattern import NEAREST_RETURN, RayPattern
from lidar_core.sim.insertion.ray_rows import between_neighbours, grid_directions


@dataclass(frozen=True, slots=True)
class SensorWay:
    """Trajectory of the sensor during a scan, and the frame of the scan.

    Attributes
    ----------
    stamps_ns, poses : ndarray, shapes (K,), int64, and (K, 4, 4), float64
        Poses of the sensor in the world at some times.
    deskewed : bool
        The motion was compensated: all points are in the frame of the sensor at `Scan.stamp_ns`.
    """

    stamps_ns: NDArray[np.int64]
    poses: NDArray[np.float64]
    deskewed: bool = False

    def at(self, stamps_ns: NDArray[np.int64]) -> NDArray[np.float64]:
        """Return poses (M, 4, 4) at times [ns], interpolated between the nearest ones."""
        way = SimTrajectory(self.stamps_ns, np.ascontiguousarray(self.poses))
        return way.poses_at(stamps_ns)


@dataclass(frozen=True, slots=True)
class Rays:
    """Rays in the sensor's frame at their own time; `row`: index in the cloud, -1 for none."""

    directions: NDArray[np.float64]
    lengths: NDArray[np.float64]
    row: NDArray[np.int64]
    near: NDArray[np.int64]  # a row that was fired at about the same time
    ring: NDArray[np.int64]

    def with_lost(
        self,
        directions: NDArray[np.float64],
        row: NDArray[np.int64],
        near: NDArray[np.int64],
        ring: NDArray[np.int64],
    ) -> "Rays":
        """Add rays that returned nothing."""
        return Rays(
            np.concatenate([self.directions, directions]),
            np.concatenate([self.lengths, np.full(len(row), np.inf)]),
            np.concatenate([self.row, row]),
            np.concatenate([self.near, near]),
            np.concatenate([self.ring, ring]),
        )

    def chosen(self, wanted: NDArray[np.bool_]) -> "Rays":
        """Select the rays in the mask `wanted`."""
        return Rays(
            self.directions[wanted],
            self.lengths[wanted],
            self.row[wanted],
            self.near[wanted],
            self.ring[wanted],
        )


def rays_of(
    scan: Scan, way: SensorWay, pattern: RayPattern | None, rng: np.random.Generator
) -> Rays:
    """Return all rays of a scan in the sensor's frame, also those missing in its cloud."""
    raw = scan.points.reshape(-1, 3)
    rows = np.flatnonzero(np.isfinite(raw).all(axis=1))
    fired = _as_fired(scan, raw[rows].astype(np.float64), rows, way)
    away = np.linalg.norm(fired, axis=1)
    far = away > NEAREST_RETURN  # zeros, also ones that a motion correction has moved, are none
    lengths = np.full(len(raw), np.nan)
    directions = np.full((len(raw), 3), np.nan)
    lengths[rows[far]] = away[far]
    directions[rows[far]] = fired[far] / away[far, None]
    kept = np.isfinite(lengths)
    lost = _rows_without_return(scan, kept)
    if scan.directions is not None:
        given = scan.directions.reshape(-1, 3)
        use = lost & np.isfinite(given).all(axis=1)
        directions[use] = given[use]
    elif scan.points.ndim == 3:
        directions[lost] = grid_directions(directions.reshape(scan.points.shape))[lost]
    placed = lost & np.isfinite(directions).all(axis=1)
    lengths[placed] = np.inf
    known = np.flatnonzero(kept | placed)
    ring = None if scan.ring is None else scan.ring.reshape(-1)
    rows = np.full(len(known), -1, np.int64) if ring is None else ring[known].astype(np.int64)
    rays = Rays(directions[known], lengths[known], known, known, rows)
    if pattern is None or scan.points.ndim == 3 or scan.directions is not None or not len(known):
        return rays
    empty = np.flatnonzero(lost & ~placed)
    if pattern.density is not None:
        rays, empty = _on_lines(scan, rays, empty, has_rows=bool(lost.any()))
    return _with_missing(rays, ring is not None, pattern, empty, rng, has_rows=bool(lost.any()))


def _on_lines(
    scan: Scan, rays: Rays, empty: NDArray[np.int64], *, has_rows: bool
) -> tuple[Rays, NDArray[np.int64]]:
    """Add the rays missing in short gaps of lines; return also the remaining empty entries."""
    lines = np.zeros(len(rays.row), np.int64) if scan.ring is None else rays.ring
    times = None if scan.point_time_ns is None else scan.point_time_ns.reshape(-1)[rays.row]
    directions, rows, near = between_neighbours(
        rays.directions, rays.row, lines, times, rows_are_rays=has_rows
    )
    if has_rows:
        kept = np.isin(rows, empty)
        directions, rows, near = directions[kept], rows[kept], near[kept]
        empty = np.setdiff1d(empty, rows)
    return rays.with_lost(directions, rows, rays.row[near], rays.ring[near]), empty


def _with_missing(
    rays: Rays,
    has_rings: bool,
    pattern: RayPattern,
    empty: NDArray[np.int64],
    rng: np.random.Generator,
    *,
    has_rows: bool,
) -> Rays:
    """Add the rays that the pattern predicts; in clouds with `empty` entries, they use these."""
    known = rays.directions
    ring = rays.ring.astype(np.uint16) if has_rings else None
    lost, rows = pattern.missing(known, ring, rng, total=len(empty) if has_rows else None)
    place = np.full(len(lost), -1, np.int64)
    if has_rows:
        order = rng.permutation(len(lost))[: len(empty)]
        place[order] = rng.permutation(empty)[: len(order)]
        kept = place >= 0
        lost, rows, place = lost[kept], rows[kept], place[kept]
    return rays.with_lost(lost, place, rays.near[_nearest(known, lost)], rows)


def _rows_without_return(scan: Scan, kept: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return which entries mark a ray without return: masked, zeros, or NaN of an organised cloud.

    Other entries of NaN are without information. If a mask is given, the mask decides.
    """
    if scan.no_return is not None:
        return scan.no_return.reshape(-1) & ~kept
    finite = np.isfinite(scan.points.reshape(-1, 3)).all(axis=1)
    return ~kept & (finite | (scan.points.ndim == 3))


def _as_fired(
    scan: Scan, points: NDArray[np.float64], rows: NDArray[np.int64], way: SensorWay
) -> NDArray[np.float64]:
    """Return points in the sensor's frame at their own time, also if the scan was deskewed."""
    if not way.deskewed:
        return points
    start = way.at(np.array([scan.stamp_ns]))[0]
    moved = inverse(way.at(times_of_rows(scan, rows))) @ start
    return np.asarray(np.einsum("mij,mj->mi", moved[:, :3, :3], points) + moved[:, :3, 3])


def times_of_rows(scan: Scan, rows: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the times of the points with the indices `rows` [ns]."""
    if scan.point_time_ns is None:
        return np.full(len(rows), scan.stamp_ns, np.int64)
    return scan.point_time_ns.reshape(-1)[rows].astype(np.int64)


def _nearest(known: NDArray[np.float64], wanted: NDArray[np.float64]) -> NDArray[np.int64]:
    """Index of a known direction with nearly the azimuth, and so the time, of each wanted one."""
    azimuth = np.arctan2(known[:, 1], known[:, 0])
    order = np.argsort(azimuth, kind="stable")
    at = np.searchsorted(azimuth[order], np.arctan2(wanted[:, 1], wanted[:, 0]))
    return np.asarray(order[np.minimum(at, len(order) - 1)], np.int64)


def inverse(poses: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the inverses of rigid transforms (M, 4, 4)."""
    found = np.zeros_like(poses)
    turned = np.swapaxes(poses[:, :3, :3], 1, 2)
    found[:, :3, :3] = turned
    found[:, :3, 3] = -np.einsum("mij,mj->mi", turned, poses[:, :3, 3])
    found[:, 3, 3] = 1
    return found
