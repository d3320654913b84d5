"""Estimate of the rays per direction of a sensor whose pattern does not repeat."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

CELL_DEG = 1.0
"""Size of a cell of azimuth and elevation [deg]."""
TURNED_DEG, SECTOR = 300.0, 20
"""A sensor turns if its returns span this; azimuth is compared in sectors of so many cells."""
LOCAL = 6
"""Cells to either side in which the density of a sensor that does not turn is compared."""
FULL = 0.8
"""Quantile of the sectors that counts as seen without loss."""
WHOLE = 0.6
"""Share of the median around from which a cell counts as seen without loss."""
ENOUGH = 10.0
"""Expected rays around a direction by which its share of lost ones is judged (count)."""
CERTAIN = 0.3
"""A share of lost rays below this is the scatter of counts, not open sky (no unit)."""

PACE, BAND = 8, 5
"""Cells to either side, and elevations, over which the rays of one scan are compared (count)."""
RETURNING = 0.55
"""Azimuths whose fullest elevations return less than this share are open sky (no unit)."""


@dataclass(frozen=True, slots=True)
class RayDensity:
    """Rays of a scan per cell of azimuth (columns, from -180 deg) and elevation (rows, from -90).

    Attributes
    ----------
    rays : ndarray, shape (180, 360), float64
        Expected rays of one scan per cell.
    """

    rays: NDArray[np.float64]

    @classmethod
    def of_directions(cls, scans: Sequence[NDArray[np.float64]]) -> "RayDensity":
        """Estimate from the directions (M, 3) of the returns of some scans, sensor frame."""
        counts = np.mean([_count_per_cell(one) for one in scans], axis=0)
        turns = (counts.sum(axis=0) > 0).sum() * CELL_DEG > TURNED_DEG
        return cls(_alike_in_azimuth(counts) if turns else _alike_around(counts))

    def missing(
        self, known: NDArray[np.float64], rng: np.random.Generator, *, total: int | None = None
    ) -> NDArray[np.float64]:
        """Draw the directions of rays missing in `known` (M, 3); `total` is their number, if given.

        Cells have no missing rays if their surroundings contain nearly as many rays as expected.
        """
        counts = _count_per_cell(known)
        rays = self.rays * self._pace(counts)
        share = _lost_share(rays, counts)
        wanted = rays * share * (share > CERTAIN)
        if total is not None and wanted.sum() > 0:
            wanted *= min(total / wanted.sum(), 1.0)  # more: out of what is known of the pattern
        drawn = np.floor(wanted + rng.uniform(size=wanted.shape)).astype(np.int64)
        rows, columns = np.nonzero(drawn)
        times = drawn[rows, columns]
        rows, columns = np.repeat(rows, times), np.repeat(columns, times)
        place = rng.uniform(size=(2, len(rows)))
        elevation = np.deg2rad((rows + place[0]) * CELL_DEG - 90)
        azimuth = np.deg2rad((columns + place[1]) * CELL_DEG - 180)
        return unit(azimuth, elevation)

    def _pace(self, counts: NDArray[np.float64]) -> NDArray[np.float64]:
        """Ratio of the rays of this scan to those of the mean scan, per azimuth.

        It is not 1 because a scan ends within a turn. It comes from the elevation band with the
        most returns; it is 1 where even this band loses many.
        """
        bands = [
            _along(one, PACE).reshape(-1, BAND, one.shape[1]).sum(axis=1)
            for one in (self.rays, counts)
        ]
        usable = bands[0] >= 2 * ENOUGH
        expected = np.maximum(bands[0], 1e-9)
        ratio = bands[1] / expected
        # The largest of several counts is too large; less by its scatter it is about right.
        surely = np.where(usable, ratio - np.sqrt(ratio / expected), 0.0)
        best = surely.max(axis=0)
        return np.where(best > RETURNING, best, 1.0)


def _lost_share(rays: NDArray[np.float64], counts: NDArray[np.float64]) -> NDArray[np.float64]:
    """Share of lost rays around each cell, in the smallest area with enough expected rays."""
    share = np.zeros_like(counts)
    judged = np.zeros(counts.shape, bool)
    for reach in (0, 1, 2, 4):
        expected, found = _box(rays, reach), _box(counts, reach)
        now = (expected >= ENOUGH if reach < 4 else expected > 0) & ~judged
        share[now] = 1 - found[now] / expected[now]
        judged |= now
    return share


def unit(azimuth: NDArray[np.float64], elevation: NDArray[np.float64]) -> NDArray[np.float64]:
    """Unit directions (M, 3) of angles [rad]."""
    flat = np.cos(elevation)
    return np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)], axis=-1)


def angles_of(directions: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Azimuth and elevation of directions (M, 3) [rad]."""
    x, y, z = directions.T
    return np.arctan2(y, x), np.arctan2(z, np.hypot(x, y))


def _count_per_cell(directions: NDArray[np.float64]) -> NDArray[np.float64]:
    azimuth, elevation = angles_of(directions)
    shape = (round(180 / CELL_DEG), round(360 / CELL_DEG))
    row = np.clip((np.rad2deg(elevation) + 90) / CELL_DEG, 0, shape[0] - 1).astype(np.int64)
    column = ((np.rad2deg(azimuth) + 180) / CELL_DEG).astype(np.int64) % shape[1]
    flat = np.bincount(row * shape[1] + column, minlength=shape[0] * shape[1])
    return flat.reshape(shape).astype(np.float64)


def _alike_in_azimuth(counts: NDArray[np.float64]) -> NDArray[np.float64]:
    """Make the density equal in every azimuth: take that of the fuller sectors with returns."""
    sectors = counts.reshape(len(counts), -1, SECTOR).mean(axis=2)
    full = np.zeros(len(counts))
    for row, found in enumerate(sectors):
        if (found > 0).any():
            full[row] = np.quantile(found[found > 0], FULL)
    return np.repeat(full[:, None], counts.shape[1], axis=1)


def _alike_around(counts: NDArray[np.float64]) -> NDArray[np.float64]:
    """Density in the hull of all returns: of the cell, or around it if the cell has lost rays."""
    smooth = _box(counts, 1) / _box(np.ones_like(counts), 1)
    density = np.zeros_like(counts)
    for row, column in zip(*np.nonzero(_hull(counts > 0)), strict=True):
        rows = slice(max(row - LOCAL, 0), row + LOCAL + 1)
        columns = np.arange(column - LOCAL, column + LOCAL + 1) % counts.shape[1]
        around = smooth[rows][:, columns]
        around = around[around > 0]
        if len(around):
            middle, own = float(np.median(around)), float(smooth[row, column])
            density[row, column] = own if own > WHOLE * middle else middle
    return density


def _hull(is_seen: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return which cells lie in the convex hull of the cells with returns."""
    rows, columns = np.nonzero(is_seen)
    places = sorted(zip(columns.tolist(), rows.tolist(), strict=True))
    edge = _chain(places) + _chain(places[::-1])
    y, x = np.mgrid[: is_seen.shape[0], : is_seen.shape[1]]
    inside = np.ones(is_seen.shape, bool)
    for (x0, y0), (x1, y1) in zip(edge, edge[1:] + edge[:1], strict=True):
        inside &= (x1 - x0) * (y - y0) - (y1 - y0) * (x - x0) >= 0
    return inside


def _chain(places: list[tuple[int, int]]) -> list[tuple[int, int]]:
    """Half of a convex hull, counter-clockwise, without its last corner (Andrew 1979)."""
    chain: list[tuple[int, int]] = []
    for x, y in places:
        while len(chain) > 1:
            (x0, y0), (x1, y1) = chain[-2:]
            if (x1 - x0) * (y - y0) - (y1 - y0) * (x - x0) > 0:
                break
            chain.pop()
        chain.append((x, y))
    return chain[:-1]


def _box(values: NDArray[np.float64], reach: int) -> NDArray[np.float64]:
    """Sum over the cells up to `reach` cells away; the azimuth is periodic."""
    if reach == 0:
        return values
    total = np.zeros_like(values)
    padded = np.pad(values, ((reach, reach), (0, 0)))
    for step in range(2 * reach + 1):
        total += padded[step : step + len(values)]
    return _along(total, reach)


def _along(values: NDArray[np.float64], reach: int) -> NDArray[np.float64]:
    """Sum over the cells up to `reach` cells away in azimuth, which is periodic."""
    total = np.zeros_like(values)
    for shift in range(-reach, reach + 1):
        total += np.roll(values, shift, axis=1)
    return total
