"""Occupied voxels behind moving objects, as an image."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_core.extras import require
from lidar_core.viz.drawing.frame import Window
from lidar_core.viz.figure import PURPOSE

COLOURS = ("#efeae0", "#d8cfbd", "#a89f8d")
"""Colours of voxels, from far to near."""
MOST_CELLS = 2000
"""Largest number of cells of the image along a side: more than the picture has pixels."""


def visible_rows(
    rows: NDArray[np.float64], plane: tuple[int, int], window: Window, depth: tuple[float, float]
) -> NDArray[np.float64]:
    """Return the points `rows` in the window whose third coordinate is within `depth` [m]."""
    low, high = np.empty(3), np.empty(3)
    low[list(plane)], high[list(plane)] = window.low, window.high
    low[3 - sum(plane)], high[3 - sum(plane)] = depth
    return rows[((rows >= low) & (rows <= high)).all(axis=1)]


def draw_voxels(
    axes: Any,
    centres: NDArray[np.float64],
    size: float,
    plane: tuple[int, int],
    window: Window,
    depth: tuple[float, float],
) -> None:
    """Draw occupied voxels of edge `size` [m]: the nearer to the viewer, the darker.

    In a window of more than `MOST_CELLS` voxels along a side, several share a cell of the image.
    """
    colours = require("matplotlib.colors", extra="plot", purpose=PURPOSE)
    towards = 1 if plane[1] == 1 else -1  # seen from above, and from the side of negative y
    rows = visible_rows(centres, plane, window, depth)
    size = max(size, float((window.high - window.low).max()) / MOST_CELLS)
    cells = np.floor((rows[:, list(plane)] - window.low) / size).astype(np.intp)
    shape = np.ceil((window.high - window.low) / size).astype(np.intp) + 1
    image = np.full(shape, np.nan)
    near = towards * rows[:, 3 - sum(plane)]
    np.fmax.at(image, (cells[:, 0], cells[:, 1]), near)
    corner = window.low + size * shape
    axes.imshow(
        image.T,
        extent=(window.low[0], corner[0], window.low[1], corner[1]),
        cmap=colours.LinearSegmentedColormap.from_list("voxels", COLOURS),
        vmin=near.min(initial=0.0),
        vmax=near.max(initial=1.0),
        origin="lower",
        interpolation="nearest",
        zorder=1,
    )
    axes.scatter([], [], s=24, marker="s", c=COLOURS[1], label="occupied voxels")
