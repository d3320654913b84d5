"""Placement of labels (IDs) beside tracks so that they do not overlap."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

FONT = 8.5
NUMBER = "number"
"""Mark of labels, by which tests find them."""
DIRECTIONS = 16
RADII = (18.0, 27.0, 38.0, 52.0, 70.0, 92.0, 120.0, 152.0, 190.0, 232.0)
"""Distances of a label from its object that are tried, nearest first [pixel]."""
GAP = 2.0
"""Smallest distance between two labels [pixel]."""
SHORT = 30.0
"""Labels further than this from their object get a line to it [pixel]."""


@dataclass(frozen=True, slots=True)
class Label:
    """Label beside the object that it belongs to, such as the ID of a track.

    Attributes
    ----------
    text : str
        Text of the label.
    place : ndarray, shape (2,), float64
        Place of the object in the world [m].
    colour : str
        Colour of the badge.
    opacity : float
        Opacity of the badge, 0 to 1.
    """

    text: str
    place: NDArray[np.float64]
    colour: str
    opacity: float = 1.0


def draw_labels(axes: Any, labels: Sequence[Label], ways: Sequence[NDArray[np.float64]]) -> None:
    """Draw labels as badges without overlap, and where possible beside the paths.

    Set the limits and the size of the panel before the call. A label whose object is outside is
    left out.

    Parameters
    ----------
    axes : Axes
        The panel.
    labels : sequence of Label
        The first ones get the better places.
    ways : sequence of ndarray, shape (N, 2)
        Lines that labels should not hide [m].
    """
    axes.apply_aspect()
    to_pixel = axes.transData.transform
    box = axes.get_window_extent()
    panel = np.array([[box.x0, box.y0], [box.x1, box.y1]])
    inside = [one for one in labels if _holds(panel, to_pixel(one.place))]
    rows = [np.asarray(way, float).reshape(-1, 2) for way in ways]
    lines = to_pixel(np.concatenate([np.empty((0, 2)), *rows]))
    sizes = [_size(one.text, axes.figure.dpi) for one in inside]
    anchors = [to_pixel(one.place) for one in inside]
    centres = place_boxes(anchors, sizes, lines, panel)
    per_pixel = 72 / axes.figure.dpi
    for one, anchor, centre in zip(inside, anchors, centres, strict=True):
        offset = (centre - anchor) * per_pixel
        far = np.hypot(*(centre - anchor)) > SHORT
        axes.annotate(
            one.text,
            one.place,
            xytext=tuple(offset),
            textcoords="offset points",
            ha="center",
            va="center",
            color="white",
            fontsize=FONT,
            fontweight="bold",
            zorder=8,
            gid=NUMBER,
            bbox={
                "boxstyle": "round,pad=0.22",
                "facecolor": (one.colour, one.opacity),
                "edgecolor": "white",
            },
            arrowprops={"arrowstyle": "-", "color": (one.colour, one.opacity), "lw": 0.9}
            if far
            else None,
        )


def place_boxes(
    anchors: Sequence[NDArray[np.float64]],
    sizes: Sequence[NDArray[np.float64]],
    lines: NDArray[np.float64],
    panel: NDArray[np.float64],
) -> list[NDArray[np.float64]]:
    """Centres of boxes near their anchors that do not overlap.

    Each box gets the place among the nearest free ones that hides the fewest points of `lines`. If
    no tried place is free, it overlaps others.

    Parameters
    ----------
    anchors, sizes : sequence of ndarray, shape (2,)
        Place that each box belongs to, and its width and height [pixel].
    lines : ndarray, shape (N, 2)
        Points to keep free [pixel].
    panel : ndarray, shape (2, 2)
        Corners within which boxes lie [pixel].
    """
    angles = 2 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS + np.pi / 4
    ways = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    taken: list[tuple[NDArray[np.float64], NDArray[np.float64]]] = []
    for anchor, size in zip(anchors, sizes, strict=True):
        best: tuple[int, NDArray[np.float64]] | None = None
        for radius in RADII:
            for way in ways:
                centre = anchor + radius * way
                if not _is_free(centre, size, taken, panel):
                    continue
                hidden = int((np.abs(lines - centre) <= size / 2).all(axis=1).sum())
                if best is None or hidden < best[0]:
                    best = hidden, centre
            if best is not None and best[0] == 0:
                break
        taken.append((anchor + RADII[0] * ways[0] if best is None else best[1], size))
    return [centre for centre, _ in taken]


def _is_free(
    centre: NDArray[np.float64],
    size: NDArray[np.float64],
    taken: Sequence[tuple[NDArray[np.float64], NDArray[np.float64]]],
    panel: NDArray[np.float64],
) -> bool:
    if not (_holds(panel, centre - size / 2) and _holds(panel, centre + size / 2)):
        return False
    return not any(
        (np.abs(centre - other) < (size + other_size) / 2 + GAP).all()
        for other, other_size in taken
    )


def _holds(panel: NDArray[np.float64], place: NDArray[np.float64]) -> bool:
    return bool(((place >= panel[0]) & (place <= panel[1])).all())


def _size(text: str, dpi: float) -> NDArray[np.float64]:
    """Width and height of a badge with digits [pixel], from the widths of DejaVu Sans Bold."""
    em = FONT * dpi / 72
    return np.array([em * (0.70 * len(text) + 0.6), em * 1.55])
