"""One time of a run as PNG, or the run as a film, with matplotlib; needs no display."""

from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_core.errors import FormatError
from lidar_core.io.write.circle_scene import ellipse
from lidar_core.messages import ShownClass
from lidar_core.viz.figure import INK, PALE, write_figure
from lidar_core.viz.film import write_film
from lidar_core.viz.playback import Moment, Playback

SIZE, DPI = (12.0, 6.0), 90
FILM_DPI = 70
POINT_COLOURS = {
    ShownClass.INVALID: "#94a3b8",
    ShownClass.BACKGROUND: "#94a3b8",
    ShownClass.FLYING: "#dc2626",
    ShownClass.UNKNOWN: "#d97706",
    ShownClass.MOVING: "#2563eb",
    ShownClass.OWN_BODY: "#a855f7",
}
"""Colours of points by class; INVALID is that of points without one."""
OBJECT, BAND, WALL = "#c2410c", "#0369a1", "#0f766e"
SIGMAS, CORNERS = 2.0, 36
TRAIL = 50  # positions of an object that stay in view
MOST_POINTS = 40_000
SLOWEST = 0.05  # drawn with an arrow, as long as the way of one second [m/s]
BULK, MARGIN, SMALLEST = (0.02, 0.98), 1.0, 4.0  # of what is shown: quantiles, [m], [m]
PLANES = ((0, 1, "x", "y"), (0, 2, "x", "z"))


def draw_moment(run: Playback, path: str | Path, *, at: float | None = None) -> Path:
    """Draw the scan and the objects at one time, from above and, in 3D, from the side.

    Parameters
    ----------
    run : Playback
        The run.
    path : str or Path
        PNG to write, whole or not at all.
    at : float, optional
        Time since the start [s]; without it the last time with a scan.

    Raises
    ------
    FormatError
        A run without scans and estimates.
    MissingExtraError
        matplotlib is not installed.
    """
    shown = [(moment, trails) for moment, trails in _moments_with_trails(run) if len(moment.points)]
    shown = shown or list(_moments_with_trails(run))
    if not shown:
        raise FormatError(f"{run.folder}: neither scans nor estimates to draw")
    first = shown[0][0].stamp_ns
    seconds = [(moment.stamp_ns - first) * 1e-9 for moment, _ in shown]
    number = len(shown) - 1 if at is None else int(np.argmin(np.abs(np.array(seconds) - at)))
    moment, trails = shown[number]
    limits = _limits([moment])
    return write_figure(
        path,
        lambda figure: _compose(figure, run, moment, trails, seconds[number], limits),
        size=SIZE,
        dpi=DPI,
    )


def draw_film(run: Playback, path: str | Path, *, frames: int = 200, rate: float = 10.0) -> Path:
    """Draw a run over time.

    Parameters
    ----------
    run : Playback
        The run.
    path : str or Path
        .gif, or .mp4 where ffmpeg is installed; written whole or not at all.
    frames : int
        At most, evenly picked.
    rate : float
        Frames per second [Hz].

    Raises
    ------
    ConfigError
        Another ending.
    FormatError
        A run without scans and estimates.
    MissingExtraError
        matplotlib or, for .mp4, ffmpeg is not installed.
    """
    followed = list(_moments_with_trails(run))
    kept = [one for one in followed if len(one[0].points)] or followed
    if not kept:
        raise FormatError(f"{run.folder}: neither scans nor estimates to draw")
    picked = kept[:: max(1, -(-len(kept) // frames))]
    limits = _limits([moment for moment, _ in picked])

    def paint(figure: Any) -> Iterator[None]:
        for moment, trails in picked:
            figure.clear()
            seconds = (moment.stamp_ns - kept[0][0].stamp_ns) * 1e-9
            _compose(figure, run, moment, trails, seconds, limits)
            yield

    return write_film(path, paint, size=SIZE, dpi=FILM_DPI, rate=rate)


Trails = dict[int, NDArray[np.float64]]


def _moments_with_trails(run: Playback) -> Iterator[tuple[Moment, Trails]]:
    """Moments with the last positions of every object in them."""
    trails: dict[int, list[NDArray[np.float64]]] = defaultdict(list)
    for moment in run.moments():
        for name, position in zip(moment.objects.id.tolist(), moment.objects.position, strict=True):
            trails[name] = [*trails[name][1 - TRAIL :], position]
        names = moment.objects.id.tolist()
        yield moment, {name: np.array(trails[name]) for name in names}


def _limits(moments: list[Moment]) -> NDArray[np.float64]:
    """Corners (2, 3) of the visible area: most of the points or outlines, and every object."""
    points = np.concatenate([moment.points[::20] for moment in moments]).astype(np.float64)
    outlines = [one.points for moment in moments for one in moment.outlines]
    if outlines and not len(points):
        points = np.concatenate(outlines)
    objects = np.concatenate([moment.objects.position for moment in moments])
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    if len(points):
        low, high = np.quantile(points, BULK, axis=0)
    if len(objects):
        low, high = np.minimum(low, objects.min(axis=0)), np.maximum(high, objects.max(axis=0))
    if not np.isfinite(low).all():
        low, high = np.zeros(3), np.zeros(3)
    middle, half = (low + high) / 2, np.maximum((high - low) / 2 + MARGIN, SMALLEST / 2)
    return np.stack([middle - half, middle + half])


def _compose(
    figure: Any,
    run: Playback,
    moment: Moment,
    trails: Trails,
    seconds: float,
    limits: NDArray[np.float64],
) -> None:
    figure.set_layout_engine("constrained")
    planes = PLANES if run.capability == "flying" else PLANES[:1]
    panels = figure.subplots(1, len(planes), squeeze=False)[0]
    count = len(moment.objects.id)
    figure.suptitle(
        f"{run.folder.name}: {seconds:.2f} s, {count} object{'' if count == 1 else 's'}",
        x=0.06,
        ha="left",
        fontweight="bold",
    )
    for panel, plane in zip(panels, planes, strict=True):
        _draw_plane(panel, moment, trails, plane, limits)


def _draw_plane(
    panel: Any,
    moment: Moment,
    trails: Trails,
    plane: tuple[int, int, str, str],
    limits: NDArray[np.float64],
) -> None:
    across, up, *labels = plane
    axes = [across, up]
    step = max(1, len(moment.points) // MOST_POINTS)
    points, classes = moment.points[::step], moment.point_class[::step]
    for kind, colour in POINT_COLOURS.items():
        chosen = points[classes == kind]
        if kind != ShownClass.INVALID and len(chosen):
            name = kind.name.lower().replace("_", " ")
            panel.plot([], [], ".", ms=6, color=colour, label=name)
        panel.plot(
            chosen[:, across],
            chosen[:, up],
            ".",
            ms=1 + 2 * (kind > ShownClass.BACKGROUND),
            color=colour,
            rasterized=True,
        )
    for outline in moment.outlines:
        line = outline.points[:, axes]
        panel.plot(*line.T, "-" if outline.visible else ":", lw=2.0, color=WALL)
    for row, name in enumerate(moment.objects.id.tolist()):
        _draw_object(panel, moment, row, axes, trails[name])
    panel.set(
        xlabel=f"{labels[0]} [m]",
        ylabel=f"{labels[1]} [m]",
        aspect="equal",
        xlim=limits[:, across],
        ylim=limits[:, up],
    )
    panel.grid(visible=True)
    if panel.get_legend_handles_labels()[1]:
        panel.legend(loc="upper right", fontsize=8)


def _draw_object(
    panel: Any, moment: Moment, row: int, axes: list[int], trail: NDArray[np.float64]
) -> None:
    objects = moment.objects
    at, velocity = objects.position[row][axes], objects.velocity[row][axes]
    panel.plot(trail[:, axes[0]], trail[:, axes[1]], "-", lw=1.2, color=OBJECT, alpha=0.7)
    sides = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1], [-1, -1]]) / 2 * objects.size[row][axes]
    around = objects.outline(row)[:, axes] if axes == [0, 1] else at + sides
    panel.plot(around[:, 0], around[:, 1], "-", lw=1.2, color=OBJECT)
    band = at + ellipse(objects.covariance[row][np.ix_(axes, axes)], SIGMAS, CORNERS)
    panel.plot(*np.vstack([band, band[:1]]).T, "-", lw=1.0, color=BAND)
    if np.linalg.norm(velocity) > SLOWEST:
        panel.annotate("", at + velocity, at, arrowprops={"arrowstyle": "->", "color": INK})
    panel.annotate(
        str(objects.id[row]),
        at,
        xytext=(5, 5),
        textcoords="offset points",
        color=INK,
        fontsize=9,
        bbox={"fc": "white", "ec": PALE, "lw": 0.5, "pad": 1.5},
        annotation_clip=True,
    )
