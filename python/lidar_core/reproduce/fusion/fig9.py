"""`fusion-fig9`: positions with three powers of noise."""

from collections.abc import Mapping
from typing import Any

from lidar_core.reproduce.fusion.contenders import BEST
from lidar_core.reproduce.fusion.laser_radar import SAMPLE_1
from lidar_core.reproduce.fusion.noisy_tracks import (
    MEASURED,
    Ways,
    configs,
    draw_way,
    each,
    plane,
    rows,
    ways,
)
from lidar_core.reproduce.types import Item, Request, Result

LEVELS = {16: -16.0, 8: -8.0, 0: 0.0}
"""The figure's labels [dB], and the power that its axes fit [dBW]."""


def _run(request: Request) -> Result:
    table, found = [], {}
    for label, level in LEVELS.items():
        found[label] = ways(level, request)
        table += rows(f"2-D RMSE, label {label} dB", each(found[label], plane))
    request.advance(request.scans)
    return Result(
        rows=tuple(table),
        draw=lambda figure: _draw(figure, found),
        scans=request.scans,
        note="The paper's labels of 16, 8 and 0 dB are read as noise of -16, -8 and 0 dBW: that"
        " fits its axes. It shows positions without numbers.",
        config=configs(),
    )


def _draw(figure: Any, found: Mapping[int, Ways]) -> None:
    panels = figure.subplots(1, len(found), sharex=True, sharey=True)
    figure.suptitle("Positions with noise", x=0.06, ha="left", fontweight="bold")
    for panel, (label, one) in zip(panels, found.items(), strict=True):
        draw_way(panel, one, (MEASURED, BEST))
        panel.set(xlabel="x [m]", title=f"label {label} dB", xlim=(2, 13), ylim=(-16, 4))
    panels[0].set_ylabel("y [m]")
    panels[0].legend(fontsize=8)


ITEM = Item(
    name="fusion-fig9",
    title="LiDAR and radar: positions with 16, 8 and 0 dB of noise (Fig. 9)",
    scans=20,
    minutes=0.2,
    run=_run,
    counts="draws",
    data=(SAMPLE_1,),
)
