"""`fusion-fig8`: a change of direction, magnified."""

from typing import Any

import numpy as np

from lidar_core.reproduce.fusion.laser_radar import PAPER_LEVEL, SAMPLE_1
from lidar_core.reproduce.fusion.noisy_tracks import (
    MEASURED,
    STYLES,
    Ways,
    configs,
    draw_way,
    each,
    plane,
    rows,
    truth,
    ways,
)
from lidar_core.reproduce.types import Item, Request, Result

ZOOM = ((4.0, 7.0), (-13.0, -7.0))
"""Axes of the figure: x and y [m]."""


def _run(request: Request) -> Result:
    found = ways(PAPER_LEVEL, request)
    request.advance(request.scans)
    is_inside = _is_inside()
    turn = {name: way[:, is_inside] - truth()[is_inside] for name, way in found.items()}
    table = rows("2-D RMSE in the figure", {name: plane(wrong) for name, wrong in turn.items()})
    table += rows("2-D RMSE of the whole way", each(found, plane))
    table += rows(
        "largest error in the figure",
        {
            name: float(np.hypot(wrong[..., 0], wrong[..., 1]).max(axis=1).mean())
            for name, wrong in turn.items()
        },
    )
    return Result(
        rows=tuple(table),
        draw=lambda figure: _draw(figure, found),
        scans=request.scans,
        note=f"White noise of {PAPER_LEVEL:g} dBW; the paper does not say how much it added, and"
        " shows a way without numbers.",
        config=configs(),
    )


def _is_inside() -> Any:
    """Rows of the recording that the figure shows."""
    low, high = np.transpose(ZOOM)
    return ((truth() >= low) & (truth() <= high)).all(axis=1)


def _draw(figure: Any, found: Ways) -> None:
    panel = figure.subplots()
    figure.suptitle("A change of direction", x=0.06, ha="left", fontweight="bold")
    draw_way(panel, found, [name for name in STYLES if name in found and name != MEASURED])
    panel.set(xlabel="x [m]", ylabel="y [m]", xlim=ZOOM[0], ylim=(ZOOM[1][0] - 0.7, ZOOM[1][1]))
    panel.legend()


ITEM = Item(
    name="fusion-fig8",
    title="LiDAR and radar: a change of direction (Fig. 8)",
    scans=20,
    minutes=0.1,
    run=_run,
    counts="draws",
    data=(SAMPLE_1,),
)
