"""Texts that tell a user why a filter cannot use measurements."""

from collections import Counter
from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from lidar_core.fusion.config import IN_SPACE, FusionConfig
from lidar_core.fusion.measurement import Measurement
from lidar_core.fusion.states import is_in_space

PLACE = {False: ("range", "bearing"), True: ("range", "bearing", "elevation")}
"""What a radar has to measure for a place, in the plane and in space."""


def reasons(
    measurements: Iterable[Measurement], outcomes: NDArray[np.str_], config: FusionConfig
) -> dict[str, int]:
    """Number of measurements with the outcome "invalid", by the reason.

    Examples
    --------
    >>> seen = [Measurement(0, "radar", [0.1], measures=["bearing"])]
    >>> reasons(seen, np.array(["invalid"]), FusionConfig())
    {'no position to start from: a radar needs range and bearing': 1}
    """
    rows = zip(measurements, outcomes.tolist(), strict=True)
    return dict(Counter(_reason(m, config) for m, outcome in rows if outcome == "invalid"))


def lacks_heights(measurements: Sequence[Measurement], config: FusionConfig) -> str | None:
    """Say that a model in space cannot start because all places are in the plane; None if it can.

    Measurements without any place are no such case: they start no model at all.
    """
    if not is_in_space(config) or any(_has_place(m, in_space=True) for m in measurements):
        return None
    if not any(_has_place(m, in_space=False) for m in measurements):
        return None
    if config.method == "imm":
        name, cure = "imm_models", "models in the plane"
    else:
        name = f"model {config.model}"
        cure = f'model="{config.model.removesuffix(IN_SPACE)}"'
    return (
        f"{name}: a target in space starts with a height, and no measurement has one; use {cure},"
        ' or add the height of a LiDAR (columns={"z": "NAME"}) or the elevation of a radar'
        ' (columns={"elevation": "NAME"})'
    )


def _has_place(m: Measurement, *, in_space: bool) -> bool:
    """Return whether a measurement has a position, so that its finite values can start a target."""
    if m.sensor == "lidar":
        return len(m.values) > 2 or not in_space
    return m.sensor == "radar" and set(PLACE[in_space]) <= set(m.measures or ())


def _reason(m: Measurement, config: FusionConfig) -> str:
    in_space, measures = is_in_space(config), m.measures or ()
    if not np.isfinite(m.values).all():
        return "values that are not finite, such as those of empty cells"
    if "range" in measures and m.values[0] <= 0:
        return "ranges of 0 or less"
    if measures == ("elevation",) and not in_space:
        return "an elevation alone says nothing in the plane"
    if _has_place(m, in_space=in_space):
        return "targets overhead have no bearing in the plane"
    if m.sensor == "lidar":
        return "no height to start from: x and y alone"
    needed = f"{', '.join(PLACE[in_space][:-1])} and {PLACE[in_space][-1]}"
    return f"no position to start from: a radar needs {needed}"
