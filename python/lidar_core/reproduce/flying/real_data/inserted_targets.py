"""Flying targets put into real scans: where they fly, and the returns that they give.

Rays that a driver dropped have no direction; they are filled in by the pattern that the scans show.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lidar_core.errors import InputError
from lidar_core.io import PosedScan
from lidar_core.messages import Scan
from lidar_core.reproduce.flying.real_data.sequences import RealSequence
from lidar_core.sim import Hexacopter, Quadcopter, RayPattern, Sphere
from lidar_core.sim.insertion.inserted import SolidTarget
from lidar_core.sim.solids.shapes import Solid

DISTANCES, CLEARANCE, EDGE_DEG = (3.0, 15.0), 1.0, 5.0
"""Of a target from the sensor and from every return [m], and from the edge of the view [deg]."""
SWING, SPEED, TILT_DEG = (0.2, 0.8), (1.0, 2.0), 15.0
"""Radius of the circle on which a target flies [m], its speed [m/s], its greatest tilt [deg]."""
APART = 1.0
"""Circles of one run from each other, at least [m]."""
RANGE_STD = 0.02
FEWEST, SEEN_SHARE = 3, 0.8
"""Returns that make a target visible, and the share of scans in which it has to be."""
TRIES = 4000
CELL = 0.15
"""Points of a scan are thinned to one in a cube of this edge to test clearances [m]."""
GROUND_PERCENTILE = 3.0
"""Of the heights of the thinned points: no target flies below, where no ray came back [%]."""
PATTERN_SCANS = 10
"""Scans from which the pattern of the rays is taken."""
NEAREST = 0.25
"""Nearer points are placeholders for no return [m]."""
GAP_S = 2.0
"""After a gap of the recording this long a target starts over where it was [s]."""


TARGETS: dict[str, Solid] = {
    "sphere": Sphere(radius=0.325),
    "hexacopter": Hexacopter(radius=0.325),
    "quadcopter": Quadcopter(radius=0.25),
}
"""Targets of one run, by name."""


@dataclass(frozen=True, slots=True)
class Flight:
    """Circular flight around a centre with a constant offset from the sensor, like an escort.

    Attributes
    ----------
    offset : ndarray, shape (3,)
        Centre of the circle from the sensor's place, axes of the world [m].
    axes : ndarray, shape (2, 3)
        Axes of the circle; their length is its radius [m].
    rate : float
        Angular velocity [rad/s].
    """

    offset: NDArray[np.float64]
    axes: NDArray[np.float64]
    rate: float

    def at(self, sensor: NDArray[np.float64], seconds: float) -> NDArray[np.float64]:
        """Position of the target in the world [m], for the place of the sensor and a time [s]."""
        angle = self.rate * seconds
        return np.asarray(
            sensor + self.offset + np.cos(angle) * self.axes[0] + np.sin(angle) * self.axes[1]
        )


@dataclass(frozen=True, slots=True)
class RealScan:
    """A scan with its rays.

    Attributes
    ----------
    item : PosedScan
        Scan of the recording.
    pose : ndarray, shape (4, 4)
        Pose of the LiDAR in the world.
    seconds : float
        Time of flight of the targets.
    directions, lengths : ndarray, shape (R, 3), (R,)
        Rays: those of the cloud's rows, NaN without return, then lost ones, infinitely long.
    rings : ndarray, shape (R,)
        Row of every ray, where rows are numbered.
    thinned : ndarray, shape (K, 3)
        Returns that can be near a target, thinned to one per small cube.
    ground : float
        Height below which hardly any return lies [m].
    """

    item: PosedScan[Scan]
    pose: NDArray[np.float64]
    seconds: float
    directions: NDArray[np.float32]
    lengths: NDArray[np.float32]
    rings: NDArray[np.uint16]
    thinned: NDArray[np.float32]
    ground: float

    @classmethod
    def of(
        cls, item: PosedScan[Scan], seconds: float, pattern: RayPattern, rng: np.random.Generator
    ) -> "RealScan":
        """Make a `RealScan` from a scan: measured rays and, by the pattern, the lost ones."""
        points = item.scan.points.reshape(-1, 3)
        lengths = np.linalg.norm(points, axis=1)
        with np.errstate(invalid="ignore"):
            lengths[~(lengths > NEAREST)] = np.nan
            directions = points / lengths[:, None]
            near = points[lengths < DISTANCES[1] + CLEARANCE + 1.0]
        is_met = np.isfinite(lengths)
        ring, no_return = item.scan.ring, item.scan.no_return
        lost, rows = pattern.missing(
            directions[is_met].astype(np.float64),
            None if ring is None else ring[is_met],
            rng,
            total=None if no_return is None else int(no_return.sum()),
        )
        rings = np.zeros(len(points), np.uint16) if ring is None else ring
        directions = np.concatenate([directions, lost.astype(np.float32)])
        lengths = np.concatenate([lengths, np.full(len(lost), np.inf, np.float32)])
        rings = np.concatenate([rings, np.maximum(rows, 0).astype(np.uint16)])
        _, first = np.unique(np.floor(near / CELL).astype(np.int64), axis=0, return_index=True)
        pose = np.asarray(item.world_from_lidar.reshape(-1, 4, 4)[0])
        ground = float(np.percentile(near[first, 2], GROUND_PERCENTILE))
        return cls(item, pose, seconds, directions, lengths, rings, near[first], ground)

    def around(self, centre: NDArray[np.float64], radius: float) -> NDArray[np.int64]:
        """Indices of the rays whose direction meets a sphere (`centre`, `radius`, sensor frame)."""
        distance = float(np.linalg.norm(centre))
        cosine = np.sqrt(max(1 - (radius / distance) ** 2, 0.0))
        along = self.directions @ (centre / distance).astype(np.float32)
        return np.flatnonzero(along >= cosine)

    def to_sensor(self, world: NDArray[np.float64]) -> NDArray[np.float64]:
        """Transform a position in the world into the sensor's frame [m]."""
        return np.asarray(self.pose[:3, :3].T @ (world - self.pose[:3, 3]))

    def count_hits(self, body: SolidTarget, centre: NDArray[np.float64]) -> tuple[int, bool]:
        """Count the rays that hit a target; return also whether something hides it."""
        near = self.around(centre, body.radius)
        if (self.lengths[near] < np.linalg.norm(centre)).any():
            return 0, True
        way = _ways(body, self.directions[near], centre)
        return int(np.isfinite(way).sum()), False


def _ways(
    body: SolidTarget, directions: NDArray[np.float32], centre: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Distances [m] along rays from the sensor to an upright body; infinite for rays that miss."""
    origins = np.broadcast_to(-centre, directions.shape)
    return body.distances(np.ascontiguousarray(origins), directions.astype(np.float64))


def real_scans(items: Sequence[PosedScan[Scan]]) -> list[RealScan]:
    """Scans of a sequence with their rays; a target waits while the recording has a long gap."""
    stamps = np.array([item.scan.stamp_ns for item in items]) * 1e-9
    steps = np.diff(stamps, prepend=stamps[0])
    seconds = np.cumsum(np.where(steps > GAP_S, 0.1, steps)).tolist()
    some = items[:: max(1, len(items) // PATTERN_SCANS)]  # from all over the sequence
    rng = np.random.default_rng(20240607)
    pattern = RayPattern.of_scans([item.scan for item in some])
    return [RealScan.of(item, t, pattern, rng) for item, t in zip(items, seconds, strict=True)]


def with_targets(
    scans: Sequence[RealScan],
    flights: dict[str, Flight],
    sequence: RealSequence,
    rng: np.random.Generator,
) -> tuple[list[PosedScan[Scan]], NDArray[np.float64], NDArray[np.int64]]:
    """Put targets into scans; return scans, target positions (S, T, 3) [m] and returns (S, T).

    There is one column for each of `TARGETS`. Targets without a flight have the position NaN and
    no returns.
    """
    columns = [list(TARGETS).index(name) for name in flights]
    places = np.full((len(scans), len(TARGETS), 3), np.nan)
    hits = np.zeros((len(scans), len(TARGETS)), np.int64)
    made, solids = [], {name: SolidTarget(TARGETS[name]) for name in flights}
    for number, scan in enumerate(scans):
        bodies = []
        for column, (name, flight) in zip(columns, flights.items(), strict=True):
            places[number, column] = flight.at(scan.pose[:3, 3], scan.seconds)
            bodies.append((solids[name], scan.to_sensor(places[number, column])))
        changed, hits[number, columns] = inserted(scan, bodies, sequence.range_max, rng)
        made.append(replace(scan.item, scan=changed))
    return made, places, hits


def inserted(
    scan: RealScan,
    bodies: Sequence[tuple[SolidTarget, NDArray[np.float64]]],
    range_max: float,
    rng: np.random.Generator,
) -> tuple[Scan, NDArray[np.int64]]:
    """Put targets, each with its place in the sensor's frame [m], into a scan.

    Returns the scan and the number of returns of each target. Lost rays that hit a target get
    rows at the end of the cloud.
    """
    lengths = scan.lengths.copy()
    hits = np.zeros(len(bodies), np.int64)
    for column, (body, centre) in enumerate(bodies):
        near = scan.around(centre, body.radius)
        way = _ways(body, scan.directions[near], centre)
        is_hit = (way < lengths[near]) & (way <= range_max)
        hits[column] = is_hit.sum()
        lengths[near[is_hit]] = way[is_hit] + rng.normal(0.0, RANGE_STD, hits[column])
    return _with_lengths(scan, lengths), hits


def _with_lengths(scan: RealScan, lengths: NDArray[np.float32]) -> Scan:
    """Return the scan with new lengths of its rays; lost rays that now have one are added."""
    source = scan.item.scan
    points = source.points.reshape(-1, 3).copy()
    count = len(points)
    changed = np.flatnonzero(lengths[:count] != scan.lengths[:count])
    changed = changed[np.isfinite(lengths[changed])]
    points[changed] = scan.directions[changed] * lengths[changed, None]
    back = count + np.flatnonzero(np.isfinite(lengths[count:]))
    if not len(back):
        return replace(source, points=points.reshape(source.points.shape))
    more = scan.directions[back] * lengths[back, None]
    if source.no_return is not None:
        marked = np.flatnonzero(source.no_return)[: len(back)]
        points[marked] = more[: len(marked)]
        no_return = source.no_return.copy()
        no_return[marked] = False
        return replace(source, points=points.reshape(source.points.shape), no_return=no_return)
    intensity = source.intensity
    return replace(
        source,
        points=np.concatenate([points, more]),
        ring=np.concatenate([scan.rings[:count], scan.rings[back]]),
        intensity=None if intensity is None else _pad(intensity, len(back)),
    )


def _pad(intensity: NDArray[np.float32], count: int) -> NDArray[np.float32]:
    """Append `count` usual values to the intensities."""
    return np.concatenate([intensity, np.full(count, np.nanmedian(intensity), np.float32)])


def drawn_flights(
    scans: Sequence[RealScan], sequence: RealSequence, rng: np.random.Generator
) -> dict[str, Flight]:
    """Draw one flight for each shape, in sight and clear of all returns in every scan.

    Nothing but the geometry of the recording chooses them. In small rooms a shape may find no
    place beside the others, and is left out.

    Raises
    ------
    InputError
        No place was found for any shape.
    """
    flights: dict[str, Flight] = {}
    for name, shape in TARGETS.items():
        body = SolidTarget(shape)
        for _ in range(TRIES):
            flight = _candidate(scans[0], rng)
            is_apart = all(_are_apart(flight, one) for one in flights.values())
            if is_apart and _is_free(flight, body, scans, sequence):
                flights[name] = flight
                break
    if not flights:
        raise InputError(f"{sequence.name}: no free place for a target in {TRIES} draws")
    return flights


def _are_apart(one: Flight, other: Flight) -> bool:
    reach = float(np.linalg.norm(one.axes[0]) + np.linalg.norm(other.axes[0]))
    return float(np.linalg.norm(one.offset - other.offset)) > reach + APART


def _candidate(scan: RealScan, rng: np.random.Generator) -> Flight:
    """Draw a random circle with its centre on a ray of `scan`, in front of the return."""
    far = DISTANCES[1] + CLEARANCE
    while True:
        ray = rng.integers(len(scan.lengths))
        reach = min(float(scan.lengths[ray]), far) - CLEARANCE
        if reach > DISTANCES[0]:
            break
    distance, radius = rng.uniform(DISTANCES[0], reach), rng.uniform(*SWING)
    offset = distance * (scan.pose[:3, :3] @ scan.directions[ray])
    turn, tilt = rng.uniform(0, 2 * np.pi), np.deg2rad(rng.uniform(-TILT_DEG, TILT_DEG))
    ahead = np.array([np.cos(turn), np.sin(turn), 0.0])
    aside = np.array([-np.sin(turn), np.cos(turn), 0.0]) * np.cos(tilt)
    aside[2] = np.sin(tilt)
    rate = float(rng.choice([-1, 1]) * rng.uniform(*SPEED) / radius)
    return Flight(offset, radius * np.stack([ahead, aside]), rate)


def _is_free(
    flight: Flight, body: SolidTarget, scans: Sequence[RealScan], sequence: RealSequence
) -> bool:
    """Return whether rays hit the target in the scans and it is away from all returns."""
    centres = [scan.to_sensor(flight.at(scan.pose[:3, 3], scan.seconds)) for scan in scans]
    if not all(_is_in_view(centre, sequence) for centre in centres):
        return False
    if not all(_is_clear(scan, centre) for scan, centre in zip(scans, centres, strict=True)):
        return False
    needed, seen = SEEN_SHARE * len(scans), 0
    for number, (scan, centre) in enumerate(zip(scans, centres, strict=True)):
        count, is_hidden = scan.count_hits(body, centre)
        seen += count >= FEWEST
        if is_hidden or seen + len(scans) - number - 1 < needed:
            return False
    return True


def _is_clear(scan: RealScan, centre: NDArray[np.float64]) -> bool:
    """Return whether a place is above the ground and away from every return."""
    if centre[2] < scan.ground + CLEARANCE:
        return False
    away = np.linalg.norm(scan.thinned - centre.astype(np.float32), axis=1)
    return bool(away.min(initial=np.inf) >= CLEARANCE + CELL)


def _is_in_view(centre: NDArray[np.float64], sequence: RealSequence) -> bool:
    distance = float(np.linalg.norm(centre))
    if not DISTANCES[0] <= distance <= DISTANCES[1]:
        return False
    elevation = np.rad2deg(np.arcsin(centre[2] / distance))
    azimuth = np.rad2deg(np.arctan2(centre[1], centre[0]))
    low, high = sequence.elevation_deg
    left, right = sequence.azimuth_deg
    is_aside = right - left >= 360 or left + EDGE_DEG <= azimuth <= right - EDGE_DEG
    return bool(is_aside and low + EDGE_DEG <= elevation <= high - EDGE_DEG)
