"""Pictures of a run of the circle pipeline, with matplotlib: one PNG, or an animation."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from lidar_core.circles.movers import SLOWEST, moved, speeds_of
from lidar_core.extras import require
from lidar_core.io.tables.shapes import outline
from lidar_core.io.write.circle_scene import ellipse, label_of
from lidar_core.objects import CircleElements, ShapeElements
from lidar_core.viz.drawing.frame import Window, panel_tallness, window_over
from lidar_core.viz.drawing.labels import Label, draw_labels
from lidar_core.viz.drawing.marks import WAY, colours_of, scale_bar, sensor_mark
from lidar_core.viz.drawing.thinning import evenly
from lidar_core.viz.figure import (
    INK,
    PURPOSE,
    draw_truth,
    two_columns,
    write_figure,
)
from lidar_core.viz.film import write_film
from lidar_core.viz.pictures.circles_panels import (
    STANDS,
    draw_counts,
    draw_speeds,
    seconds_of,
)
from lidar_core.viz.views import CirclesView

SIZE, DPI = (12.0, 7.0), 90
FILM_SIZE, FILM_DPI = (7.0, 7.0), 70
POINT, EARLIER, WALL = "#475569", "#dbe1e8", "#c2410c"
MOVED = 1.0  # elements that moved this far are in the middle [m]
SMALLEST = 4.0  # least width and height of what is shown [m]
REACH = 12.0  # from the sensor's way, at most: points further off only make the rest small [m]
BULK = (0.01, 0.99)  # quantiles of the points that are shown at least
MOST_POINTS = 30_000  # of earlier scans
SIGMAS, CORNERS = 2.0, 36
WIDE, THIN = 2.4, 1.1  # outlines of what moved, and of what stands
GONE = 0.45  # opacity of what is no longer in the map at the end
MOST_GONE = 40  # elements that are no longer in the map, the longest ways: more hide the map
TURNS = 4  # to make room for circles at the border, which may bring in others

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
        Called with the number of frames that are drawn, and that of all.

    Raises
    ------
    ConfigError
        Another ending.
    MissingExtraError
        matplotlib or, for .mp4, ffmpeg is not installed.
    """
    kept = [scan for scan, points in enumerate(view.points) if len(points)]
    picked = kept[:: max(1, -(-len(kept) // frames))] or [len(view.maps) - 1]
    window, movers = _window(view, 1.0), moved(view.maps)
    colours = colours_of(*([n for n in state.id.tolist() if n in movers] for state in view.maps))

    def paint(figure: Any) -> Iterator[None]:
        axes = figure.add_subplot()
        for number, scan in enumerate(picked):
            on_frame(number, len(picked))
            axes.clear()
            _above(axes, view, scan, window, colours)
            axes.set_title(f"{view.title}: {seconds_of(view)[scan]:.1f} s" if scan >= 0 else "")
            yield
        on_frame(len(picked), len(picked))

    return write_film(path, paint, size=FILM_SIZE, dpi=FILM_DPI, rate=rate)


def _compose(figure: Any, view: CirclesView) -> None:
    heights = (1.2, 1.0, 0.5)
    grid = two_columns(figure, view.title, widths=(1.35, 1.0), heights=heights, hspace=0.42)
    above, keys = figure.add_subplot(grid[:, 0]), figure.add_subplot(grid[2, 1])
    colours = _colours(view)
    _earlier(above, view)
    window = _window(view, panel_tallness(above))
    _above(above, view, len(view.maps) - 1, window, colours, with_gone=True)
    _gone_shapes(above, view)
    window.apply(above)
    time = seconds_of(view)
    above.set_title(f"from above, 0 to {time[-1]:.1f} s" if len(time) else "from above")
    keys.set_axis_off()
    if view.maps:  # beside the map: elements and their numbers may be everywhere in it
        style = {"fontsize": 8, "ncols": 2, "columnspacing": 1.2, "borderpad": 0.0}
        keys.legend(*above.get_legend_handles_labels(), loc="lower left", **style)
    if colours:
        draw_speeds(figure.add_subplot(grid[0, 1]), view, colours)
    draw_counts(figure.add_subplot(grid[1, 1] if colours else grid[:2, 1]), view)


def _colours(view: CirclesView) -> dict[int, str]:
    """Colours of the elements that moved; those that are drawn come first, so that they differ."""
    movers = moved(view.maps)
    drawn = [number for number in _drawn_at_end(view) if number in movers]
    return colours_of([*drawn, *sorted(movers)])


def _window(view: CirclesView, tall: float) -> Window:
    """Return the window: moved elements in the middle; points, sensor and truth around them.

    It contains every circle that reaches into it as a whole.
    """
    points = np.concatenate([np.empty((0, 2)), *view.points])
    if len(view.sensor):
        low, high = view.sensor.min(axis=0) - REACH, view.sensor.max(axis=0) + REACH
        points = points[((points >= low) & (points <= high)).all(axis=1)]
    seen = np.quantile(points, BULK, axis=0) if len(points) else np.empty((0, 2))
    ends = [state.center for state in view.maps[-1:]] if not len(points) else []
    focus = [seen, *ends, view.sensor, *view.truth.values()]
    ways = _ways(view, len(view.maps) - 1).values()
    moving = [way for way in ways if np.hypot(*np.ptp(way, axis=0)) > MOVED]
    window = window_over(focus, tall, smallest=SMALLEST, moving=moving)
    boxes = [_box(*drawn) for drawn in _drawn_at_end(view).values()]
    for _ in range(TURNS):
        cut = [box for box in boxes if _is_cut(box, window)]
        if not cut:
            break
        focus += cut
        window = window_over(focus, tall, smallest=SMALLEST, moving=moving)
    return window


def _box(state: CircleElements, row: int) -> NDArray[np.float64]:
    """Corners (2, 2) around the circle of an element [m]."""
    half = float(state.radius[row]) * np.array([[-1.0, -1.0], [1.0, 1.0]])
    return np.asarray(state.center[row] + half, np.float64)


def _is_cut(box: NDArray[np.float64], window: Window) -> bool:
    """Return whether the window contains only a part of a box."""
    meets = bool(((box[1] > window.low) & (box[0] < window.high)).all())
    return meets and not (window.holds(box[0]) and window.holds(box[1]))


def _drawn_at_end(view: CirclesView) -> dict[int, tuple[CircleElements, int]]:
    """Return for each element ID the map state, and the row there, that a picture shows.

    Elements of the last map come first. Then follow the elements with the longest paths that are
    not in this map.
    """
    last, ways = _last_rows(view.maps), _ways(view, len(view.maps) - 1)
    there = set(view.maps[-1].id.tolist()) if view.maps else set()
    gone = sorted(last.keys() - there, key=lambda number: (-len(ways[number]), number))
    return {number: last[number] for number in (*sorted(there), *gone[:MOST_GONE])}


def _earlier(axes: Any, view: CirclesView) -> None:
    """Draw the points of all scans in a pale colour."""
    rows = np.concatenate([np.empty((0, 2)), *view.points])
    rows = rows[evenly(len(rows), MOST_POINTS)]
    axes.scatter(rows[:, 0], rows[:, 1], s=0.4, c=EARLIER, linewidths=0, zorder=1, rasterized=True)


def _above(
    axes: Any,
    view: CirclesView,
    scan: int,
    window: Window,
    colours: Mapping[int, str],
    *,
    with_gone: bool = False,
) -> None:
    """Draw scan, sensor, map and earlier paths at one time; with `with_gone` vanished elements."""
    window.apply(axes)
    if scan >= 0:
        points = view.points[scan]
        axes.scatter(points[:, 0], points[:, 1], s=3, c=POINT, linewidths=0, zorder=2, label="scan")
        way = view.sensor[: scan + 1]
        axes.plot(way[:, 0], way[:, 1], color=INK, lw=1.4, zorder=4, label="sensor")
        sensor_mark(axes, window, way[-1])
        draw_truth(axes, (line[: scan + 1, :2] for line in view.truth.values()))
        gone = _gone(axes, view, colours) if with_gone else []
        draw_labels(axes, [*_elements(axes, view, scan, colours), *gone], [])
        if view.shapes:
            _shapes(axes, view.shapes[scan])
    scale_bar(axes, window)
    window.apply(axes)
    axes.set(xlabel="x [m]", ylabel="y [m]")
    axes.grid(visible=True)


def _elements(axes: Any, view: CirclesView, scan: int, colours: Mapping[int, str]) -> list[Label]:
    """Draw the elements at one time, moving ones in colour with their speed; return the labels."""
    patches = require("matplotlib.patches", extra="plot", purpose=PURPOSE)
    state, ways = view.maps[scan], _ways(view, scan)
    speeds, labels = speeds_of(state), list[Label]()
    for row, number in enumerate(state.id.tolist()):
        does_move = number in colours
        colour, center = colours.get(number, STANDS), state.center[row]
        _disc(axes, state, row, colour, does_move=does_move)
        around = center + ellipse(state.covariance[row][:2, :2], SIGMAS, CORNERS)
        band = patches.Polygon(around, closed=True, fill=False, ec=colour, lw=0.8, zorder=5)
        axes.add_patch(band)
        wide = 1.8 if does_move else 0.8
        axes.plot(*ways[number].T, color=colour, lw=wide, alpha=0.8, zorder=4.5, gid=WAY)
        text = label_of(state, row)
        if does_move and speeds[row] > SLOWEST:
            _arrow(axes, center, state.velocity[row], colour)
            text += f" {speeds[row]:.1f} m/s"
        labels.append(Label(text, center, colour))
    _element_keys(axes, state, colours)
    return sorted(labels, key=lambda label: label.colour == STANDS)  # movers: better places


def _disc(axes: Any, state: CircleElements, row: int, colour: str, *, does_move: bool) -> None:
    patches = require("matplotlib.patches", extra="plot", purpose=PURPOSE)
    seen = bool(state.visible[row])
    disc = patches.Circle(state.center[row], state.radius[row])
    disc.set(
        facecolor=(colour, 0.2 if seen else 0.05),
        edgecolor=colour,
        lw=WIDE if does_move else THIN,
        ls="-" if seen else ":",
        zorder=5.2 if does_move else 5,
    )
    axes.add_patch(disc)


def _element_keys(axes: Any, state: CircleElements, colours: Mapping[int, str]) -> None:
    """Add legend entries for the styles of elements that occur."""
    numbers = state.id.tolist()
    moving = [number for number in numbers if number in colours]
    stands = {"facecolor": (STANDS, 0.2), "edgecolor": STANDS, "lw": THIN}
    if len(moving) < len(numbers) or not numbers:
        axes.scatter([], [], s=60, label="stands, 2σ ellipse", **stands)
    if moving:
        colour = colours[moving[0]]
        bold = {"facecolor": (colour, 0.2), "edgecolor": colour, "lw": WIDE}
        axes.scatter([], [], s=60, label="moves: way, 2σ ellipse, velocity", **bold)
    if not state.visible.all():
        hidden = {**stands, "facecolor": (STANDS, 0.05), "ls": ":"}
        axes.scatter([], [], s=60, label="in the map, out of sight", **hidden)


def _gone(axes: Any, view: CirclesView, colours: Mapping[int, str]) -> list[Label]:
    """Draw, pale at their last place, elements that the final map lacks; return their labels."""
    patches = require("matplotlib.patches", extra="plot", purpose=PURPOSE)
    there, ways = set(view.maps[-1].id.tolist()), _ways(view, len(view.maps) - 1)
    labels, left_out = list[Label](), len(_last_rows(view.maps)) - len(there)
    for number, (state, row) in _drawn_at_end(view).items():
        if number in there:
            continue
        colour, center = colours.get(number, STANDS), state.center[row]
        disc = patches.Circle(center, state.radius[row], fill=False, ec=colour, lw=1.0)
        disc.set(alpha=GONE, zorder=4.6)
        axes.add_patch(disc)
        axes.plot(*ways[number].T, color=colour, lw=0.8, alpha=GONE, zorder=4.4, gid=WAY)
        labels.append(Label(str(number), center, colour, opacity=GONE))
    left_out -= len(labels)
    if labels:
        longest = f", {MOST_GONE} of {MOST_GONE + left_out}" if left_out else ""
        key = {"facecolor": "none", "edgecolor": STANDS, "alpha": GONE, "lw": 1.0}
        axes.scatter([], [], s=60, label=f"no longer in the map{longest}", **key)
    return labels


def _gone_shapes(axes: Any, view: CirclesView) -> None:
    """Draw, in a pale colour, walls and other shapes that are no longer in the final map."""
    there = set(view.shapes[-1].id.tolist()) if view.shapes else set()
    for number, (shapes, row) in _last_rows(view.shapes).items():
        if number not in there:
            around = outline(shapes, row, CORNERS)
            closed = around if len(around) == 2 else np.vstack([around, around[:1]])
            axes.plot(*closed.T, color=WALL, lw=1.0, alpha=GONE, zorder=2.5)


def _last_rows(states: Sequence[StateT]) -> dict[int, tuple[StateT, int]]:
    """Return for every element ID the last state that contains it, and its row there."""
    return {
        number: (state, row) for state in states for row, number in enumerate(state.id.tolist())
    }


def _shapes(axes: Any, shapes: ShapeElements) -> None:
    """Draw outlines of lines, ellipses and rectangles; dotted if they are out of sight."""
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
    """Draw the velocity as an arrow whose length is the distance travelled in one second."""
    axes.annotate(
        "",
        center + velocity,
        center,
        zorder=7,
        arrowprops={"arrowstyle": "-|>", "color": colour, "lw": 1.8},
        annotation_clip=True,
    )


def _ways(view: CirclesView, scan: int) -> Mapping[int, NDArray[np.float64]]:
    """Centres of every element up to `scan`, by its ID [m]."""
    found: dict[int, list[NDArray[np.float64]]] = {}
    for state in view.maps[: scan + 1]:
        for row, number in enumerate(state.id.tolist()):
            found.setdefault(number, []).append(state.center[row])
    return {number: np.array(rows) for number, rows in found.items()}
