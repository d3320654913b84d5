"""Directions of rays without return, from the gaps between the rows of a cloud."""

import numpy as np
from numpy.typing import NDArray

from lidar_core.sim.insertion.ray_density import angles_of, unit

LONGEST_GAP = 12
"""Largest number of successive missing rays that are placed between their neighbours."""
BEND = 2.0
"""Largest ratio of the width of a gap to the width that its steps should give, or inverse."""


def grid_directions(known: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return directions (H*W, 3) of all cells of an organised cloud, from known ones (H, W, 3).

    Every row has one elevation and its own azimuth in column 0; columns are evenly spaced. Rows
    without any return are interpolated, or extrapolated, from those that have some.
    """
    rows, columns = known.shape[:2]
    azimuth, elevation = (one.reshape(rows, columns) for one in angles_of(known.reshape(-1, 3)))
    steps = np.angle(np.exp(1j * np.diff(azimuth, axis=1)))
    if not np.isfinite(steps).any():
        return np.full((rows * columns, 3), np.nan)
    step = float(np.nanmedian(steps))
    if abs(abs(step) * columns / (2 * np.pi) - 1) < 0.02:
        step = float(np.copysign(2 * np.pi / columns, step))  # one turn, exactly
    start = np.exp(1j * (azimuth - step * np.arange(columns)))
    seen = np.flatnonzero(np.isfinite(azimuth).any(axis=1))
    first = np.unwrap([float(np.angle(np.nanmean(start[row]))) for row in seen])
    level = np.array([float(np.nanmedian(elevation[row])) for row in seen])
    every = np.arange(rows)
    first, level = (_extend(every, seen, values) for values in (first, level))
    turned = first[:, None] + step * np.arange(columns)
    return unit(turned.ravel(), np.repeat(level, columns))


def between_neighbours(
    known: NDArray[np.float64],
    row: NDArray[np.int64],
    line: NDArray[np.int64],
    times: NDArray[np.int64] | None,
    *,
    rows_are_rays: bool,
) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.int64]]:
    """Find the rays missing in short gaps of lines, evenly between the rays before and after.

    A rosette draws lines: consecutive rays lie side by side. The number of missing rays follows
    from the indices in the cloud if every ray has an entry, else from the time, else from the width
    of the gap.

    Parameters
    ----------
    known : ndarray, shape (M, 3), float64
        Directions in the order of the cloud.
    row, line : ndarray, shape (M,), int64
        Index of each ray in the cloud, and the line of the sensor that it belongs to.
    times : ndarray, shape (M,), int64, optional
        Times of the rays [ns].
    rows_are_rays : bool
        Rays without return have entries of their own in the cloud.

    Returns
    -------
    directions, row, near : ndarray, shapes (K, 3), (K,) and (K,)
        Directions of the missing rays, their indices in the cloud (-1: no entry), and the index of
        the known ray before each.
    """
    found: list[tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.int64]]] = []
    lines = np.unique(line)
    for name in lines:
        at = np.flatnonzero(line == name)
        if len(at) < 2:
            continue
        place = row[at] // len(lines) if rows_are_rays else None
        time = None if times is None else times[at]
        found.append(_gaps(known[at], row[at], at, place, time, step=len(lines)))
    if not found:
        return np.empty((0, 3)), np.empty(0, np.int64), np.empty(0, np.int64)
    directions, rows, near = (np.concatenate(part) for part in zip(*found, strict=True))
    return directions, rows, near


def _gaps(
    known: NDArray[np.float64],
    row: NDArray[np.int64],
    index: NDArray[np.int64],
    place: NDArray[np.int64] | None,
    times: NDArray[np.int64] | None,
    *,
    step: int,
) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.int64]]:
    width = np.linalg.norm(np.diff(known, axis=0), axis=1)
    if place is not None:
        gap = np.diff(place)
    elif times is not None:
        beat = np.diff(times)
        gap = np.round(beat / max(float(np.median(beat)), 1.0)).astype(np.int64)
    else:
        gap = np.round(width / max(float(np.median(width)), 1e-9)).astype(np.int64)
    usual = float(np.median(width[gap == 1])) if (gap == 1).any() else 0.0
    way = usual * gap
    is_straight = (width <= BEND * way) & (width >= way / BEND)
    at = np.flatnonzero((gap > 1) & (gap <= LONGEST_GAP + 1) & is_straight)
    count = gap[at] - 1
    start = np.repeat(at, count)
    number = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count) + 1
    share = (number / gap[start])[:, None]
    between = (1 - share) * known[start] + share * known[start + 1]
    between /= np.linalg.norm(between, axis=1, keepdims=True)
    rows = row[start] + number * step if place is not None else np.full(len(start), -1, np.int64)
    return between, rows, index[start]


def _extend(
    every: NDArray[np.int64], seen: NDArray[np.int64], values: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Values at `every` place: linear between those `seen`, extrapolated by the mean slope."""
    found = np.interp(every, seen, values)
    if len(seen) > 1:
        slope = (values[-1] - values[0]) / (seen[-1] - seen[0])
        found += slope * (np.minimum(every - seen[0], 0) + np.maximum(every - seen[-1], 0))
    return np.asarray(found, np.float64)
