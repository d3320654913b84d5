"""Insertion of a solid into one recorded scan: only rays that would hit it change."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from lidar_core._core import SimScene, SimShape
from lidar_core.arrays import as_finite_rows, as_rows
from lidar_core.errors import InputError
from lidar_core.messages import Scan
from lidar_core.objects import TargetTruth
from lidar_core.sim.insertion.ray_pattern import SAME_RAY, RayPattern, is_return
from lidar_core.sim.insertion.ray_scan import Rays, SensorWay, inverse, rays_of, times_of_rows
from lidar_core.sim.solids.people import Placed

Poses: TypeAlias = Callable[[NDArray[np.int64]], NDArray[np.float64]]
"""Poses (M, 4, 4) at times (M,) [ns]."""


MOMENTS = 9
"""Number of times in a scan at which the bearing of a solid is computed first."""
BACKGROUND, TARGET = 0, 1
"""Labels of rays that hit the background or the target; -1: no hit."""


class SolidTarget:
    """A shape whose intersections with rays can be computed.

    Parameters
    ----------
    shape : Solid, (vertices, faces), or a mesh
        A shape of `lidar_core.sim`, arrays (V, 3) and (F, 3), or an object with `vertices` and
        `faces` such as that of trimesh [m].

    Raises
    ------
    InputError
        The shape has another type.
    """

    def __init__(self, shape: Any) -> None:
        surfaces = _surfaces(shape)
        self.radius = max(float(np.linalg.norm(at)) + one.radius for one, at in surfaces)
        bodies = []
        for surface, at in surfaces:
            pose = np.eye(4)
            pose[:3, 3] = at
            bodies.append((surface, pose, 0))
        self._scene = SimScene(bodies, [], threads=1)

    def distances(
        self, origins: NDArray[np.float64], directions: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return the distance along rays (M, 3) to the shape [m]; infinite for misses."""
        along = np.maximum(-np.einsum("ij,ij->i", origins, directions), 0.0)
        near = np.linalg.norm(origins + along[:, None] * directions, axis=1) <= self.radius
        found = np.full(len(origins), np.inf)
        found[near] = self._scene.cast(
            np.ascontiguousarray(origins[near]), np.ascontiguousarray(directions[near]), 1e6
        )[0]
        return found


@dataclass(frozen=True, slots=True)
class Inserted:
    """A scan with a solid in it.

    Attributes
    ----------
    scan : Scan
        New points replace the entries of known rays. New points of rays that the driver dropped are
        at the end.
    is_hit : ndarray, shape (N,), bool
        True for points that are returns of the solid.
    source : ndarray, shape (N,), int64
        Index of each point in the recorded scan; -1 for a new point.
    rays : int
        Number of rays that would hit the solid within range if there were no other objects.
    """

    scan: Scan
    is_hit: NDArray[np.bool_]
    source: NDArray[np.int64]
    rays: int


def insert_solid(
    scan: Scan,
    target: SolidTarget,
    world_from_target: Poses,
    *,
    way: SensorWay,
    pattern: RayPattern | None,
    range_limits: tuple[float, float],
    range_std: float,
    rng: np.random.Generator,
) -> Inserted:
    """End every ray of a scan that would hit a solid first on the solid.

    Parameters
    ----------
    scan : Scan
        Recorded scan; rays without return may be marked, zeros, NaN of an organised cloud, or
        dropped.
    target, world_from_target
        The solid, and where it is at which time.
    way : SensorWay
        Poses of the sensor over time.
    pattern : RayPattern, optional
        Pattern of the sensor, to find missing rays that the scan does not mark; without it only
        known rays count.
    range_limits : tuple of float
        Least and greatest range of the sensor [m]; a solid nearer than the least hides what is
        behind it and gives no return.
    range_std : float
        Standard deviation of the new ranges [m].
    rng : numpy.random.Generator
        Source of the noise and of the missing rays of a density.
    """
    rays = rays_of(scan, way, pattern, rng)
    rays = _towards(rays, target.radius, world_from_target, way, times_of_rows(scan, rays.near))
    times = times_of_rows(scan, rays.near)
    frames = way.at(times)
    met = Meeting(target, inverse(world_from_target(times)) @ frames, range_limits, range_std)
    points, ends, is_seen, count = met.of(rays, rng)
    if way.deskewed:
        start = way.at(np.array([scan.stamp_ns]))[0]
        moved = inverse(start[None]) @ frames
        points = np.einsum("mij,mj->mi", moved[:, :3, :3], points) + moved[:, :3, 3]
    return written(scan, rays, points.astype(np.float32), ends, is_seen, count)


def _towards(
    rays: Rays,
    radius: float,
    world_from_target: Poses,
    way: SensorWay,
    times: NDArray[np.int64],
) -> Rays:
    """Keep the rays that can hit the solid, so that only a few poses are computed."""
    if not len(times):
        return rays
    moments = np.linspace(times.min(), times.max(), MOMENTS).astype(np.int64)
    seen = (inverse(way.at(moments)) @ world_from_target(moments))[:, :3, 3]
    distance = np.linalg.norm(seen, axis=1)
    if distance.min() < 2 * radius:
        return rays
    ahead = seen / distance[:, None]
    steps = np.linalg.norm(np.diff(ahead, axis=0), axis=1)
    reach = float(np.arcsin(radius / distance.min()) + 2 * steps.max(initial=0.0) + 1e-3)
    if reach > 1.0:
        return rays
    return rays.chosen((rays.directions @ ahead.T).max(axis=1) >= np.cos(reach))


@dataclass(frozen=True, slots=True)
class Meeting:
    """Rays of a scan, and a solid; `target_from_ray`: transforms of the rays into its frame."""

    target: SolidTarget
    target_from_ray: NDArray[np.float64]
    range_limits: tuple[float, float]
    range_std: float

    def of(
        self, rays: Rays, rng: np.random.Generator
    ) -> tuple[NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], int]:
        """Return points on the solid, rays that end on it, rays that return, and a number of rays.

        A ray that ends on the solid gives no return of it if the solid is nearer than the least
        range, or if the ray has a nearer return. The number counts rays that would hit the solid if
        there were no other objects.
        """
        distance = self.target.distances(
            np.ascontiguousarray(self.target_from_ray[:, :3, 3]),
            np.einsum("mij,mj->mi", self.target_from_ray[:, :3, :3], rays.directions),
        )
        would = ~np.isnan(rays.lengths) & (distance <= self.range_limits[1])
        ends = would & (distance < rays.lengths)
        is_seen = ends & (distance >= self.range_limits[0]) & _first_of_each(rays, ends)
        length = np.where(is_seen, distance, np.nan)
        length[is_seen] += rng.normal(0.0, self.range_std, int(is_seen.sum()))
        count = int(np.count_nonzero(_first_of_each(rays, would)))
        return rays.directions * length[:, None], ends, is_seen, count


def _first_of_each(rays: Rays, chosen: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return which of the `chosen` entries is the nearest return of its ray.

    Returns of one ray have the same direction and are separate points of the cloud.
    """
    index = np.flatnonzero(chosen)
    cell = np.round(rays.directions[index] / SAME_RAY).astype(np.int64)
    order = np.lexsort([rays.lengths[index], *cell.T])
    is_new = (np.diff(cell[order], axis=0, prepend=np.iinfo(np.int64).min) != 0).any(axis=1)
    first = np.zeros(len(chosen), bool)
    first[index[order[is_new]]] = True
    return first


def written(
    scan: Scan,
    rays: Rays,
    points: NDArray[np.float32],
    ends: NDArray[np.bool_],
    is_seen: NDArray[np.bool_],
    rays_on_it: int,
) -> Inserted:
    """Return the scan with the returns of the solid, and without hidden points."""
    rows = scan.points.reshape(-1, 3).copy()
    hidden = rays.row[ends & ~is_seen & (rays.row >= 0)]
    taken = rays.row[is_seen & (rays.row >= 0)]
    had_return = is_return(rows)
    is_dropping = scan.no_return is None and scan.points.ndim == 2 and had_return.all()
    rows[hidden[had_return[hidden]]] = (
        np.nan if scan.points.ndim == 3 or scan.no_return is not None else 0
    )
    rows[taken] = points[is_seen & (rays.row >= 0)]
    is_hit = np.zeros(len(rows), bool)
    is_hit[taken] = True
    no_return = None
    if scan.no_return is not None:
        no_return = scan.no_return.reshape(-1).copy()
        no_return[taken] = no_return[hidden] = False
    source = np.arange(len(rows))
    if is_dropping:
        source = np.setdiff1d(source, hidden)
    added = np.flatnonzero(is_seen & (rays.row < 0))
    near = np.concatenate([source, rays.near[added]])
    made = _select_rows(
        replace(scan, points=rows.reshape(scan.points.shape), no_return=no_return),
        near,
        len(source),
        points[added],
        rays,
        added,
    )
    hit = np.concatenate([is_hit[source], np.ones(len(added), bool)])
    if made.intensity is not None and hit.any():
        made.intensity.reshape(-1)[hit] = np.float32(np.median(made.intensity))
    return Inserted(made, hit, np.concatenate([source, np.full(len(added), -1)]), rays_on_it)


def _select_rows(
    scan: Scan,
    near: NDArray[np.int64],
    kept: int,
    points: NDArray[np.float32],
    rays: Rays,
    added: NDArray[np.int64],
) -> Scan:
    """Return the entries `near` of a scan; those after the first `kept` become new points."""
    intensity = None if scan.intensity is None else scan.intensity.copy()
    if scan.points.ndim == 3 or (kept == len(scan.points) and not len(added)):
        return replace(scan, intensity=intensity)

    def picked(values: NDArray[Any] | None) -> NDArray[Any] | None:
        return None if values is None else values[near]

    ring, directions = picked(scan.ring), picked(scan.directions)
    if ring is not None:
        told = rays.ring[added]
        ring[kept:] = np.where(told >= 0, told, ring[kept:])
    if directions is not None:
        directions[kept:] = rays.directions[added]
    no_return = picked(scan.no_return)
    if no_return is not None:
        no_return[kept:] = False
    return replace(
        scan,
        points=np.concatenate([scan.points[near[:kept]], points]),
        no_return=no_return,
        directions=directions,
        point_time_ns=picked(scan.point_time_ns),
        intensity=picked(intensity),
        ring=ring,
    )


def labels_of(done: Inserted) -> NDArray[np.int32]:
    """Label every entry: the solid, a recorded return, or no return."""
    points = done.scan.points.reshape(-1, 3)
    is_point = is_return(points) & np.isfinite(points).all(axis=1)
    other = np.where(is_point, BACKGROUND, -1)
    return np.where(done.is_hit, TARGET, other).astype(np.int32)


def truth_of_one(
    done: Inserted,
    position: NDArray[np.float64],
    velocity: NDArray[np.float64],
    radius: float,
) -> TargetTruth:
    """Return the truth about the solid, world frame."""
    return TargetTruth(
        id=np.array([TARGET], np.int32),
        position=position[None],
        velocity=velocity[None],
        radius=np.array([radius]),
        hits=np.array([done.is_hit.sum()], np.int64),
        rays=np.array([done.rays], np.int64),
        visible=np.array([done.is_hit.any()]),
    )


def _surfaces(shape: Any) -> Placed:
    if hasattr(shape, "surfaces"):
        placed: Placed = shape.surfaces()
        return placed
    if hasattr(shape, "vertices") and hasattr(shape, "faces"):
        shape = (shape.vertices, shape.faces)
    if not isinstance(shape, tuple) or len(shape) != 2:
        raise InputError(
            "shape: expected a shape of lidar_core.sim, a mesh with vertices and faces, or a"
            f" tuple (vertices, faces), got {type(shape).__name__}"
        )
    vertices = as_finite_rows(shape[0], name="vertices", rows=None, shape=(3,))
    faces = as_rows(shape[1], name="faces", rows=None, shape=(3,), dtype=np.uint32)
    return [(SimShape.mesh(vertices, faces), np.zeros(3))]
