"""`flying-fig3`: a flying object enters an empty voxel and leaves it; G(v) against log-odds."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_core.flying import FlyingConfig, VoxelMapConfig
from lidar_core.flying.voxel_map import VoxelMap
from lidar_core.reproduce.common import BLUE, GREY, RED
from lidar_core.reproduce.flying.simulated.flights import both_modes
from lidar_core.reproduce.types import Item, Measured, Request, Row

SECONDS_PER_SCAN = 0.1
ENTERS, LEAVES = 2.0, 4.5
"""Times at which the object enters the voxel and leaves it [s]."""
LOG_ODDS_OCCUPIED, LOG_ODDS_FREE = 0.85, -0.4
LOG_ODDS_LIMITS = (-2.0, 3.5)
"""As Hornung et al., "OctoMap", 2013, suggest them; occupied from 0 up, free below (no unit)."""
DISTANCE = 10.0
"""From the sensor to the voxel [m]."""
RAYS = 4
"""Rays of a scan through the voxel along each of two axes: 16 in all, as an OS1-128's at 10 m."""
POINTS = 4
"""Points of a scan on the object."""
FLYING = 2


def _measure(request: Request) -> Measured:
    times = np.asarray(SECONDS_PER_SCAN * np.arange(request.scans), np.float64)
    is_inside = (times >= ENTERS) & (times < LEAVES)
    log_odds = _log_odds(is_inside)
    values = {}
    for name, config in both_modes().items():
        values[name] = _values(config, is_inside)
        request.advance(request.scans // 2)
    return Measured(
        (times, log_odds, values),
        scans=request.scans,
        note="The paper shows curves without numbers. Log-odds have no modes: their numbers stand"
        " in both columns. The points of the object are taken for flying, as in the paper.",
        config={name: config.voxel_map for name, config in both_modes().items()},
    )


def _log_odds(is_inside: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return L(v) after every scan, eqs 3 and 4, saturated."""
    value, values = 0.0, []
    for inside in is_inside:
        step = LOG_ODDS_OCCUPIED if inside else LOG_ODDS_FREE
        value = float(np.clip(value + step, *LOG_ODDS_LIMITS))
        values.append(value)
    return np.array(values)


def _values(config: FlyingConfig, is_inside: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return G(v) after every scan of the map itself."""
    size = config.voxel_map.voxel_size
    voxel_map = VoxelMap(config.voxel_map)
    places = size * (np.arange(RAYS) + 0.5) / RAYS
    y, z = (axis.ravel() for axis in np.meshgrid(places, places))
    beyond = np.stack([np.full(y.shape, DISTANCE + 5.0), y, z], axis=-1)
    origins = beyond * [0.0, 1.0, 1.0]
    inside = beyond.copy()
    inside[:POINTS, 0] = DISTANCE + size / 2
    values = []
    for is_hit in is_inside:
        points = inside if is_hit else beyond
        point_class = np.where(points[:, 0] < DISTANCE + size, FLYING, 1).astype(np.uint8)
        voxel_map.integrate(points, point_class, origins)
        values.append(float(voxel_map.values_at([[DISTANCE + size / 2, size / 2, size / 2]])[0]))
    return np.array(values)


def _rows(
    times: NDArray[np.float64],
    log_odds: NDArray[np.float64],
    values: dict[str, NDArray[np.float64]],
) -> list[Row]:
    rows = []
    of_log_odds = _summary(times, log_odds >= 0, log_odds < 0)
    of_values = [_summary(times, *_states(one)) for one in values.values()]
    names = (("scans taken for occupied", "1"), ("time until free again", "s"))
    for number, (name, unit) in enumerate(names):
        rows.append(Row(f"{name}, log-odds", unit, None, *[of_log_odds[number]] * 2))
        rows.append(Row(f"{name}, G(v)", unit, None, *(one[number] for one in of_values)))
    return rows


def _states(values: NDArray[np.float64]) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return whether G(v) is at least tentatively occupied, and whether it is free (eq. 7)."""
    bounds = VoxelMapConfig()
    return values >= bounds.threshold_tentative, values < bounds.threshold_uncertain


def _summary(
    times: NDArray[np.float64],
    is_occupied: NDArray[np.bool_],
    is_free: NDArray[np.bool_],
) -> tuple[float, float | None]:
    """Number of scans in which the voxel counts as occupied; time until it is free again [s].

    The time starts when the object leaves the voxel; None if the voxel does not become free.
    """
    after = np.flatnonzero(is_free & (times >= LEAVES))
    # An object is gone with the first scan after it left: that scan may free the voxel at once.
    until = float(times[after[0]] - LEAVES) + SECONDS_PER_SCAN if len(after) else None
    return float(is_occupied.sum()), until


def _draw(
    figure: Any,
    times: NDArray[np.float64],
    log_odds: NDArray[np.float64],
    values: dict[str, NDArray[np.float64]],
) -> None:
    """Draw the values above and the states below."""
    panels = figure.subplots(3, 1, sharex=True)
    panels[0].step(times, log_odds, where="post", color="#57606a")
    panels[0].set_ylabel("L(v)")
    panels[2].step(
        times, np.where(log_odds >= 0, 2, 0), where="post", color="#57606a", label="log-odds"
    )
    for (name, one), colour in zip(values.items(), (RED, BLUE), strict=True):
        occupied, free = _states(one)
        panels[1].step(times, one, where="post", color=colour)
        state = np.where(occupied, 2, np.where(free, 0, 1))
        panels[2].step(times, state, where="post", color=colour, label=f"G(v), {name} mode")
    panels[1].set_ylabel("G(v)")
    panels[2].set(
        yticks=[0, 1, 2], yticklabels=["free", "uncertain", "occupied"], xlabel="time [s]"
    )
    panels[2].legend(fontsize=8)
    for panel in panels:
        panel.axvspan(ENTERS, LEAVES, color=GREY, alpha=0.2)


ITEM = Item(
    name="flying-fig3",
    title="G(v) against log-odds for an object that enters a voxel and leaves it (Fig. 3)",
    scans=70,
    minutes=0.1,
    measure=_measure,
    rows=_rows,
    draw=_draw,
    heading="A flying object crosses a voxel",
)
