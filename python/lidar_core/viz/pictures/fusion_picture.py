"""Picture of targets fused from LiDAR and radar, with matplotlib: one PNG."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_core.io.write.circle_scene import ellipse
from lidar_core.viz.drawing.frame import panel_tallness, window_over
from lidar_core.viz.drawing.labels import Label, draw_labels
from lidar_core.viz.drawing.marks import (
    TRACK_COLOURS,
    WAY,
    colours_of,
    ring,
    scale_bar,
    sensor_mark,
)
from lidar_core.viz.figure import (
    DASHED,
    INK,
    PALE,
    draw_truth,
    opaque_legend,
    two_columns,
    write_figure,
)
from lidar_core.viz.views import FusionView, PlanarLine

SIZE, DPI = (12.0, 7.0), 90
SENSORS = {"lidar": ("#334155", "o"), "radar": ("#c2410c", "^")}
OTHER = ("#64748b", "s")
"""Colours and markers of measurements."""
LARGEST, SMALLEST_MARK, CROWD = 16.0, 5.0, 5000.0
"""Areas [points^2]: of a marker of few measurements, of a marker of many, and of all markers."""
SIGMAS, CORNERS = 2.0, 36
ELLIPSES = 20  # along a track, at most
SMALLEST = 4.0  # least width and height of what is shown [m]
NAMED = 24  # tracks with a number beside them, the longest of those that last to the end
TRAIL = "trail"  # mark of ways of tracks that ended, by which tests find them
BAND = 5.0  # standard deviations that a panel of errors shows, at the median


def draw_fusion(view: FusionView, path: str | Path) -> Path:
    """Draw tracks with their 2 sigma bands, measurements, truth and NIS into a PNG file.

    With one track and its truth, the bands surround the error; otherwise the position.

    Parameters
    ----------
    view : FusionView
        Content of the picture.
    path : str or Path
        File to write atomically.

    Raises
    ------
    MissingExtraError
        matplotlib is not installed.
    """
    return write_figure(path, lambda figure: _compose(figure, view), size=SIZE, dpi=DPI)


def _compose(figure: Any, view: FusionView) -> None:
    grid = two_columns(figure, view.title, widths=(1.2, 1.0), heights=(1.0,) * 3, hspace=0.42)
    _above(figure.add_subplot(grid[:, 0]), view)
    stamps = [line.stamp_ns for line in (*view.tracks.values(), *view.truth.values())]
    stamps += [times for times, _ in view.nis.values()]
    first = min((int(times[0]) for times in stamps if len(times)), default=0)
    for axis, name in enumerate("xy"):
        _over_time(figure.add_subplot(grid[axis, 1]), view, axis, name, first)
    last = _consistency if view.nis or not view.tracks else _counts
    last(figure.add_subplot(grid[2, 1]), view, first)


def _above(axes: Any, view: FusionView) -> None:
    """Draw measurements, truth, the path of the sensor, and the whole paths of the tracks."""
    ways = [line.position for line in (*view.tracks.values(), *view.truth.values())]
    window = window_over(ways or view.seen.values(), panel_tallness(axes), smallest=SMALLEST)
    window.apply(axes)
    count = sum(len(places) for places in view.seen.values())
    area = float(np.clip(CROWD / max(1, count), SMALLEST_MARK, LARGEST))
    for sensor, places in view.seen.items():
        colour, marker = SENSORS.get(sensor, OTHER)
        axes.scatter(
            places[:, 0],
            places[:, 1],
            s=area,
            c=colour,
            marker=marker,
            linewidths=0,
            alpha=0.75,
            zorder=2,
            label=sensor,
            rasterized=True,
        )
    if len(view.sensor):
        axes.plot(*view.sensor.T, color=INK, lw=1.2, zorder=3, label="sensor")
        sensor_mark(axes, window, view.sensor[-1])
    draw_truth(axes, (line.position for line in view.truth.values()))
    lasting = _lasting(view.tracks)
    colours = _colours(view.tracks)
    ended = {number: line for number, line in view.tracks.items() if number not in lasting}
    _trails(axes, ended, colours)
    for order, (number, line) in enumerate(lasting.items()):
        _track(axes, line, colours[number], None if order else "track, 2σ ellipses")
        ring(axes, line.position[-1], colours[number])
    longest = sorted(lasting, key=lambda number: -len(lasting[number].stamp_ns))[:NAMED]
    labels = [
        Label(str(number), lasting[number].position[-1], colours[number]) for number in longest
    ]
    shown = [line.position for line in (*lasting.values(), *view.truth.values())]
    draw_labels(axes, labels, shown)
    scale_bar(axes, window)
    window.apply(axes)
    axes.set(title=_above_title(view), xlabel="x [m]", ylabel="y [m]")
    axes.grid(visible=True)
    if view.seen or view.tracks:
        opaque_legend(
            axes, window.corner_away_from([*(ways or view.seen.values()), view.sensor]), ncols=2
        )


def _above_title(view: FusionView) -> str:
    stamps = [line.stamp_ns for line in view.tracks.values() if len(line.stamp_ns)]
    if not stamps:
        return "from above"
    seconds = (max(times[-1] for times in stamps) - min(times[0] for times in stamps)) * 1e-9
    return f"from above, {seconds:.1f} s; ring: place at the end"


def _lasting(tracks: Mapping[int, PlanarLine]) -> dict[int, PlanarLine]:
    """Return the tracks that exist at the end of the time that the picture shows."""
    known = {number: line for number, line in tracks.items() if len(line.stamp_ns)}
    end = max((line.stamp_ns[-1] for line in known.values()), default=0)
    return {number: line for number, line in known.items() if line.stamp_ns[-1] == end}


def _colours(tracks: Mapping[int, PlanarLine]) -> dict[int, str]:
    """Colours of the tracks; those that exist at the end come first, so that they differ."""
    return colours_of([*_lasting(tracks), *tracks])


def _trails(axes: Any, tracks: Mapping[int, PlanarLine], colours: Mapping[int, str]) -> None:
    """Draw the paths of ended tracks as thin lines: a long run has hundreds of them."""
    for order, (number, line) in enumerate(tracks.items()):
        axes.plot(
            *line.position.T,
            color=colours[number],
            lw=0.6,
            alpha=0.6,
            zorder=3,
            label=None if order else "track that ended before",
            gid=TRAIL,
        )


def _track(axes: Any, line: PlanarLine, colour: str, label: str | None) -> None:
    axes.plot(*line.position.T, color=colour, lw=1.4, zorder=4, label=label, gid=WAY)
    if line.covariance is None:
        return
    for row in range(0, len(line.position), max(1, -(-len(line.position) // ELLIPSES))):
        outline = line.position[row] + ellipse(line.covariance[row], SIGMAS, CORNERS)
        axes.plot(*np.vstack([outline, outline[:1]]).T, color=colour, lw=0.7, zorder=4)


def _over_time(axes: Any, view: FusionView, axis: int, name: str, first: int) -> None:
    """Draw one coordinate of all tracks, or its error, with the 2 sigma band over time."""
    of_error, colours = len(view.tracks) == 1 and len(view.truth) == 1, _colours(view.tracks)
    for number, line in view.tracks.items():
        time = (line.stamp_ns - first) * 1e-9
        value = line.position[:, axis]
        if of_error:
            value = value - _at(next(iter(view.truth.values())), line.stamp_ns, axis)
        axes.plot(time, value, color=colours[number], lw=1.2, zorder=4)
        if line.covariance is not None:
            spread = SIGMAS * np.sqrt(np.maximum(line.covariance[:, axis, axis], 0))
            middle = np.zeros_like(value) if of_error else value
            axes.fill_between(
                time,
                middle - spread,
                middle + spread,
                color=colours[number],
                alpha=0.18,
                lw=0,
                zorder=3,
            )
            if of_error and len(spread):
                reach = max(BAND / SIGMAS * np.median(spread), np.percentile(np.abs(value), 99))
                axes.set_ylim(-reach, reach)
    if not of_error:
        for line in view.truth.values():
            axes.plot(
                (line.stamp_ns - first) * 1e-9,
                line.position[:, axis],
                color="black",
                lw=0.9,
                ls=DASHED,
                zorder=5,
            )
    title = f"error of {name}, 2σ band" if of_error else f"{name}, 2σ band"
    axes.set(title=title, ylabel="[m]")
    axes.grid(visible=True)
    if not view.tracks:
        axes.text(0.5, 0.5, "no tracks", transform=axes.transAxes, ha="center", color=PALE)


def _at(line: PlanarLine, stamps: NDArray[np.int64], axis: int) -> NDArray[np.float64]:
    if not len(line.stamp_ns):
        return np.full(len(stamps), np.nan)
    start = line.stamp_ns[0]
    values: NDArray[np.float64] = np.interp(
        stamps - start, line.stamp_ns - start, line.position[:, axis]
    )
    return values


def _consistency(axes: Any, view: FusionView, first: int) -> None:
    top = 2.0
    for sensor, (stamps, ratio) in view.nis.items():
        colour, marker = SENSORS.get(sensor, OTHER)
        axes.plot(
            (stamps - first) * 1e-9,
            ratio,
            marker,
            ms=3.0,
            mew=0,
            color=colour,
            label=f"{sensor}: {100 * np.mean(ratio <= 1):.0f} % below" if len(ratio) else sensor,
        )
        top = max(top, 1.2 * float(np.percentile(ratio, 98))) if len(ratio) else top
    axes.axhline(1.0, color="black", lw=0.9, ls=DASHED)
    axes.set(title="NIS over its 95 % limit", xlabel="time [s]", ylim=(0, top))
    axes.grid(visible=True)
    if view.nis:
        opaque_legend(axes, "upper right", ncols=2)


def _counts(axes: Any, view: FusionView, first: int) -> None:
    """Draw the number of tracks over time."""
    stamps = np.unique(np.concatenate([line.stamp_ns for line in view.tracks.values()]))
    counts = sum(np.isin(stamps, line.stamp_ns).astype(int) for line in view.tracks.values())
    axes.step((stamps - first) * 1e-9, counts, where="post", color=TRACK_COLOURS[0], lw=1.4)
    axes.set(title="tracks", xlabel="time [s]", ylim=(0, None))
    axes.grid(visible=True)
