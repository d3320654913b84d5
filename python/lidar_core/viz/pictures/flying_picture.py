"""Picture of a run of the flying-object detector, with matplotlib."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_core.messages import ShownClass
from lidar_core.viz.drawing.frame import (
    Window,
    box_of_movers,
    bulk_of,
    panel_tallness,
    window_around,
    window_over,
)
from lidar_core.viz.drawing.labels import Label, draw_labels
from lidar_core.viz.drawing.marks import (
    TRACK_COLOURS,
    WAY,
    colours_of,
    ring,
    scale_bar,
    sensor_mark,
    sigma_ellipse,
)
from lidar_core.viz.drawing.thinning import evenly, thinned
from lidar_core.viz.drawing.voxels import draw_voxels, visible_rows
from lidar_core.viz.figure import (
    INK,
    PALE,
    draw_truth,
    opaque_legend,
    two_columns,
    write_figure,
)
from lidar_core.viz.views import FlyingView

SIZE, DPI = (14.0, 8.2), 110
FLYING, UNKNOWN, OWN, MOVING = "#fb7185", "#f59e0b", "#a855f7", "#2563eb"
CLOUDS = (
    (ShownClass.BACKGROUND, "background, last scan", "#64748b", 0.6),
    (ShownClass.UNKNOWN, "unknown, last scan", UNKNOWN, 2.5),
    (ShownClass.OWN_BODY, "own body, last scan", OWN, 2.5),
    (ShownClass.MOVING, "moving on the ground, all scans", MOVING, 1.5),
    (ShownClass.FLYING, "flying, all scans", FLYING, 1.0),
)
"""Name, colour and size of the points of each class."""
MOST_POINTS = 40_000  # drawn of each class: more only makes the picture heavy
SMALLEST = 4.0  # width of what is shown where there are no tracks [m]
MOST_LABELS = 8  # in the legend: more hide the curves
MOST_NUMBERS = 40  # tracks with a number beside them, the longest
ELLIPSES = 8  # at most, per track


def draw_flying(view: FlyingView, path: str | Path) -> Path:
    """Draw a run from above and from the side, over time, into a PNG file.

    Parameters
    ----------
    view : FlyingView
        Content of the picture.
    path : str or Path
        File to write atomically.

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
    gaps = {"left": 0.055, "bottom": 0.065, "wspace": 0.1, "hspace": 0.4}
    grid = two_columns(figure, view.title, widths=(1.15, 1.0), heights=(1.4, 0.9, 0.8), **gaps)
    above, side = figure.add_subplot(grid[:, 0]), figure.add_subplot(grid[0, 1])
    plan, elevation = (
        _window(view, (0, up), panel_tallness(at)) for up, at in ((1, above), (2, side))
    )
    _map(above, view, (0, 1), plan, depth=(elevation.low[1], elevation.high[1]))
    time = _seconds(view, view.stamp_ns)
    span = f", 0 to {time[-1]:.1f} s" if len(time) else ""
    above.set(title=f"from above{span}", xlabel="x [m]", ylabel="y [m]")
    corner = plan.corner_away_from(_in_sight(view, plan))
    opaque_legend(above, corner, ncols=2, labelspacing=0.35)
    _map(side, view, (0, 2), elevation, depth=(plan.low[1], plan.high[1]))
    side.set(title="from the side", xlabel="x [m]", ylabel="z [m]")
    _distances(figure.add_subplot(grid[1, 1]), view)
    last = figure.add_subplot(grid[2, 1])
    if view.recall:
        _recall(last, view)
    else:
        _counts(last, view)
    last.set_xlabel("time [s]")


def _window(view: FlyingView, plane: tuple[int, int], tall: float) -> Window:
    """Return the window of a panel around tracks, else targets, and what moves on the ground.

    It includes the sensor if that is near. If nothing moves, it shows the sensor and most points
    of the last scan.
    """
    columns = list(plane)
    tracks = [item.position[:, columns] for item in view.tracks]
    moving = tracks if sum(map(len, tracks)) else [way[:, columns] for way in view.truth.values()]
    movers, sensor = box_of_movers(view.moving)[:, columns], view.sensor[-1:, columns]
    if not sum(map(len, moving)) + len(movers):
        known = view.cloud if len(view.cloud) else view.occupied
        return window_over([bulk_of(known)[:, columns], sensor], tall, smallest=SMALLEST)
    return window_around(moving, tall, movers=[movers], also=[sensor])


def _in_sight(view: FlyingView, plan: Window) -> list[NDArray[np.float64]]:
    """Places that a legend should not hide: the sensor's path, and its last position."""
    way = view.sensor[:, :2]
    seen = ((way >= plan.low) & (way <= plan.high)).all(axis=1)
    return [way[seen], way[-1:]]


def _map(
    axes: Any,
    view: FlyingView,
    plane: tuple[int, int],
    window: Window,
    *,
    depth: tuple[float, float],
) -> None:
    """Draw cloud, map, paths and tracks, projected onto the axes `plane`."""
    across, up = plane
    window.apply(axes)
    draw_voxels(axes, view.occupied, view.voxel_size, plane, window, depth)
    for cloud, (kind, name, colour, size) in zip(_by_class(view), CLOUDS, strict=True):
        if colour in (OWN, MOVING, FLYING) and not len(cloud):
            continue  # most robots hide nothing, and often nothing moves
        rows = visible_rows(cloud, plane, window, depth)
        rows = rows[thinned(rows, np.full(len(rows), kind, np.uint8), MOST_POINTS)]
        axes.scatter(
            rows[:, across], rows[:, up], s=size, c=colour, linewidths=0, zorder=2, rasterized=True
        )
        axes.scatter([], [], s=24, c=colour, linewidths=0, label=name)
    axes.plot(
        view.sensor[:, across], view.sensor[:, up], color=INK, lw=1.6, zorder=4, label="sensor"
    )
    draw_truth(axes, (way[:, list(plane)] for way in view.truth.values()))
    _tracks(axes, view, plane)
    if len(view.sensor):
        sensor_mark(axes, window, view.sensor[-1, list(plane)])
    scale_bar(axes, window)
    axes.set_anchor("NW")
    window.apply(axes)
    axes.grid(visible=True)


def _by_class(view: FlyingView) -> list[NDArray[np.float64]]:
    """Return the points of each class, in the order of `CLOUDS`."""
    last = (view.cloud[view.cloud_class == kind] for kind, *_ in CLOUDS[:3])
    return [*last, view.moving, view.flying]


def _tracks(axes: Any, view: FlyingView, plane: tuple[int, int]) -> None:
    """Draw paths with 2 sigma ellipses, and a ring and the ID at the last position."""
    across, up = plane
    labels: list[tuple[int, Label]] = []
    ways = []
    tracks_of = _by_track(view)
    colours = colours_of(tracks_of)
    for order, (number, rows) in enumerate(tracks_of.items()):
        colour = colours[number]
        way = np.array([view.tracks[scan].position[row] for scan, row in rows])
        axes.plot(
            way[:, across],
            way[:, up],
            color=colour,
            lw=2.0,
            zorder=5,
            gid=WAY,
            label="track, 2σ ellipses; ring: last place" if order == 0 else None,
        )
        every = max(1, -(-len(rows) // ELLIPSES))
        for scan, row in rows[::-every]:
            tracks = view.tracks[scan]
            covariance = tracks.covariance[row][np.ix_(plane, plane)]
            sigma_ellipse(axes, tracks.position[row][list(plane)], covariance, colour)
        ring(axes, way[-1, list(plane)], colour)
        labels.append((-len(rows), Label(str(number), way[-1, list(plane)], colour)))
        ways.append(way[:, list(plane)])
    longest = [label for _, label in sorted(labels, key=lambda one: one[0])[:MOST_NUMBERS]]
    draw_labels(axes, longest, ways)


def _by_track(view: FlyingView) -> dict[int, list[tuple[int, int]]]:
    """Return for each track ID the scan and row of each of its states."""
    found: dict[int, list[tuple[int, int]]] = {}
    for scan, tracks in enumerate(view.tracks):
        for row, number in enumerate(tracks.id.tolist()):
            found.setdefault(number, []).append((scan, row))
    return dict(sorted(found.items()))


def _seconds(view: FlyingView, stamps: NDArray[np.int64]) -> NDArray[np.float64]:
    return (stamps - (view.stamp_ns[0] if len(view.stamp_ns) else 0)) * 1e-9


def _distances(axes: Any, view: FlyingView) -> None:
    """Draw distances of tracks, targets and moving points from the sensor over time."""
    time = _seconds(view, view.stamp_ns)
    shown = evenly(len(view.moving), MOST_POINTS)
    moving, at = view.moving[shown], view.moving_scan[shown]
    if len(moving):
        away = np.linalg.norm(moving - view.sensor[at], axis=1)
        axes.scatter(time[at], away, s=3, c=MOVING, linewidths=0, zorder=4, rasterized=True)
        axes.scatter([], [], s=24, c=MOVING, linewidths=0, label="moving on the ground")
    for way in view.truth.values():
        distance = np.linalg.norm(way - view.sensor, axis=1)
        axes.plot(time, distance, color="black", lw=1.0, ls=(0, (4, 3)), zorder=6)
    tracks_of = _by_track(view)
    colours = colours_of(tracks_of)
    for number, rows in tracks_of.items():
        scans = [scan for scan, _ in rows]
        way = np.array([view.tracks[scan].position[row] for scan, row in rows])
        distance = np.linalg.norm(way - view.sensor[scans], axis=1)
        axes.plot(
            time[scans], distance, color=colours[number], lw=2.2, label=f"track {number}", zorder=5
        )
    axes.set(title="distance from the sensor", ylabel="[m]", xlim=_span(time), ylim=(0, None))
    axes.grid(visible=True)
    handles, labels = axes.get_legend_handles_labels()
    if 0 < len(labels) <= MOST_LABELS:
        axes.legend(handles, labels, fontsize=8, loc="lower left", ncols=4)
    if not labels:
        axes.text(0.5, 0.5, "nothing moves", transform=axes.transAxes, ha="center", color=PALE)


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
    # Wide below narrow: where both counts are equal, both lines are seen.
    for counts, name, colour, width in (
        (view.n_detections, "detections", UNKNOWN, 4.0),
        (tracks, "flying tracks", TRACK_COLOURS[0], 1.8),
    ):
        axes.plot(time, counts, color=colour, lw=width, label=name, drawstyle="steps-mid")
    top = max([1, *tracks, *view.n_detections.tolist()])
    axes.set(title="detections and tracks per scan", xlim=_span(time), ylim=(-0.1 * top, 1.2 * top))
    axes.grid(visible=True)
    axes.legend(fontsize=8, loc="upper left", ncols=2)


def _span(time: NDArray[np.float64]) -> tuple[float, float]:
    last = float(time[-1]) if len(time) else 0.0
    return (0.0, last if last > 0 else 1.0)
