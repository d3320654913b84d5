"""One time of a run as PNG, or the run as a film, with matplotlib; needs no display."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from lidar_core.io.write.circle_scene import ellipse
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
from lidar_core.viz.drawing.marks import WAY, colours_of, ring, scale_bar, sensor_mark
from lidar_core.viz.drawing.thinning import thinned
from lidar_core.viz.drawing.voxels import draw_voxels
from lidar_core.viz.figure import INK, opaque_legend, png_path, write_figure
from lidar_core.viz.film import write_film
from lidar_core.viz.playback import Moment, Playback, Trails

Colours: TypeAlias = Mapping[int, str]

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
BAND, WALL = INK, "#0f766e"
SIGMAS, CORNERS = 2.0, 36
TRAIL = 50  # positions of an object that stay in view; of fused targets, which have no scan, all
MOST_POINTS = 40_000
MOST_NUMBERS, MOST_ROWS = 40, 12  # objects with a number, and lines of the list
SLOWEST = 0.05  # drawn with an arrow, as long as the way of one second [m/s]
SMALLEST = 4.0  # width of what is shown [m]
MOVED = 1.0  # objects that moved this far are in the middle [m]
ROUNDED = 0.01  # times are told with two digits [s]
MARGINS = {"left": 0.065, "right": 0.985, "top": 0.88, "bottom": 0.1, "hspace": 0.32}


def draw_moment(
    run: Playback,
    path: str | Path,
    *,
    at: float | None = None,
    on_other_time: Callable[[float, float], None] = lambda drawn, last: None,
) -> Path:
    """Draw the scan and the objects at one time, from above and, in 3D, from the side.

    Parameters
    ----------
    run : Playback
        The run.
    path : str or Path
        PNG to write atomically.
    at : float, optional
        Time since the start [s]; without it the last time with a scan.
    on_other_time : callable
        Called with the drawn time and the last time [s] if there is none near `at`.

    Raises
    ------
    ConfigError
        The file does not end in .png.
    FormatError
        A run without scans and estimates.
    MissingExtraError
        matplotlib is not installed.
    """
    png_path(path)
    times, start_ns = _times(run)
    seconds = (np.array(times) - start_ns) * 1e-9
    number = len(times) - 1 if at is None else int(np.argmin(np.abs(seconds - at)))
    step = float(np.median(np.diff(seconds))) if len(seconds) > 1 else 0.0
    if at is not None and abs(seconds[number] - at) > max(step, ROUNDED):
        on_other_time(float(seconds[number]), float(seconds[-1]))
    moment, trails = shown = _followed(run, times[number : number + 1])[0]
    scene, colours = _Scene.of(run, [shown]), colours_of(moment.objects.id.tolist())
    return write_figure(
        path,
        lambda figure: _compose(figure, scene, moment, trails, colours, float(seconds[number])),
        size=SIZE,
        dpi=DPI,
    )


def draw_film(
    run: Playback,
    path: str | Path,
    *,
    frames: int = 200,
    rate: float = 10.0,
    on_frame: Callable[[int, int], None] = lambda done, total: None,
) -> Path:
    """Draw a run over time.

    Parameters
    ----------
    run : Playback
        The run.
    path : str or Path
        .gif, or .mp4 where ffmpeg is installed; written atomically.
    frames : int
        Largest number of frames, which are evenly spaced in time.
    rate : float
        Frames per second [Hz].
    on_frame : callable
        Called with the number of frames that are drawn, and that of all.

    Raises
    ------
    ConfigError
        Another ending.
    FormatError
        A run without scans and estimates.
    MissingExtraError
        matplotlib or, for .mp4, ffmpeg is not installed.
    """
    times, start_ns = _times(run)
    picked = _followed(run, times[:: max(1, -(-len(times) // frames))])
    scene = _Scene.of(run, picked)
    colours = colours_of(*(moment.objects.id.tolist() for moment, _ in picked))

    def paint(figure: Any) -> Iterator[None]:
        for number, (moment, trails) in enumerate(picked):
            on_frame(number, len(picked))
            figure.clear()
            seconds = (moment.stamp_ns - start_ns) * 1e-9
            _compose(figure, scene, moment, trails, colours, seconds)
            yield
        on_frame(len(picked), len(picked))

    return write_film(path, paint, size=SIZE, dpi=FILM_DPI, rate=rate)


def _times(run: Playback) -> tuple[list[int], int]:
    """Times [ns] that can be drawn, and that of the first scan even if no scans were kept."""
    times = run.times()
    if not times:
        raise run.nothing_to("draw")
    first, _ = next(run.steps(), (times[0], None))
    return times, min(first, times[0])


def _followed(run: Playback, times: Sequence[int]) -> list[tuple[Moment, Trails]]:
    """Moments with the last positions of every object in them; fused targets keep all."""
    most = None if run.capability == "fusion" else TRAIL
    chosen = frozenset(times)
    return [(moment, run.trails(moment, most)) for moment in run.moments(chosen)]


@dataclass(frozen=True, slots=True)
class _Scene:
    """Data that all frames of a film share.

    Attributes
    ----------
    title : str
        Name of the run.
    is_planar : bool
        True if there is only a view from above.
    shows_whole_ways : bool
        True if the paths fill the picture: fused targets have no map around them.
    points_name : str
        Name of points without a class.
    moving, movers, around : sequence of ndarray, shape (N, 3)
        Places of objects that are in the middle, of what moves on the ground, which is shown too,
        and places that are shown where there is room [m].
    voxels : ndarray, shape (N, 3)
        Centres of occupied voxels [m], of edge `voxel_size` [m].
    """

    title: str
    is_planar: bool
    shows_whole_ways: bool
    points_name: str
    moving: Sequence[NDArray[np.float64]]
    movers: Sequence[NDArray[np.float64]]
    around: Sequence[NDArray[np.float64]]
    voxels: NDArray[np.float64] = field(default_factory=lambda: np.empty((0, 3)))
    voxel_size: float = 1.0

    @classmethod
    def of(cls, run: Playback, shown: Sequence[tuple[Moment, Trails]]) -> "_Scene":
        """Return all paths of the moments; for a map of circles, those of moving elements."""
        ways = [way for _, trails in shown for way in trails.values()]
        points = np.concatenate([moment.points[::20] for moment, _ in shown]).astype(np.float64)
        bulk = bulk_of(points)
        outlines = [one.points for moment, _ in shown for one in moment.outlines]
        sensors = [moment.sensor[None] for moment, _ in shown if moment.sensor is not None]
        if run.capability == "circles":
            moved = [way for way in ways if np.linalg.norm(np.ptp(way, axis=0)) > MOVED]
            around = [*ways, *outlines, bulk, *sensors]
            return cls(run.folder.name, True, False, run.points_name, moved, [], around)
        movers = [box_of_movers(moment.movers) for moment, _ in shown]
        around = sensors[-1:] if ways or any(map(len, movers)) else [bulk, *sensors[-1:]]
        is_fused, name, title = run.capability == "fusion", run.points_name, run.folder.name
        return cls(title, is_fused, is_fused, name, ways, movers, around, *run.occupied())

    def window(self, axes: tuple[int, int], tall: float) -> Window:
        """Return the part of the world that a panel of this height over width shows."""
        moving = [way[:, axes] for way in self.moving]
        movers, around = ([rows[:, axes] for rows in part] for part in (self.movers, self.around))
        if not moving and not any(map(len, movers)):
            return window_over(around, tall, smallest=SMALLEST)
        if self.shows_whole_ways:
            return window_over([*moving, *around], tall, smallest=SMALLEST)
        if self.is_planar:
            return window_over(around, tall, smallest=SMALLEST, moving=moving)
        return window_around(moving, tall, movers=movers, also=around)


def _compose(
    figure: Any,
    scene: _Scene,
    moment: Moment,
    trails: Trails,
    colours: Colours,
    seconds: float,
) -> None:
    """Draw the view from above on the left; the side view (in 3D) and a list on the right."""
    count = len(moment.objects.id)
    title = f"{scene.title}: {seconds:.2f} s, {count} object{'' if count == 1 else 's'}"
    figure.suptitle(title, x=MARGINS["left"], y=0.97, ha="left", fontsize=12, fontweight="bold")
    planar = scene.is_planar
    grid = figure.add_gridspec(
        1 if planar else 2,
        2,
        width_ratios=(1.9, 1.0) if planar else (1.0, 1.05),
        height_ratios=(1.0,) if planar else (1.5, 1.0),
        wspace=0.04 if planar else 0.13,
        **MARGINS,
    )
    above = figure.add_subplot(grid[:, 0])
    plan = scene.window((0, 1), panel_tallness(above))
    if planar:
        depth = (-np.inf, np.inf)
        _panel(above, moment, trails, colours, (0, 1), plan, depth=depth, points=scene.points_name)
    else:
        side = figure.add_subplot(grid[0, 1])
        elevation = scene.window((0, 2), panel_tallness(side))
        heights, middle = (elevation.low[1], elevation.high[1]), (plan.low[1], plan.high[1])
        for axes, plane, window, depth in (
            (above, (0, 1), plan, heights),
            (side, (0, 2), elevation, middle),
        ):
            window.apply(axes)
            if len(scene.voxels):
                draw_voxels(axes, scene.voxels, scene.voxel_size, plane, window, depth)
        _panel(above, moment, trails, colours, (0, 1), plan, depth=(-np.inf, np.inf))
        _panel(side, moment, trails, colours, (0, 2), elevation, depth=middle)
        side.set(title="from the side", xlabel="x [m]", ylabel="z [m]")
    above.set(title="from above", xlabel="x [m]", ylabel="y [m]")
    rest = figure.add_subplot(grid[-1, 1])
    _list(rest, moment)
    keys = above.get_legend_handles_labels()
    if keys[1] and planar:  # beside the picture: ways and maps may be everywhere in it
        rest.legend(*keys, loc="lower left", fontsize=8)
    elif keys[1]:
        corner = plan.corner_away_from([one[:, :2] for one in scene.around])
        opaque_legend(above, corner, ncols=2)


def _panel(
    panel: Any,
    moment: Moment,
    trails: Trails,
    colours: Colours,
    axes: tuple[int, int],
    window: Window,
    *,
    depth: tuple[float, float],
    points: str = "scan",
) -> None:
    """Draw a projection without points outside `depth`; `points` names those without a class."""
    window.apply(panel)
    _draw_points(panel, moment, axes, window, depth, points)
    for number, outline in enumerate(moment.outlines):
        line = outline.points[:, axes]
        name = None if number else "wall or other shape"
        panel.plot(*line.T, "-" if outline.visible else ":", lw=2.0, color=WALL, label=name)
    is_ringed = [
        _draw_object(panel, moment, row, list(axes), trails[name], colours[name])
        for row, name in enumerate(moment.objects.id.tolist())
    ]
    names = moment.objects.id.tolist()[:MOST_NUMBERS]
    ways = [trails[name][:, axes] for name in names]
    draw_labels(
        panel,
        [Label(str(name), way[-1], colours[name]) for name, way in zip(names, ways, strict=True)],
        ways,
    )
    if moment.sensor is not None:
        sensor_mark(panel, window, moment.sensor[list(axes)])
    scale_bar(panel, window)
    if moment.sensor is not None:
        panel.plot([], [], marker="^", ls="", ms=6, color=INK, label="sensor")
    if names:
        panel.plot([], [], "-", color=colours[names[0]], label="object and its way")
        panel.plot([], [], "-", color=BAND, label="2σ of the position")
        arrow = {"ls": "", "marker": r"$\rightarrow$", "ms": 12, "mew": 0.4}
        panel.plot([], [], color=INK, label="way of one second", **arrow)
    if any(is_ringed):
        colour = colours[int(moment.objects.id[is_ringed.index(True)])]
        panel.plot([], [], "o", ms=9, mfc="none", mec=colour, label="ring: small object")
    window.apply(panel)
    panel.grid(visible=True)


def _draw_points(
    panel: Any,
    moment: Moment,
    axes: tuple[int, int],
    window: Window,
    depth: tuple[float, float],
    plain: str,
) -> None:
    flat = moment.points[:, axes]
    far = moment.points[:, 3 - sum(axes)]
    inside = ((flat >= window.low) & (flat <= window.high)).all(axis=1)
    rows = np.flatnonzero(inside & (far >= depth[0]) & (far <= depth[1]))
    rows = rows[thinned(moment.points[rows], moment.point_class[rows], MOST_POINTS)]
    for kind, colour in POINT_COLOURS.items():
        chosen = flat[rows[moment.point_class[rows] == kind]]
        if (moment.point_class == kind).any():
            is_plain = kind == ShownClass.INVALID
            name = plain if is_plain else kind.name.lower().replace("_", " ")
            panel.plot([], [], ".", ms=6, color=colour, label=name)
        size = 1 + 2 * (kind > ShownClass.BACKGROUND)
        panel.plot(*chosen.T, ".", ms=size, color=colour, rasterized=True)


def _draw_object(
    panel: Any,
    moment: Moment,
    row: int,
    axes: list[int],
    trail: NDArray[np.float64],
    colour: str,
) -> bool:
    """Draw path, outline, 2 sigma ellipse, velocity, and a ring around a small object.

    Returns whether there is a ring.
    """
    objects = moment.objects
    at, velocity = objects.position[row][axes], objects.velocity[row][axes]
    panel.plot(*trail[:, axes].T, "-", lw=1.6, color=colour, alpha=0.7, gid=WAY)
    sides = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1], [-1, -1]]) / 2 * objects.size[row][axes]
    around = objects.outline(row)[:, axes] if axes == [0, 1] else at + sides
    panel.plot(around[:, 0], around[:, 1], "-", lw=1.2, color=colour)
    band = at + ellipse(objects.covariance[row][np.ix_(axes, axes)], SIGMAS, CORNERS)
    panel.plot(*np.vstack([band, band[:1]]).T, "-", lw=1.0, color=BAND)
    is_ringed = ring(panel, at, colour, size=float(np.ptp(around, axis=0).min()))
    if np.linalg.norm(velocity) > SLOWEST:
        arrow = {"arrowstyle": "->", "color": INK}
        panel.annotate("", at + velocity, at, arrowprops=arrow, annotation_clip=True)
    return is_ringed


def _list(panel: Any, moment: Moment) -> None:
    """Write ID, position, speed and uncertainty of the objects as text."""
    objects = moment.objects
    panel.set_axis_off()
    text = {"fontsize": 8.5, "family": "DejaVu Sans Mono", "color": INK, "linespacing": 1.35}
    if not len(objects.id):
        panel.text(
            0.02, 1.0, "no objects at this time", transform=panel.transAxes, va="top", **text
        )
        return
    planar = not objects.position[:, 2].any()
    heads = "   id       x       y" + ("" if planar else "       z") + "   speed     2σ"
    units = "          [m]     [m]" + ("" if planar else "     [m]") + "   [m/s]    [m]"
    lines = [heads, units]
    for row, name in enumerate(objects.id.tolist()[:MOST_ROWS]):
        place = objects.position[row][: 2 if planar else 3].tolist()
        speed = float(np.linalg.norm(objects.velocity[row]))
        axes = slice(0, 2 if planar else 3)
        spread = np.linalg.eigvalsh(objects.covariance[row][axes, axes])[-1]
        two_sigma = SIGMAS * float(np.sqrt(max(spread, 0.0)))
        places = "".join(f"{value:8.2f}" for value in place)
        lines.append(f"{name:5d}{places}{speed:8.2f}{two_sigma:7.3f}")
    if len(objects.id) > MOST_ROWS:
        lines.append(f"and {len(objects.id) - MOST_ROWS} more")
    panel.text(0.02, 1.0, "\n".join(lines), transform=panel.transAxes, va="top", **text)
