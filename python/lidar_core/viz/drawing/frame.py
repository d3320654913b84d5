"""The part of the world that a picture shows, with moving objects in its middle."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_core.geometry import cluster_points

TIMES = 3.0
"""Ratio of the size of a picture to the extent of moving objects: the rest shows surroundings."""
MOVER_TIMES = 2.0
"""Same for what moves on the ground, often all around the sensor: a legend leaves it in sight."""
MOST_TIMES = 5.0
"""Largest ratio if the picture grows to show the sensor."""
SMALLEST = 8.0
"""Smallest size of the shown part of the world [m]."""
MOST_EXTENDED = 1.6
"""Largest factor by which a picture of a map grows to have moving objects in its middle third."""
THIRD = 2.8
"""One over the share from the border to the middle third, with some reserve."""
EDGE = 1.2
"""Factor for a margin at the border if the picture grows to show further places."""
LEGEND = 0.25
"""Largest share of the height that a legend takes, on half of the width."""
BULK = (0.02, 0.98)
"""Quantiles of the points between which a picture without moving objects extends."""
NEIGHBOUR, FEWEST = 2.0, 5
"""Largest step from a point of a mover to the next one [m], and least number of its points."""


@dataclass(frozen=True, slots=True)
class Window:
    """A rectangle of the world.

    Attributes
    ----------
    low, high : ndarray, shape (2,), float64
        Corners [m].
    """

    low: NDArray[np.float64]
    high: NDArray[np.float64]

    @property
    def middle(self) -> NDArray[np.float64]:
        """Centre of the window (2,) [m]."""
        return (self.low + self.high) / 2

    def holds(self, place: NDArray[np.float64]) -> bool:
        """True if a place is inside."""
        return bool(((place >= self.low) & (place <= self.high)).all())

    def corner_away_from(self, places: Iterable[NDArray[np.float64]]) -> str:
        """Name of the corner with the fewest places, for a legend; the upper left if all are equal.

        The lower left is never chosen: the scale bar is there. A place outside counts at the
        nearest point of the border, because an arrow there points to it.
        """
        rows = np.clip((_finite(places) - self.low) / (self.high - self.low), 0.0, 1.0)
        is_right, is_top, is_low = rows[:, 0] > 0.5, rows[:, 1] > 1 - LEGEND, rows[:, 1] < LEGEND
        held = {
            "upper left": ~is_right & is_top,
            "upper right": is_right & is_top,
            "lower right": is_right & is_low,
        }
        return min(held, key=lambda corner: int(held[corner].sum()))

    def apply(self, axes: Any) -> None:
        """Set the limits of a panel of the same shape to this part of the world."""
        axes.set_aspect("equal", adjustable="box")
        axes.set_xlim(self.low[0], self.high[0])
        axes.set_ylim(self.low[1], self.high[1])


def window_around(
    moving: Iterable[NDArray[np.float64]],
    tall: float,
    *,
    movers: Iterable[NDArray[np.float64]] = (),
    also: Iterable[NDArray[np.float64]] = (),
    times: float = TIMES,
    smallest: float = SMALLEST,
) -> Window:
    """Return a rectangle with all that moves in its middle.

    It is `times` as large as the range of moving objects, and `MOVER_TIMES` as large as that of
    these and `movers` together. It grows until it shows `also`, but at most by `MOST_TIMES` over
    `TIMES`, so that what moves stays visible.

    Parameters
    ----------
    moving, movers, also : iterable of ndarray, shape (N, 2)
        Places [m] of tracked objects, of what moves on the ground, and of what is shown if it is
        near; rows that are not finite are left out.
    tall : float
        Height of the panel over its width.
    times : float
        Size of the rectangle over that of `moving`.
    smallest : float
        Least width and height [m].

    Returns
    -------
    window : Window
    """
    seen, walks, rest = _finite(moving), _finite(movers), _finite(also)
    both, shape = np.concatenate([seen, walks]), np.array([1.0, tall])
    focus = both if len(both) else rest
    if not len(focus):
        focus = np.zeros((1, 2))
    middle = (focus.min(axis=0) + focus.max(axis=0)) / 2
    least = max(_width(seen if len(both) else focus, shape) * times, smallest / min(1.0, tall))
    if len(walks):
        least = max(least, _width(both, shape) * MOVER_TIMES)
    most = least / times * max(times, MOST_TIMES)
    reach = 2 * np.abs(rest - middle).max(axis=0, initial=0.0) / shape * EDGE
    half = min(max(least, float(reach.max())), most) * shape / 2
    return Window(middle - half, middle + half)


def window_over(
    places: Iterable[NDArray[np.float64]],
    tall: float,
    *,
    smallest: float,
    moving: Iterable[NDArray[np.float64]] = (),
) -> Window:
    """Rectangle that shows all places, with some room around them.

    It is extended, by at most `MOST_EXTENDED`, until the centre of moving objects is in its middle
    third.

    Parameters
    ----------
    places, moving : iterable of ndarray, shape (N, 2)
        Coordinates [m]; rows that are not finite are left out.
    tall : float
        Height of the panel over its width.
    smallest : float
        Least width and height [m].

    Returns
    -------
    window : Window
    """
    tight = window_around(places, tall, times=1.12, smallest=smallest)
    seen = _finite(moving)
    if not len(seen):
        return tight
    rows = np.concatenate([_finite(places), seen])
    room = 0.06 * (rows.max(axis=0) - rows.min(axis=0)).max()
    low, high = rows.min(axis=0) - room, rows.max(axis=0) + room
    centre = (seen.min(axis=0) + seen.max(axis=0)) / 2
    size = MOST_EXTENDED * (high - low)
    wider_low = np.maximum(np.minimum(low, (THIRD * centre - high) / (THIRD - 1)), high - size)
    wider_high = np.minimum(np.maximum(high, (THIRD * centre - low) / (THIRD - 1)), low + size)
    return window_around([wider_low, wider_high], tall, times=1.0, smallest=smallest)


def bulk_of(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Corners (2, K) of the box that holds most points (N, K); shape (0, K) without points."""
    points = points[np.isfinite(points).all(axis=1)]
    if not len(points):
        return np.empty((0, points.shape[1]))
    return np.asarray(np.quantile(points, BULK, axis=0))


def box_of_movers(points: NDArray[np.floating]) -> NDArray[np.float64]:
    """Corners (2, 3) of the box around points (N, 3) that move on the ground; (0, 3) without any.

    A point belongs to it only if it is one of at least `FEWEST` with steps of at most `NEIGHBOUR`:
    a stray one far away does not count.
    """
    labels = cluster_points(points, max_distance=NEIGHBOUR, min_points=FEWEST)
    found = np.asarray(points, np.float64)[labels >= 0]
    return np.stack([found.min(axis=0), found.max(axis=0)]) if len(found) else np.empty((0, 3))


def panel_tallness(axes: Any) -> float:
    """Height of a panel over its width, as laid out, before an aspect shrinks it."""
    width, height = axes.figure.get_size_inches()
    place = axes.get_subplotspec().get_position(axes.figure)
    return float(place.height * height / (place.width * width))


def _width(rows: NDArray[np.float64], shape: NDArray[np.float64]) -> float:
    """Width of the smallest rectangle of the shape (width 1, height) that holds the rows [m]."""
    return float((np.ptp(rows, axis=0) / shape).max()) if len(rows) else 0.0


def _finite(parts: Iterable[NDArray[np.float64]]) -> NDArray[np.float64]:
    rows = np.concatenate(
        [np.empty((0, 2)), *(np.asarray(part, float).reshape(-1, 2) for part in parts)]
    )
    kept: NDArray[np.float64] = rows[np.isfinite(rows).all(axis=1)]
    return kept
