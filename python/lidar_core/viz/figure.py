"""Common style of all pictures, and saving of figures."""

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_core.errors import ConfigError
from lidar_core.extras import require
from lidar_core.io.files.atomic import written_whole

PURPOSE = "the picture"
INK, PALE = "#1f2933", "#9aa5b1"
DASHED = (0, (3, 2))


def write_figure(
    path: str | Path, draw: Callable[[Any], None], *, size: tuple[float, float], dpi: int = 110
) -> Path:
    """Let `draw` fill an empty matplotlib Figure, and write it as PNG atomically.

    Parameters
    ----------
    path : str or Path
        File to write.
    draw : callable
        Called with the Figure.
    size : (float, float)
        Width and height [inch].
    dpi : int
        Pixels per inch.

    Raises
    ------
    ConfigError
        The file does not end in .png.
    MissingExtraError
        matplotlib is not installed.
    """
    place = png_path(path)
    with figure_with_style(size=size, dpi=dpi) as figure:
        draw(figure)
        with written_whole(place) as temporary:
            figure.savefig(temporary, format="png")
    return place


def png_path(path: str | Path) -> Path:
    """Return the file of a picture.

    Raises
    ------
    ConfigError
        It does not end in .png: pictures are PNG.
    """
    place = Path(path)
    if place.suffix.lower() != ".png":
        raise ConfigError(f"{place}: expected a picture that ends in .png")
    return place


@contextmanager
def figure_with_style(*, size: tuple[float, float], dpi: int) -> Iterator[Any]:
    """Yield an empty matplotlib Figure; drawings in the block have the common style."""
    figures = require("matplotlib.figure", extra="plot", purpose=PURPOSE)
    canvas = require("matplotlib.backends.backend_agg", extra="plot", purpose=PURPOSE)
    style = require("matplotlib", extra="plot", purpose=PURPOSE)
    with style.rc_context({**_STYLE}):
        figure = figures.Figure(figsize=size, dpi=dpi, facecolor="white")
        canvas.FigureCanvasAgg(figure)
        yield figure


def two_columns(
    figure: Any,
    title: str,
    *,
    widths: tuple[float, float],
    heights: tuple[float, ...],
    **gaps: float,
) -> Any:
    """Add the title and return the grid: one column for a tall panel, one for the others."""
    edges = {"left": 0.06, "right": 0.985, "top": 0.9, "bottom": 0.08, "wspace": 0.16} | gaps
    figure.suptitle(title, x=edges["left"], y=0.975, ha="left", fontsize=13, fontweight="bold")
    return figure.add_gridspec(len(heights), 2, width_ratios=widths, height_ratios=heights, **edges)


def draw_truth(axes: Any, ways: Iterable[NDArray[np.float64]]) -> None:
    """Draw the true paths of the targets as dashed lines."""
    for order, way in enumerate(ways):
        label = None if order else "truth"
        axes.plot(*way.T, color="black", lw=1.1, ls=DASHED, zorder=6, label=label)


def opaque_legend(axes: Any, place: str, **more: Any) -> None:
    """Add a legend with an opaque background that is readable in front of points."""
    ground = {"frameon": True, "facecolor": "white", "framealpha": 0.88, "edgecolor": "none"}
    axes.legend(loc=place, fontsize=8, **ground, **more).set_zorder(9.5)


_STYLE = {
    "font.family": "DejaVu Sans",
    "font.size": 9,
    "axes.edgecolor": PALE,
    "axes.labelcolor": INK,
    "axes.titlesize": 10,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "xtick.color": INK,
    "ytick.color": INK,
    "text.color": INK,
    "grid.color": "#e6e8eb",
    "grid.linewidth": 0.6,
    "legend.frameon": False,
    "savefig.pad_inches": 0.1,
}
