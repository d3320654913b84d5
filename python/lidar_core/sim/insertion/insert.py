"""Insertion of a simulated target into real scans: only rays that hit it change."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from lidar_core.arrays import as_real
from lidar_core.config import Config
from lidar_core.errors import InputError
from lidar_core.messages import Scan
from lidar_core.sim.insertion.inserted import (
    Inserted,
    Meeting,
    SolidTarget,
    labels_of,
    truth_of_one,
    written,
)
from lidar_core.sim.insertion.ray_pattern import RayPattern
from lidar_core.sim.insertion.ray_scan import SensorWay, inverse, rays_of
from lidar_core.sim.motion.knots import poses
from lidar_core.sim.solids.shapes import Sphere
from lidar_core.sim.truth import SimulatedScan

UPRIGHT = (0.0, 0.0, 0.0, 1.0)
STANDING = SensorWay(np.zeros(1, np.int64), np.eye(4)[None])
"""A sensor that does not move."""
PLACES_TO_TRY, STEPS_ROUND = 4000, 48


SPEED_PERIOD = 6.0
"""Period of the speed: time from one maximum to the next [s]."""
SCAN_RATE = 10.0
"""Scans per second [Hz]."""
TILT_DEG = 20.0
"""Greatest tilt of the circle of a flight [deg]."""

Reach = Annotated[float, Field(ge=0, le=1e4)]


class InsertedFlight(Config):
    """A sphere that flies circles through space that a real scan shows as free."""

    removed: ClassVar[Mapping[str, str]] = {
        "speed_period": "the speed repeats after 6 s",
        "tilt_deg": "circles are tilted by up to 20 deg",
        "scan_rate": "there are 10 scans per second",
    }
    scans: int = Field(default=200, ge=1, le=1_000_000, description="Length (count, no unit).")
    radius: float = Field(default=0.325, gt=0, le=10, description="Radius of the target [m].")
    clearance: float = Field(
        default=1.0, ge=0, le=100, description="Least free space around the target [m]."
    )
    distance: tuple[Reach, Reach] = Field(
        default=(4.0, 18.0), description="Distance of the target from the sensor [m]."
    )
    circle: tuple[Reach, Reach] = Field(default=(3.0, 6.0), description="Radius of the flight [m].")
    speed: tuple[Reach, Reach] = Field(default=(1.0, 4.0), description="Least and greatest [m/s].")
    range_std: float = Field(
        default=0.03, ge=0, le=1, description="Noise added to every range of a repeated scan [m]."
    )
    range_max: float = Field(
        default=100.0, gt=0, le=1e4, description="Largest range of the sensor [m]."
    )


@dataclass(frozen=True, slots=True)
class _Rays:
    """Rays of a scan: unit directions, and lengths [m]; infinite for rays without a hit."""

    directions: NDArray[np.float32]
    lengths: NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class _Circle:
    center: NDArray[np.float64]
    axes: NDArray[np.float64]  # (2, 3), each as long as the radius

    def at(self, angle: NDArray[np.float64]) -> NDArray[np.float64]:
        swing = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        return self.center + swing @ self.axes


def insert_target(
    scan: Scan,
    position: ArrayLike,
    *,
    radius: float | None = None,
    shape: Any = None,
    rotation: ArrayLike = UPRIGHT,
    range_min: float = 0.0,
    range_max: float,
    range_std: float,
    pattern: RayPattern | None = None,
    rng: np.random.Generator,
) -> tuple[Scan, NDArray[np.bool_]]:
    """Put a solid into a scan: rays that would hit it before their return end on it.

    Parameters
    ----------
    scan : Scan
        Real scan. Entries of NaN stay without information; only in organised clouds without a mask
        they are rays without return.
    position : array_like, shape (3,) or (N, 3), float64
        Centre [m], lidar frame; one per ray if it moves during the scan.
    radius : float, optional
        Radius of a sphere [m].
    shape : Solid, (vertices, faces), or a mesh, optional
        Instead of the sphere: a shape of `lidar_core.sim`, arrays (V, 3) and (F, 3), or an object
        that has them, such as a mesh of trimesh.
    rotation : array_like, shape (4,), float64
        Attitude of the shape in the lidar frame (x, y, z, w).
    range_min, range_max : float
        Range limits of the sensor [m]: nearer surfaces hide what is behind them but give no return;
        no ray reaches further.
    range_std : float
        Standard deviation of the ranges to the solid [m].
    pattern : RayPattern, optional
        Directions of rays whose points the driver dropped or wrote as zeros. Without it, only rays
        in the scan can hit the solid.
    rng : numpy.random.Generator
        Source of the noise.

    Returns
    -------
    scan : Scan
        The scan with the solid. If the driver dropped points, new points are at the end, and hidden
        points are missing.
    is_hit : ndarray, shape (N,), bool
        True for points of that scan on the solid.

    Raises
    ------
    InputError
        Wrong shape of an array, or neither or both of `radius` and `shape`.
    """
    if (radius is None) == (shape is None):
        raise InputError("radius, shape: expected one of them")
    count = scan.points.reshape(-1, 3).shape
    centre = as_real(position, name="position").astype(np.float64)
    if centre.shape not in {(3,), count}:
        raise InputError(f"position: expected shape (3,) or {count}, got {centre.shape}")
    target = SolidTarget(Sphere(radius=radius) if radius is not None else shape)
    done = _insert_solid(
        scan,
        target,
        centre,
        as_real(rotation, name="rotation"),
        (range_min, range_max),
        range_std,
        pattern,
        rng,
    )
    return done.scan, done.is_hit


def _insert_solid(
    scan: Scan,
    target: SolidTarget,
    centre: NDArray[np.float64],
    rotation: NDArray[Any],
    range_limits: tuple[float, float],
    range_std: float,
    pattern: RayPattern | None,
    rng: np.random.Generator,
) -> Inserted:
    """Return `scan` with the solid at `centre` [m]: one position, or one per entry of the scan."""
    rays = rays_of(scan, STANDING, pattern, rng)
    places = np.broadcast_to(centre, (len(scan.points.reshape(-1, 3)), 3))[rays.near]
    attitudes = np.broadcast_to(np.asarray(rotation, np.float64), (len(places), 4))
    frames = inverse(poses(places, attitudes))
    points, ends, is_seen, count = Meeting(target, frames, range_limits, range_std).of(rays, rng)
    return written(scan, rays, points.astype(np.float32), ends, is_seen, count)


def with_target(
    scans: Sequence[Scan],
    flight: InsertedFlight | None = None,
    *,
    seed: int,
    shape: Any = None,
    pattern: RayPattern | None = None,
) -> Iterator[SimulatedScan]:
    """Repeat real scans of a sensor at rest, with a target that flies through them.

    Every repetition has new noise on its ranges. Circles are drawn until one lies wholly in
    space that the first scan shows as free.

    Parameters
    ----------
    scans : sequence of Scan
        Scans of one sensor, taken in turn.
    flight : InsertedFlight, optional
        The target and its flight.
    seed : int
        Seed of the flight and the noise.
    shape : Solid, (vertices, faces), or a mesh, optional
        Instead of a sphere, as for `insert_target`; within `flight.radius`.
    pattern : RayPattern, optional
        Rays that the scans leave out, as for `insert_target`.

    Yields
    ------
    SimulatedScan
        The scan with its truth; labels are 0 for recorded points and 1 for the target.

    Raises
    ------
    InputError
        No scans, or no circle is free.
    """
    flight = flight or InsertedFlight()
    if not scans:
        raise InputError("scans: expected at least one, got none")
    target = SolidTarget(Sphere(radius=flight.radius) if shape is None else shape)
    rng = np.random.default_rng([20240607, seed])
    circle = _free_circle(_rays(scans[0]), flight, rng)
    period_ns = round(1e9 / SCAN_RATE)
    for number in range(flight.scans):
        source = scans[number % len(scans)]
        scan = _retime(_noisy(source, flight.range_std, rng), number * period_ns)
        yield _simulated_scan(scan, circle, flight, period_ns, (target, pattern), rng)


def _simulated_scan(
    scan: Scan,
    circle: _Circle,
    flight: InsertedFlight,
    period_ns: int,
    what: tuple[SolidTarget, RayPattern | None],
    rng: np.random.Generator,
) -> SimulatedScan:
    """Return `scan` with the target in it, and the truth."""
    start = np.array([scan.stamp_ns * 1e-9])
    per_ray = start
    if scan.point_time_ns is not None:
        per_ray = np.asarray(scan.point_time_ns.reshape(-1) * 1e-9, np.float64)
    centre = circle.at(_angle(per_ray, circle, flight))
    position = circle.at(_angle(start, circle, flight))
    target, pattern = what
    done = _insert_solid(
        scan,
        target,
        centre,
        np.array(UPRIGHT),
        (0.0, flight.range_max),
        flight.range_std,
        pattern,
        rng,
    )
    step = 1e-3
    velocity = (circle.at(_angle(start + step, circle, flight)) - position) / step
    return SimulatedScan(
        scan=done.scan,
        world_from_lidar=np.eye(4),
        pose_stamps_ns=np.array([scan.stamp_ns, scan.stamp_ns + period_ns], np.int64),
        poses=np.stack([np.eye(4), np.eye(4)]),
        truth=truth_of_one(done, position[0], velocity[0], target.radius),
        label=labels_of(done),
    )


def _angle(
    seconds: NDArray[np.float64], circle: _Circle, flight: InsertedFlight
) -> NDArray[np.float64]:
    """Angle on the circle [rad] at times [s]; the speed varies between least and greatest value."""
    slow, fast = flight.speed
    rate = 2 * np.pi / SPEED_PERIOD
    way = (slow + fast) / 2 * seconds + (fast - slow) / 2 * np.sin(rate * seconds) / rate
    return np.asarray(way / np.linalg.norm(circle.axes[0]), np.float64)


def _rays(scan: Scan) -> _Rays:
    points = scan.points.reshape(-1, 3)
    lengths = np.linalg.norm(points, axis=1)
    is_point = np.isfinite(lengths) & (lengths > 0)
    directions = np.full_like(points, np.nan)
    directions[is_point] = points[is_point] / lengths[is_point, None]
    lengths[~is_point] = np.nan
    if scan.no_return is not None and scan.directions is not None:
        directions[scan.no_return] = scan.directions[scan.no_return]
        lengths[scan.no_return] = np.inf
    return _Rays(directions, lengths)


def _noisy(scan: Scan, range_std: float, rng: np.random.Generator) -> Scan:
    """Return `scan` with noise of `range_std` [m] along every ray."""
    points = scan.points.reshape(-1, 3)
    noise = rng.normal(0.0, range_std, len(points)).astype(np.float32)
    noisy = points + _rays(scan).directions * noise[:, None]
    return replace(scan, points=noisy.reshape(scan.points.shape))


def _retime(scan: Scan, stamp_ns: int) -> Scan:
    times = scan.point_time_ns
    return replace(
        scan,
        stamp_ns=stamp_ns,
        point_time_ns=None if times is None else times - scan.stamp_ns + stamp_ns,
    )


def _free_circle(rays: _Rays, flight: InsertedFlight, rng: np.random.Generator) -> _Circle:
    """Return the first of many random circles that lies completely in free, visible space."""
    for _ in range(PLACES_TO_TRY):
        circle = _random_circle(flight, rng)
        places = circle.at(np.linspace(0, 2 * np.pi, STEPS_ROUND, endpoint=False))
        distance = np.linalg.norm(places, axis=1)
        if (distance < flight.distance[0]).any() or (distance > flight.distance[1]).any():
            continue
        if all(_is_free(rays, place, flight) for place in places):
            return circle
    raise InputError(
        "scans: no free space for a flight in a circle; set a smaller `circle` or `clearance`"
    )


def _random_circle(flight: InsertedFlight, rng: np.random.Generator) -> _Circle:
    far = flight.distance[1]
    azimuth, tilt_azimuth = rng.uniform(-np.pi, np.pi, 2)
    tilt = np.deg2rad(rng.uniform(0, TILT_DEG))
    radius = rng.uniform(*flight.circle)
    away = rng.uniform(0, far)
    center = np.array(
        [away * np.cos(azimuth), away * np.sin(azimuth), rng.uniform(-0.3, 0.3) * far]
    )
    level = np.array([-np.sin(tilt_azimuth), np.cos(tilt_azimuth), 0.0])
    slope = np.array(
        [np.cos(tilt) * np.cos(tilt_azimuth), np.cos(tilt) * np.sin(tilt_azimuth), np.sin(tilt)]
    )
    return _Circle(center, radius * np.stack([level, slope]))


def _is_free(rays: _Rays, place: NDArray[np.float64], flight: InsertedFlight) -> bool:
    """Return whether rays surround the target at `place`, and all of them pass by it."""
    distance = float(np.linalg.norm(place))
    reach = flight.radius + flight.clearance
    along = rays.directions @ place.astype(np.float32)
    is_near = along > np.sqrt(max(distance**2 - reach**2, 0.0))
    passing = rays.lengths[is_near] > distance + reach
    if not passing.all() or not len(passing):
        return False
    # Around it on every side: in sight, and not at the edge of the field of view.
    aside = rays.directions[is_near] * distance - place.astype(np.float32)
    up = np.array([0, 0, 1], np.float32)
    return bool((aside @ up).max() > flight.radius and (aside @ up).min() < -flight.radius)
