"""Panels beside a map of circles: speeds of moving elements, and counts, over time."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_core.circles.movers import SLOWEST, speeds_of
from lidar_core.viz.drawing.marks import TRACK_COLOURS
from lidar_core.viz.figure import PALE
from lidar_core.viz.views import CirclesView

STANDS = "#6b7280"
"""Colour of elements that did not move."""
MOST_CURVES = 6  # speeds over time: what moved in most scans


def seconds_of(view: CirclesView) -> NDArray[np.float64]:
    """Return the times of the scans since the first one [s]."""
    first = view.stamp_ns[0] if len(view.stamp_ns) else 0
    seconds: NDArray[np.float64] = (view.stamp_ns - first) * 1e-9
    return seconds


def draw_speeds(axes: Any, view: CirclesView, colours: Mapping[int, str]) -> None:
    """Draw the speeds over time of elements that have a colour; gaps where they stand."""
    time = seconds_of(view)
    found: dict[int, list[tuple[int, float]]] = {}
    for scan, state in enumerate(view.maps):
        for number, speed in zip(state.id.tolist(), speeds_of(state), strict=True):
            if number in colours:
                found.setdefault(number, []).append((scan, speed))
    times = {number: sum(speed > SLOWEST for _, speed in found[number]) for number in found}
    moving = [number for number, count in times.items() if count]
    longest = sorted(moving, key=lambda number: -times[number])[:MOST_CURVES]
    for number in sorted(longest):
        scans, speeds = np.array(found[number]).T
        told = np.where(speeds > SLOWEST, speeds, np.nan)
        axes.plot(
            time[scans.astype(np.intp)], told, color=colours[number], lw=1.3, label=str(number)
        )
    top = max((speed for number in longest for _, speed in found[number]), default=1.0)
    more = f", {MOST_CURVES} longest of {len(moving)}" if len(moving) > MOST_CURVES else ""
    axes.set(title=f"speed of what moves{more}", ylabel="[m/s]", ylim=(0, 1.35 * top))
    axes.set_xlim(_span(time))
    axes.grid(visible=True)
    if longest:
        axes.legend(fontsize=7, loc="upper left", ncols=MOST_CURVES)
    else:
        axes.text(0.5, 0.5, "nothing moves", transform=axes.transAxes, ha="center", color=PALE)


def draw_counts(axes: Any, view: CirclesView) -> None:
    """Draw the numbers of circles and elements per scan."""
    time = seconds_of(view)
    elements = [len(state.id) for state in view.maps]
    # Wide below narrow: where both counts are equal, both lines are seen.
    for counts, name, colour, width in (
        (view.n_circles, "circles found", "#f59e0b", 4.0),
        (elements, "elements", TRACK_COLOURS[0], 1.8),
    ):
        axes.plot(time, counts, color=colour, lw=width, label=name, drawstyle="steps-mid")
    top = max([1, *elements, *view.n_circles.tolist()])
    axes.set(title="circles and elements per scan", xlabel="time [s]", xlim=_span(time))
    axes.set_ylim(-0.05 * top, 1.3 * top)
    axes.grid(visible=True)
    axes.legend(fontsize=8, loc="upper left", ncols=2)


def _span(time: NDArray[np.float64]) -> tuple[float, float]:
    last = float(time[-1]) if len(time) else 0.0
    return (0.0, last if last > 0 else 1.0)
