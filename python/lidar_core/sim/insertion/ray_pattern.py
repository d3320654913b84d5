"""Pattern of the rays of a sensor, to find directions of rays without return."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lidar_core._core import SimScene, SimTrajectory
from lidar_core.errors import InputError
from lidar_core.messages import Scan
from lidar_core.sim.insertion.ray_density import RayDensity, angles_of, unit
from lidar_core.sim.lidar import LidarModel, Planar, Spinning

NEAREST_RETURN = 0.05
"""Points nearer than this are no returns: zeros, also after a motion correction [m]."""
MOST_ROWS, FEWEST_ROWS = 160, 4
ROW_BIN_DEG, ROW_SHARE = 0.1, 0.9
"""Rows show as peaks of a histogram of elevations that hold this share of all returns."""
RING_SPREAD_DEG = 0.3
"""Half of the returns of a ring lie within this if rings are rows of one elevation [deg]."""

SAME_RAY = 1e-4
"""Directions nearer than this to one another are returns of one ray [rad]."""
RUN = 4
"""Steps over which the step of a row is measured: some sensors fire in pairs (count)."""


@dataclass(frozen=True, slots=True)
class RayPattern:
    """Directions of a sensor's rays: rotating rows, or a density of rays per direction.

    Attributes
    ----------
    elevations : ndarray, shape (R,), float64
        Elevations of the rows [rad], in the order of `Scan.ring` if rings are known. None for a
        density.
    step : float
        Angle from one ray of a row to the next [rad].
    density : RayDensity or None
        Density of rays of a pattern that does not repeat.
    """

    elevations: NDArray[np.float64]
    step: float
    density: RayDensity | None = None

    @classmethod
    def of_scans(cls, scans: Sequence[Scan]) -> "RayPattern":
        """Estimate the pattern from scans of one sensor, in the frame of the sensor.

        The scans must not be deskewed. More scans also show directions in which the sensor has a
        return only now and then.

        Raises
        ------
        InputError
            The scans hold no returns.
        """
        found = [_returns(scan) for scan in scans]
        directions = [one for one, _ in found if len(one)]
        if not directions:
            raise InputError("scans: expected at least one scan with returns, got none")
        rings = [ring for one, ring in found if len(one)]
        elevations = _rings(directions, rings)
        if elevations is None:
            elevations = _rows(directions)
        if elevations is None:
            return cls(np.empty(0), 0.0, RayDensity.of_directions(directions))
        step = _step(
            [row_of(one, elevations, ring) for one, ring in zip(directions, rings, strict=True)],
            directions,
        )
        return cls(elevations, step)

    @classmethod
    def of_model(cls, lidar: LidarModel) -> "RayPattern":
        """Return the pattern of a model or preset; the azimuth at which its rows start stays open.

        Raises
        ------
        InputError
            The model is planar.
        """
        pattern = lidar.pattern
        if isinstance(pattern, Planar):
            raise InputError("lidar: expected a 3D one, got a planar one")
        if isinstance(pattern, Spinning):
            elevations = np.deg2rad(np.array(pattern.elevations_deg, np.float64))
            return cls(elevations, 2 * np.pi / pattern.columns)
        still = SimTrajectory(np.zeros(1, np.int64), np.eye(4)[None])
        empty = SimScene([], [], threads=1)
        sweeps = [
            empty.scan(lidar, still, start_ns=0, scan=scan, seed=0)[1].astype(np.float64)
            for scan in range(20)
        ]
        return cls(np.empty(0), 0.0, RayDensity.of_directions(sweeps))

    def missing(
        self,
        known: NDArray[np.float64],
        ring: NDArray[np.uint16] | None,
        rng: np.random.Generator,
        *,
        total: int | None = None,
    ) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Return directions (K, 3) of the pattern without a ray in `known` (M, 3), and their rows.

        Rows are -1 for a density; `total` is the number of missing rays if the cloud shows it.
        """
        if self.density is not None:
            lost = self.density.missing(known, rng, total=total)
            return lost, np.full(len(lost), -1, np.int64)
        row = row_of(known, self.elevations, ring)
        azimuth, elevation = angles_of(known)
        found = [
            self._gaps(number, azimuth[row == number], elevation[row == number], rng)
            for number in range(len(self.elevations))
        ]
        rows = np.repeat(np.arange(len(found)), [len(one) for one in found])
        return np.concatenate(found), rows

    def _gaps(
        self,
        number: int,
        azimuth: NDArray[np.float64],
        elevation: NDArray[np.float64],
        rng: np.random.Generator,
    ) -> NDArray[np.float64]:
        """Directions of missing rays of one row, evenly in every gap between returns."""
        if len(azimuth) == 0:
            turns = np.arange(round(2 * np.pi / self.step)) + rng.uniform()
            return unit(
                np.asarray(turns * self.step, np.float64),
                np.full(len(turns), self.elevations[number]),
            )
        order = np.argsort(azimuth, kind="stable")
        start, low = azimuth[order], elevation[order]
        gap = np.diff(start, append=start[0] + 2 * np.pi)
        # Less than two steps are none: sensors that fire in pairs have gaps of half and 1.5 steps.
        empty = np.maximum(np.floor(gap / self.step - 0.6).astype(np.int64), 0)
        at = np.repeat(np.arange(len(start)), empty)
        place = np.arange(len(at)) - np.repeat(np.cumsum(empty) - empty, empty) + 1
        share = place / (empty[at] + 1)
        after = (at + 1) % len(start)
        return unit(start[at] + share * gap[at], (1 - share) * low[at] + share * low[after])


def row_of(
    directions: NDArray[np.float64],
    elevations: NDArray[np.float64],
    ring: NDArray[np.uint16] | None,
) -> NDArray[np.int64]:
    """Row of every direction: its ring, or else the row of the nearest elevation."""
    if ring is not None and (not len(ring) or int(ring.max()) < len(elevations)):
        return ring.astype(np.int64)
    order = np.argsort(elevations)
    borders = (elevations[order][1:] + elevations[order][:-1]) / 2
    return np.asarray(order[np.searchsorted(borders, angles_of(directions)[1])], np.int64)


def is_return(points: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Return which points (N, 3) are returns, and not NaN, zeros or nearly zeros."""
    with np.errstate(invalid="ignore"):
        return np.asarray(np.linalg.norm(points, axis=1) > NEAREST_RETURN)


def _returns(scan: Scan) -> tuple[NDArray[np.float64], NDArray[np.uint16] | None]:
    points = scan.points.reshape(-1, 3)
    kept = is_return(points) & np.isfinite(points).all(axis=1)
    away = points[kept].astype(np.float64)
    ring = None if scan.ring is None else scan.ring.reshape(-1)[kept]
    return away / np.linalg.norm(away, axis=1, keepdims=True), ring


def _rings(
    directions: list[NDArray[np.float64]], rings: list[NDArray[np.uint16] | None]
) -> NDArray[np.float64] | None:
    """Elevations of the rings [rad]; None unless every ring has a single elevation."""
    known = [ring for ring in rings if ring is not None]
    if len(known) < len(rings) or not FEWEST_ROWS <= int(max(r.max() for r in known)) + 1 <= 4096:
        return None
    ring, elevation = np.concatenate(known), angles_of(np.concatenate(directions))[1]
    rows, spread = np.full(int(ring.max()) + 1, np.nan), []
    for number in np.unique(ring):
        low, middle, high = np.quantile(elevation[ring == number], (0.25, 0.5, 0.75))
        rows[number] = middle
        spread.append(high - low)
    if np.rad2deg(np.median(spread)) > RING_SPREAD_DEG:
        return None
    seen = np.flatnonzero(np.isfinite(rows))
    return np.asarray(np.interp(np.arange(len(rows)), seen, rows[seen]), np.float64)


def _rows(directions: list[NDArray[np.float64]]) -> NDArray[np.float64] | None:
    """Elevations of the rows [rad], peaks of a histogram; None without distinct peaks."""
    elevation = np.rad2deg(angles_of(np.concatenate(directions))[1])
    edges = np.arange(-90, 90 + ROW_BIN_DEG, ROW_BIN_DEG)
    counts = np.histogram(elevation, edges)[0]
    is_high = counts > 0.02 * counts.max()
    starts = np.flatnonzero(np.diff(is_high.astype(np.int8), prepend=0) == 1)
    ends = np.flatnonzero(np.diff(is_high.astype(np.int8), append=0) == -1) + 1
    in_peaks = sum(int(counts[a:b].sum()) for a, b in zip(starts, ends, strict=True))
    widest = float((ends - starts).max()) if len(starts) else np.inf
    narrowest_gap = float((starts[1:] - ends[:-1]).min()) if len(starts) > 1 else 0.0
    is_clean = in_peaks > ROW_SHARE * len(elevation) and narrowest_gap >= 0.3 * widest
    if not (FEWEST_ROWS <= len(starts) <= MOST_ROWS and is_clean):
        return None
    rows = [
        np.median(elevation[(elevation >= edges[a]) & (elevation < edges[b])])
        for a, b in zip(starts, ends, strict=True)
    ]
    return np.deg2rad(np.array(rows, np.float64))


def _step(rows: list[NDArray[np.int64]], directions: list[NDArray[np.float64]]) -> float:
    """Angle between neighbouring rays of a row [rad], from rays that returned side by side."""
    gaps = []
    for row, one in zip(rows, directions, strict=True):
        azimuth = angles_of(one)[0]
        order = np.lexsort([azimuth, row])
        # Another return of the same ray is no step.
        is_new = np.abs(np.diff(azimuth[order], prepend=-np.inf)) > SAME_RAY
        line, turned = row[order][is_new], azimuth[order][is_new]
        gap = (turned[RUN:] - turned[:-RUN]) / RUN
        gaps.append(gap[(line[RUN:] == line[:-RUN]) & (gap > 0)])
    every = np.concatenate(gaps)
    if not len(every):
        return float(np.deg2rad(0.2))
    return float(np.median(every[every < 1.5 * np.quantile(every, 0.1)]))
