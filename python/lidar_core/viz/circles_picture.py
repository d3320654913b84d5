"""Pictures of a run of the circle pipeline, with matplotlib: one PNG, or an animation."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from lidar_core.extras import require
from lidar_core.io.tables.shapes import outline
from lidar_core.io.write.circle_scene import ellipse, label_of
from lidar_core.objects import CircleElements, ShapeElements
from lidar_core.viz.drawing.frame import Window, panel_tallness, window_over
from lidar_core.viz.drawing.labels import Label, draw_labels
from lidar_core.viz.drawing.marks import WAY, scale_bar, sensor_mark
from lidar_core.viz.figure import (
    INK,
    PALE,
    PURPOSE,
    draw_truth,
    opaque_legend,
    two_columns,
    write_figure,
)
from lidar_core.viz.film import write_film
from lidar_core.viz.views import CirclesView

SIZE, DPI = (12.0, 7.0), 90
FILM_SIZE, FILM_DPI = (7.0, 7.0), 70
COLOURS = (
    *("#0369a1", "#15803d", "#7e22ce", "#b45309", "#be185d", "#0f766e", "#4d7c0f"),
    *("#4338ca", "#a16207", "#0891b2", "#86198f", "#57534e"),
)  # as many as there are curves
POINT, EARLIER, WALL = "#475569", "#dbe1e8", "#c2410c"
MOVED = 1.0  # elements that moved this far are in the middle [m]
SMALLEST = 4.0  # least width and height of what is shown [m]
REACH = 12.0  # from the sensor's way, at most: points further off only make the rest small [m]
BULK = (0.01, 0.99)  # quantiles of the points that are shown at least
MOST_POINTS = 30_000  # of earlier scans
SIGMAS, CORNERS = 2.0, 36
SLOWEST = 0.05  # drawn with an arrow, as long as the way of one second [m/s]
MOST_CURVES = 12  # radii over time: the elements seen longest
GONE = 0.45  # opacity of what is no longer in the map at the end
MOST_LABELS = 40  # of elements that are no longer in the map, the longest ways: more hide the map

StateT = TypeVar("StateT", CircleElements, ShapeElements)


def draw_circles(view: CirclesView, path: str | Path) -> Path:
    """Draw the map at the end of a run, and its elements over time, into a PNG file.

    Parameters
    ----------
    view : CirclesView
        Content of the picture.
    path : str or Path
        File to write atomically.

    Raises
    ------
    MissingExtraError
        matplotlib is not installed.
    """
    return write_figure(path, lambda figure: _compose(figure, view), size=SIZE, dpi=DPI)


def animate_circles(
    view: CirclesView,
    path: str | Path,
    *,
    frames: int,
    rate: float,
    on_frame: Callable[[int, int], None] = lambda done, total: None,
) -> Path:
    """Draw the map over time.

    Parameters
    ----------
    view : CirclesView
        Content of the film; scans whose points were not kept are left out.
    path : str or Path
        .gif, or .mp4 where ffmpeg is installed; written atomically.
    frames : int
        Frames at most, evenly picked.
    rate : float
        Frames per second [Hz].
    on_frame : callable
        Gets the number of frames that are drawn, and that of all.

    Raises
    ------
    ConfigError
        Another ending.
    MissingExtraError
        matplotlib or, for .mp4, ffmpeg is not installed.
    """
    kept = [scan for scan, points in enumerate(view.points) if len(points)]
    picked = kept[:: max(1, -(-len(kept) // frames))] or [len(view.maps) - 1]
    window = _window(view, 1.0)

    def paint(figure: Any) -> Iterator[None]:
        axes = figure.add_subplot()
        for number, scan in enumerate(picked):
            on_frame(number, len(picked))
            axes.clear()
            _above(axes, view, scan, window)
            axes.set_title(f"{view.title}: {_seconds(view)[scan]:.1f} s" if scan >= 0 else "")
            yield
        on_frame(len(picked), len(picked))

    return write_film(path, paint, size=FILM_SIZE, dpi=FILM_DPI, rate=rate)


def _compose(figure: Any, view: CirclesView) -> None:
    grid = two_columns(figure, view.title, widths=(1.35, 1.0), heights=(1.3, 1.0), hspace=0.36)
    above = figure.add_subplot(grid[:, 0])
    _earlier(above, view)
    window = _window(view, panel_tallness(above))
    _above(above, view, len(view.maps) - 1, window)
    _gone(above, view)
    window.apply(above)
    time = _seconds(view)
    above.set_title(f"from above, 0 to {time[-1]:.1f} s" if len(time) else "from above")
    if view.maps:
        ways = [line[:, :2] for line in view.truth.values()]
        places = [view.maps[-1].center, view.sensor[-1:], *_ways(view, len(view.maps) - 1).values()]
        opaque_legend(above, window.corner_away_from([*places, *ways]))
    _radii(figure.add_subplot(grid[0, 1]), view)
    _counts(figure.add_subplot(grid[1, 1]), view)


def _window(view: CirclesView, tall: float) -> Window:
    """What is shown: elements that moved in the middle, with points, sensor and truth around."""
    points = np.concatenate([np.empty((0, 2)), *view.points])
    if len(view.sensor):
        low, high = view.sensor.min(axis=0) - REACH, view.sensor.max(axis=0) + REACH
        points = points[((points >= low) & (points <= high)).all(axis=1)]
    seen = np.quantile(points, BULK, axis=0) if len(points) else np.empty((0, 2))
    ends = [state.center for state in view.maps[-1:]] if not len(points) else []
    focus = [seen, *ends, view.sensor, *view.truth.values()]
    ways = _ways(view, len(view.maps) - 1).values()
    moving = [way for way in ways if np.hypot(*np.ptp(way, axis=0)) > MOVED]
    return window_over(focus, tall, smallest=SMALLEST, moving=moving)


def _earlier(axes: Any, view: CirclesView) -> None:
    """Points of all scans, pale."""
    rows = np.concatenate([np.empty((0, 2)), *view.points])
    rows = rows[:: max(1, -(-len(rows) // MOST_POINTS))]
    axes.scatter(rows[:, 0], rows[:, 1], s=0.4, c=EARLIER, linewidths=0, zorder=1, rasterized=True)


def _above(
    axes: Any,
    view: CirclesView,
    scan: int,
    window: Window,
) -> None:
    """Scan, sensor and map at one time, with the ways up to it."""
    window.apply(axes)
    if scan >= 0:
        points = view.points[scan]
        axes.scatter(points[:, 0], points[:, 1], s=3, c=POINT, linewidths=0, zorder=2, label="scan")
        way = view.sensor[: scan + 1]
        axes.plot(way[:, 0], way[:, 1], color=INK, lw=1.4, zorder=4, label="sensor")
        sensor_mark(axes, window, way[-1])
        draw_truth(axes, (line[: scan + 1, :2] for line in view.truth.values()))
        _elements(axes, view, scan)
        if view.shapes:
            _shapes(axes, view.shapes[scan])
    scale_bar(axes, window)
    window.apply(axes)
    axes.set(xlabel="x [m]", ylabel="y [m]")
    axes.grid(visible=True)


def _elements(axes: Any, view: CirclesView, scan: int) -> None:
    """Elements at one time: disc, 2 sigma ellipse, velocity, number, way."""
    patches = require("matplotlib.patches", extra="plot", purpose=PURPOSE)
    state, ways = view.maps[scan], _ways(view, scan)
    for row, number in enumerate(state.id.tolist()):
        colour = colour_of(number)
        center, seen = state.center[row], bool(state.visible[row])
        disc = patches.Circle(center, state.radius[row])
        disc.set(
            facecolor=(colour, 0.2 if seen else 0.05),
            edgecolor=colour,
            lw=1.5,
            ls="-" if seen else ":",
            zorder=5,
        )
        axes.add_patch(disc)
        around = center + ellipse(state.covariance[row][:2, :2], SIGMAS, CORNERS)
        outline = patches.Polygon(around, closed=True, fill=False, ec=colour, lw=0.8, zorder=5)
        axes.add_patch(outline)
        axes.plot(*ways[number].T, color=colour, lw=1.0, alpha=0.7, zorder=4.5, gid=WAY)
        _arrow(axes, center, state.velocity[row], colour)
    draw_labels(
        axes,
        [
            Label(label_of(state, row), center, colour_of(number))
            for row, (number, center) in enumerate(
                zip(state.id.tolist(), state.center, strict=True)
            )
        ],
        [],
    )
    axes.scatter(
        [],
        [],
        s=60,
        facecolor=(COLOURS[0], 0.2),
        edgecolor=COLOURS[0],
        label="element, its way, 2σ ellipse, velocity",
    )


def _gone(axes: Any, view: CirclesView) -> None:
    """Elements and shapes that are no longer in the map at the end, pale, where they were last."""
    patches = require("matplotlib.patches", extra="plot", purpose=PURPOSE)
    last = _last_rows(view.maps)
    there = set(view.maps[-1].id.tolist()) if view.maps else set()
    ways, labels = _ways(view, len(view.maps) - 1), list[tuple[int, Label]]()
    for number, (state, row) in last.items():
        if number in there:
            continue
        colour, center = colour_of(number), state.center[row]
        disc = patches.Circle(center, state.radius[row], fill=False, ec=colour, lw=1.0, ls=":")
        disc.set(alpha=GONE, zorder=4.6)
        axes.add_patch(disc)
        axes.plot(*ways[number].T, color=colour, lw=0.8, alpha=GONE, zorder=4.4, gid=WAY)
        labels.append((len(ways[number]), Label(label_of(state, row), center, colour)))
    longest = sorted(labels, key=lambda one: -one[0])[:MOST_LABELS]
    draw_labels(axes, [label for _, label in longest], [])
    if labels:
        axes.scatter(
            [],
            [],
            s=60,
            facecolor="none",
            edgecolor=COLOURS[0],
            alpha=GONE,
            ls=":",
            label="no longer in the map",
        )
    walls = _last_rows(view.shapes)
    there = set(view.shapes[-1].id.tolist()) if view.shapes else set()
    for number, (shapes, row) in walls.items():
        if number not in there:
            around = outline(shapes, row, CORNERS)
            closed = around if len(around) == 2 else np.vstack([around, around[:1]])
            axes.plot(*closed.T, color=WALL, lw=1.2, ls=":", alpha=GONE, zorder=2.5)


def _last_rows(states: Sequence[StateT]) -> dict[int, tuple[StateT, int]]:
    """For every number, the last state that has it, and its row there."""
    return {
        number: (state, row) for state in states for row, number in enumerate(state.id.tolist())
    }


def _shapes(axes: Any, shapes: ShapeElements) -> None:
    """Outlines of lines, ellipses and rectangles, dotted where they are out of sight."""
    for row in range(len(shapes.id)):
        around = outline(shapes, row, CORNERS)
        closed = around if len(around) == 2 else np.vstack([around, around[:1]])
        axes.plot(
            *closed.T,
            color=WALL,
            lw=2.2,
            ls="-" if shapes.visible[row] else ":",
            alpha=0.85,
            zorder=3,
            label=None if row else "wall or other shape",
        )


def _arrow(
    axes: Any, center: NDArray[np.float64], velocity: NDArray[np.float64], colour: str
) -> None:
    if np.hypot(*velocity) > SLOWEST:
        axes.annotate(
            "",
            center + velocity,
            center,
            zorder=7,
            arrowprops={"arrowstyle": "-|>", "color": colour, "lw": 1.6},
            annotation_clip=True,
        )


def colour_of(number: int) -> str:
    """Colour of an element, the same in every picture."""
    return COLOURS[number % len(COLOURS)]


def _ways(view: CirclesView, scan: int) -> Mapping[int, NDArray[np.float64]]:
    """Centres of every element up to `scan`."""
    found: dict[int, list[NDArray[np.float64]]] = {}
    for state in view.maps[: scan + 1]:
        for row, number in enumerate(state.id.tolist()):
            found.setdefault(number, []).append(state.center[row])
    return {number: np.array(rows) for number, rows in found.items()}


def _seconds(view: CirclesView) -> NDArray[np.float64]:
    first = view.stamp_ns[0] if len(view.stamp_ns) else 0
    seconds: NDArray[np.float64] = (view.stamp_ns - first) * 1e-9
    return seconds


def _radii(axes: Any, view: CirclesView) -> None:
    """Radius of the elements over time, with its 2 sigma band."""
    time, curves = _seconds(view), _curves(view)
    longest = sorted(curves, key=lambda number: len(curves[number]), reverse=True)[:MOST_CURVES]
    for number in sorted(longest):
        scans, radius, spread = np.array(curves[number]).T
        at = time[scans.astype(np.intp)]
        axes.plot(at, radius, color=colour_of(number), lw=1.4, label=str(number))
        axes.fill_between(
            at,
            radius - SIGMAS * spread,
            radius + SIGMAS * spread,
            color=colour_of(number),
            alpha=0.15,
            lw=0,
        )
    top = max((radius for curve in curves.values() for _, radius, _ in curve), default=1.0)
    more = f": {MOST_CURVES} longest" if len(curves) > MOST_CURVES else ""
    axes.set(title="radius, 2σ band" + more, ylabel="[m]", ylim=(0, 1.3 * top))
    axes.grid(visible=True)
    if longest:
        axes.legend(fontsize=7, loc="upper right", ncols=6)
    else:
        axes.text(0.5, 0.5, "no elements", transform=axes.transAxes, ha="center", color=PALE)


def _curves(view: CirclesView) -> dict[int, list[tuple[float, float, float]]]:
    """Scan, radius and its standard deviation of every element."""
    found: dict[int, list[tuple[float, float, float]]] = {}
    for scan, state in enumerate(view.maps):
        spread = np.sqrt(np.maximum(state.covariance[:, 4, 4], 0))
        rows = zip(state.id.tolist(), state.radius.tolist(), spread.tolist(), strict=True)
        for number, radius, deviation in rows:
            found.setdefault(number, []).append((scan, radius, deviation))
    return found


def _counts(axes: Any, view: CirclesView) -> None:
    time = _seconds(view)
    elements = [len(state.id) for state in view.maps]
    # Wide below narrow: where both counts are equal, both lines are seen.
    for counts, name, colour, width in (
        (view.n_circles, "circles found", "#f59e0b", 4.0),
        (elements, "elements", COLOURS[0], 1.8),
    ):
        axes.plot(time, counts, color=colour, lw=width, label=name, drawstyle="steps-mid")
    top = max([1, *elements, *view.n_circles.tolist()])
    axes.set(
        title="circles and elements per scan", xlabel="time [s]", ylim=(-0.05 * top, 1.3 * top)
    )
    axes.grid(visible=True)
    axes.legend(fontsize=8, loc="upper left", ncols=2)
