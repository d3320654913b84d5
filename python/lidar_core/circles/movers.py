"""Elements of a map of circles that move, for pictures and tables."""

from collections.abc import Sequence

import numpy as np

from lidar_core.messages import TrackKind
from lidar_core.objects import CircleElements

SLOWEST = 0.05
"""Slower elements stand [m/s]."""
FARTHEST_STILL = 0.5
"""Elements of undecided kind that stayed within such a square did not move [m]."""


def moved(maps: Sequence[CircleElements]) -> set[int]:
    """Return the IDs of the elements that moved.

    They are GROUND in the last map that has them. The filter of the paper decides no kinds: there,
    and where the kind is undecided, the centres spread over more than `FARTHEST_STILL`.
    """
    kinds: dict[int, int] = {}
    lows: dict[int, tuple[float, float]] = {}
    highs: dict[int, tuple[float, float]] = {}
    for state in maps:
        rows = zip(state.id.tolist(), state.center.tolist(), state.kind.tolist(), strict=True)
        for number, (x, y), kind in rows:
            low, high = lows.get(number, (x, y)), highs.get(number, (x, y))
            lows[number] = (min(low[0], x), min(low[1], y))
            highs[number] = (max(high[0], x), max(high[1], y))
            kinds[number] = kind
    return {
        number
        for number, kind in kinds.items()
        if kind == TrackKind.GROUND
        or (
            kind == TrackKind.UNKNOWN
            and max(np.subtract(highs[number], lows[number])) > FARTHEST_STILL
        )
    }


def moving_at_end(maps: Sequence[CircleElements]) -> dict[int, float]:
    """Return the elements that move in the last map: speed [m/s] by ID, fastest first."""
    if not maps:
        return {}
    chosen = moved(maps)
    speeds = dict(zip(maps[-1].id.tolist(), speeds_of(maps[-1]), strict=True))
    moving = [one for one in speeds.items() if one[0] in chosen and one[1] > SLOWEST]
    return dict(sorted(moving, key=lambda one: -one[1]))


def speeds_of(state: CircleElements) -> list[float]:
    """Return the speed of every element of a map [m/s]."""
    speeds: list[float] = np.hypot(state.velocity[:, 0], state.velocity[:, 1]).tolist()
    return speeds
