"""Picture of a run of the flying-object detector, with matplotlib."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_core.extras import require
from lidar_core.messages import ShownClass
from lidar_core.objects import Tracks
from lidar_core.viz.figure import (
    INK,
    PALE,
    PURPOSE,
    draw_truth,
    opaque_legend,
    two_columns,
    write_figure,
)
from lidar_core.viz.views import FlyingView

SIZE, DPI = (14.0, 8.2), 110
FLYING, UNKNOWN, OWN = "#fb7185", "#f59e0b", "#a855f7"
VOXEL_COLOURS = ("#efeae0", "#d8cfbd", "#a89f8d")
CLOUDS = (
    ("background, last scan", "#64748b", 0.6),
    ("unknown, last scan", UNKNOWN, 2.5),
    ("own body, last scan", OWN, 2.5),
    ("flying, all scans", FLYING, 1.0),
)
"""Name, colour and size of the points of each class."""
TRACK_COLOURS = ("#0369a1", "#15803d", "#7e22ce", "#b45309", "#be185d", "#0f766e", "#4d7c0f")
MOST_POINTS = 40_000  # drawn of a cloud or map: more only makes the picture heavy
MARGIN = 9.0  # around sensor, tracks and targets [m]
SMALLEST = 36.0  # least width and height of what is shown [m]
ELLIPSES = 8  # at most, per track
SIGMAS = 2.0


def draw_flying(view: FlyingView, path: str | Path) -> Path:
    """Draw a run from above and from the side, over time, into a PNG file.

    Parameters
    ----------
    view : FlyingView
        What to show.
    path : str or Path
        File to write, whole or not at all.

    Returns
    -------
    path : Path

    Raises
    ------
    MissingExtraError
        matplotlib is not installed.
    """
    return write_figure(path, lambda figure: _compose(figure, view), size=SIZE, dpi=DPI)


def _compose(figure: Any, view: FlyingView) -> None:
    gaps = {"left": 0.045, "bottom": 0.065, "wspace": 0.1, "hspace": 0.4}
    grid = two_columns(figure, view.title, widths=(1.15, 1.0), heights=(1.25, 1.0, 0.8), **gaps)
    low, high = _limits(view)
    above, side = figure.add_subplot(grid[:, 0]), figure.add_subplot(grid[0, 1])
    _map(above, view, (0, 1), low, high)
    above.set(title="from above", xlabel="x [m]", ylabel="y [m]")
    opaque_legend(above, "upper left", ncols=2, labelspacing=0.35)
    _map(side, view, (0, 2), low, high)
    side.set(title="from the side", xlabel="x [m]", ylabel="z [m]")
    _distances(figure.add_subplot(grid[1, 1]), view)
    last = figure.add_subplot(grid[2, 1])
    if view.recall:
        _recall(last, view)
    else:
        _counts(last, view)
    last.set_xlabel("time [s]")


def _limits(view: FlyingView) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Corners of the visible area: sensor, tracks and targets, with the map around them."""
    things = [view.sensor, *(tracks.position for tracks in view.tracks), *view.truth.values()]
    focus = np.concatenate([rows[np.isfinite(rows).all(axis=1)] for rows in things])
    if not len(focus):
        focus = np.zeros((1, 3))
    low, high = focus.min(axis=0), focus.max(axis=0)
    grow = np.maximum(MARGIN, (SMALLEST - (high - low)) / 2)
    low, high = low - grow, high + grow
    around = np.concatenate([view.occupied, view.cloud])
    around = around[((around >= low) & (around <= high)).all(axis=1)]
    if len(around):  # no empty space below the ground or above the roofs
        bottom, top = np.percentile(around[:, 2], (0.2, 99.8))
        low[2] = min(focus[:, 2].min() - 1, bottom - 0.5)
        high[2] = max(focus[:, 2].max() + 1, top + 0.5)
    return low, high


def _visible_rows(
    rows: NDArray[np.float64], low: NDArray[np.float64], high: NDArray[np.float64]
) -> NDArray[np.float64]:
    """At most `MOST_POINTS` rows inside the picture, evenly picked."""
    inside = rows[((rows >= low) & (rows <= high)).all(axis=1)]
    return inside[:: max(1, -(-len(inside) // MOST_POINTS))]


def _map(
    axes: Any,
    view: FlyingView,
    plane: tuple[int, int],
    low: NDArray[np.float64],
    high: NDArray[np.float64],
) -> None:
    """Cloud, map, ways and tracks, projected onto the axes `plane`."""
    across, up = plane
    _voxels(axes, view, plane, low, high)
    for cloud, (name, colour, size) in zip(_by_class(view), CLOUDS, strict=True):
        if colour == OWN and not len(cloud):
            continue  # most robots hide nothing
        rows = _visible_rows(cloud, low, high)
        axes.scatter(
            rows[:, across], rows[:, up], s=size, c=colour, linewidths=0, zorder=2, rasterized=True
        )
        axes.scatter([], [], s=24, c=colour, linewidths=0, label=name)
    axes.plot(
        view.sensor[:, across], view.sensor[:, up], color=INK, lw=1.6, zorder=4, label="sensor"
    )
    if len(view.sensor):
        axes.plot(*view.sensor[-1, list(plane)], marker="^", ms=8, color=INK, zorder=4)
    draw_truth(axes, (way[:, list(plane)] for way in view.truth.values()))
    _tracks(axes, view, plane)
    axes.set(
        aspect="equal",
        adjustable="box",
        anchor="NW",
        xlim=(low[across], high[across]),
        ylim=(low[up], high[up]),
    )
    axes.grid(visible=True)


def _by_class(view: FlyingView) -> list[NDArray[np.float64]]:
    """Points in the order of `CLOUDS`."""
    classes = ShownClass.BACKGROUND, ShownClass.UNKNOWN, ShownClass.OWN_BODY
    return [*(view.cloud[view.cloud_class == one] for one in classes), view.flying]


def _voxels(
    axes: Any,
    view: FlyingView,
    plane: tuple[int, int],
    low: NDArray[np.float64],
    high: NDArray[np.float64],
) -> None:
    """Occupied voxels as an image: the nearer to the viewer, the darker."""
    colours = require("matplotlib.colors", extra="plot", purpose=PURPOSE)
    across, up = plane
    depth = 3 - across - up
    towards = 1 if up == 1 else -1  # seen from above, and from the side of negative y
    rows = view.occupied[((view.occupied >= low) & (view.occupied <= high)).all(axis=1)]
    cells = np.floor((rows[:, list(plane)] - low[list(plane)]) / view.voxel_size).astype(np.intp)
    shape = np.ceil((high - low)[list(plane)] / view.voxel_size).astype(np.intp) + 1
    image = np.full(shape, np.nan)
    np.fmax.at(image, (cells[:, 0], cells[:, 1]), towards * rows[:, depth])
    corner = low[list(plane)] + view.voxel_size * shape
    axes.imshow(
        image.T,
        extent=(low[across], corner[0], low[up], corner[1]),
        cmap=colours.LinearSegmentedColormap.from_list("voxels", VOXEL_COLOURS),
        vmin=min(towards * low[depth], towards * high[depth]),
        vmax=max(towards * low[depth], towards * high[depth]),
        origin="lower",
        interpolation="nearest",
        zorder=1,
    )
    axes.scatter([], [], s=24, marker="s", c=VOXEL_COLOURS[1], label="occupied voxels")


def _tracks(axes: Any, view: FlyingView, plane: tuple[int, int]) -> None:
    across, up = plane
    for order, (number, rows) in enumerate(_by_track(view).items()):
        colour = TRACK_COLOURS[order % len(TRACK_COLOURS)]
        way = np.array([view.tracks[scan].position[row] for scan, row in rows])
        axes.plot(
            way[:, across],
            way[:, up],
            color=colour,
            lw=2.0,
            zorder=5,
            label="track, 2σ ellipses" if order == 0 else None,
        )
        every = max(1, -(-len(rows) // ELLIPSES))
        for scan, row in rows[::-every]:
            _ellipse(axes, view.tracks[scan], row, plane, colour)
        badge = {"boxstyle": "round,pad=0.25", "facecolor": colour, "edgecolor": "white"}
        axes.annotate(
            f"{number}",
            way[-1, list(plane)],
            xytext=(9, 9),
            textcoords="offset points",
            color="white",
            fontsize=9,
            fontweight="bold",
            zorder=8,
            bbox=badge,
        )


def _ellipse(axes: Any, tracks: Tracks, row: int, plane: tuple[int, int], colour: str) -> None:
    """Projected ellipse of `SIGMAS` standard deviations around the track."""
    patches = require("matplotlib.patches", extra="plot", purpose=PURPOSE)
    values, vectors = np.linalg.eigh(tracks.covariance[row][np.ix_(plane, plane)])
    width, height = 2 * SIGMAS * np.sqrt(np.maximum(values, 0))
    angle = float(np.degrees(np.arctan2(vectors[1, 0], vectors[0, 0])))
    ellipse = patches.Ellipse(tracks.position[row][list(plane)], width, height, angle=angle)
    ellipse.set(facecolor=(colour, 0.25), edgecolor=(colour, 0.9), lw=0.8, zorder=5.5)
    axes.add_patch(ellipse)


def _by_track(view: FlyingView) -> dict[int, list[tuple[int, int]]]:
    """Per track, where its states are: scan and row."""
    found: dict[int, list[tuple[int, int]]] = {}
    for scan, tracks in enumerate(view.tracks):
        for row, number in enumerate(tracks.id.tolist()):
            found.setdefault(number, []).append((scan, row))
    return dict(sorted(found.items()))


def _seconds(view: FlyingView, stamps: NDArray[np.int64]) -> NDArray[np.float64]:
    return (stamps - (view.stamp_ns[0] if len(view.stamp_ns) else 0)) * 1e-9


def _distances(axes: Any, view: FlyingView) -> None:
    """Distance of tracks and targets from the sensor, over time."""
    time = _seconds(view, view.stamp_ns)
    for way in view.truth.values():
        distance = np.linalg.norm(way - view.sensor, axis=1)
        axes.plot(time, distance, color="black", lw=1.0, ls=(0, (4, 3)), zorder=6)
    for order, (number, rows) in enumerate(_by_track(view).items()):
        scans = [scan for scan, _ in rows]
        way = np.array([view.tracks[scan].position[row] for scan, row in rows])
        distance = np.linalg.norm(way - view.sensor[scans], axis=1)
        colour = TRACK_COLOURS[order % len(TRACK_COLOURS)]
        axes.plot(time[scans], distance, color=colour, lw=2.2, label=f"track {number}", zorder=5)
    axes.set(title="distance from the sensor", ylabel="[m]", xlim=_span(time), ylim=(0, None))
    axes.grid(visible=True)
    handles, labels = axes.get_legend_handles_labels()
    if 0 < len(labels) <= len(TRACK_COLOURS):
        axes.legend(handles, labels, fontsize=8, loc="lower left", ncols=4)
    if not labels:
        axes.text(0.5, 0.5, "no tracks", transform=axes.transAxes, ha="center", color=PALE)


def _recall(axes: Any, view: FlyingView) -> None:
    styles = ((TRACK_COLOURS[0], 1.8, 3), (UNKNOWN, 4.0, 2))
    for (name, (stamps, share)), (colour, width, order) in zip(
        view.recall.items(), styles, strict=False
    ):
        axes.plot(
            _seconds(view, stamps),
            share,
            color=colour,
            lw=width,
            label=name,
            zorder=order,
            drawstyle="steps-mid",
        )
    axes.set(
        title="share of the sighted targets that were found",
        xlim=_span(_seconds(view, view.stamp_ns)),
        ylim=(-0.05, 1.08),
    )
    axes.grid(visible=True)
    axes.legend(fontsize=8, loc="lower left", ncols=2)


def _counts(axes: Any, view: FlyingView) -> None:
    time = _seconds(view, view.stamp_ns)
    tracks = [len(item.id) for item in view.tracks]
    axes.plot(
        time, view.n_detections, color=UNKNOWN, lw=1.4, label="detections", drawstyle="steps-mid"
    )
    axes.plot(time, tracks, color=TRACK_COLOURS[0], lw=2.0, label="tracks", drawstyle="steps-mid")
    top = max([1, *tracks, *view.n_detections.tolist()])
    axes.set(title="detections and tracks per scan", xlim=_span(time), ylim=(-0.1 * top, 1.2 * top))
    axes.grid(visible=True)
    axes.legend(fontsize=8, loc="upper left", ncols=2)


def _span(time: NDArray[np.float64]) -> tuple[float, float]:
    last = float(time[-1]) if len(time) else 0.0
    return (0.0, last if last > 0 else 1.0)
