"""Marks of pictures: scale bar, ring around an object, where the sensor is, sigma ellipses."""

from collections import Counter
from collections.abc import Hashable, Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_core.extras import require
from lidar_core.viz.drawing.frame import Window
from lidar_core.viz.figure import INK, PURPOSE

SIGMAS = 2.0
TRACK_COLOURS = (
    *("#0369a1", "#15803d", "#7e22ce", "#be185d", "#78350f", "#0f766e", "#4d7c0f"),
    *("#0891b2", "#c026d3", "#1e3a8a", "#a16207"),
)
"""Colours of tracks, in turn.

They differ from each other, from the colours of the classes of points, and from the orange of walls
and radar.
"""
WAY = "way"
"""Mark of the lines of tracks, by which tests find them."""
RING = 20.0
"""Diameter of the ring around an object [pixel]: a drone alone would be a few pixels."""
BAR = 0.22
"""Largest length of a scale bar, as a share of the width of the panel."""
GROUND = {"boxstyle": "round,pad=0.25", "facecolor": "white", "edgecolor": "none", "alpha": 0.8}


def colours_of(*frames: Iterable[Hashable]) -> dict[Any, str]:
    """Return the colour of every object of a picture, or of the frames of a film.

    Colours are given in the order of appearance. Those of objects that are in one frame differ, as
    far as there are enough colours. In a film, an object keeps its colour.

    Parameters
    ----------
    frames : iterables of hashable
        Names of the objects in each frame; a picture is one frame.
    """
    known = [list(dict.fromkeys(frame)) for frame in frames]
    last = {name: number for number, frame in enumerate(known) for name in frame}
    found: dict[Any, str] = {}
    for number, frame in enumerate(known):
        # Objects that have gone leave their colours to those that come.
        used = Counter(colour for name, colour in found.items() if last[name] >= number)
        for name in (name for name in frame if name not in found):
            found[name] = min(TRACK_COLOURS, key=lambda colour: used[colour])
            used[found[name]] += 1
    return found


def scale_bar(axes: Any, window: Window) -> None:
    """Draw a scale bar of a round length at the lower left."""
    width, height = window.high - window.low
    length = round_length(BAR * float(width))
    x, y = window.low + np.array([0.03 * width, 0.035 * height])
    ends = [x, x + length]
    for colour, thick in (("white", 5.0), (INK, 2.5)):
        axes.plot(ends, [y, y], color=colour, lw=thick, solid_capstyle="butt", zorder=9)
    axes.annotate(
        f"{length:g} m",
        (x + length / 2, y),
        xytext=(0, 4),
        textcoords="offset points",
        ha="center",
        va="bottom",
        fontsize=8,
        zorder=9,
        bbox=GROUND,
    )


def round_length(most: float) -> float:
    """Largest of 1, 2, 5, 10, ... that is at most `most`."""
    power = 10.0 ** np.floor(np.log10(most))
    return float(max(step * power for step in (1, 2, 5) if step * power <= most * (1 + 1e-9)))


def ring(axes: Any, place: NDArray[np.float64], colour: str, *, size: float = 0.0) -> bool:
    """Draw a ring of `RING` pixels around an object, unless an outline of `size` [m] shows it.

    Returns whether there is a ring.
    """
    pixels = np.ptp(axes.transData.transform([(0.0, 0.0), (size, 0.0)])[:, 0])
    if pixels >= RING:
        return False
    points = RING * 72 / axes.figure.dpi
    axes.plot(*place, "o", ms=points, mfc="none", mec=colour, mew=1.3, zorder=6)
    return True


def sensor_mark(axes: Any, window: Window, place: NDArray[np.float64]) -> None:
    """Draw a triangle at the sensor; if it is outside, an arrow at the border with the distance."""
    if window.holds(place):
        axes.plot(*place, marker="^", ms=9, color=INK, mec="white", zorder=6.5)
        return
    away = place - window.middle
    half = (window.high - window.low) / 2
    with np.errstate(divide="ignore"):
        border = window.middle + away * float(np.min(half / np.abs(away)))
    tip, tail = (window.middle + (border - window.middle) * share for share in (0.97, 0.86))
    axes.annotate(
        f"sensor, {np.hypot(*away):.0f} m",
        tip,
        tail,
        ha="center",
        va="center",
        fontsize=8,
        zorder=9,
        bbox=GROUND,
        arrowprops={"arrowstyle": "-|>", "color": INK, "lw": 1.5},
    )


def sigma_ellipse(
    axes: Any, place: NDArray[np.float64], covariance: NDArray[np.float64], colour: str
) -> None:
    """Draw the ellipse of `SIGMAS` standard deviations around a place [m]."""
    patches = require("matplotlib.patches", extra="plot", purpose=PURPOSE)
    values, vectors = np.linalg.eigh(covariance)
    width, height = 2 * SIGMAS * np.sqrt(np.maximum(values, 0))
    angle = float(np.degrees(np.arctan2(vectors[1, 0], vectors[0, 0])))
    ellipse = patches.Ellipse(place, width, height, angle=angle)
    ellipse.set(facecolor=(colour, 0.25), edgecolor=(colour, 0.9), lw=0.8, zorder=5.5)
    axes.add_patch(ellipse)
