"""`fusion-fig7`: x and y over time, measured with noise and filtered."""

from typing import Any

import numpy as np

from lidar_core.reproduce.fusion.laser_radar import PAPER_LEVEL, SAMPLE_1, course
from lidar_core.reproduce.fusion.noisy_tracks import STYLES, Ways, configs, each, rows, truth, ways
from lidar_core.reproduce.types import Item, Request, Result


def _run(request: Request) -> Result:
    found = ways(PAPER_LEVEL, request)
    request.advance(request.scans)
    table = []
    for axis, name in enumerate("xy"):
        errors = each(found, lambda wrong, axis=axis: _rmse(wrong[..., axis]))
        table += rows(f"RMSE of {name}", errors)
    return Result(
        rows=tuple(table),
        draw=lambda figure: _draw(figure, found),
        scans=request.scans,
        note=f"White noise of {PAPER_LEVEL:g} dBW; the paper does not say how much it added, and"
        " shows curves without numbers.",
        config=configs(),
    )


def _rmse(wrong: Any) -> float:
    return float(np.sqrt(np.square(wrong).mean(axis=1)).mean())


def _draw(figure: Any, found: Ways) -> None:
    panels = figure.subplots(2, 1, sharex=True)
    figure.suptitle("Response to noisy measurements", x=0.06, ha="left", fontweight="bold")
    stamps = course(SAMPLE_1).truth.stamps_ns
    seconds = (stamps - stamps[0]) * 1e-9
    for axis, (panel, name) in enumerate(zip(panels, "xy", strict=True)):
        for who, way in found.items():
            panel.plot(seconds, way[0, :, axis], label=who, **STYLES[who])
        panel.plot(seconds, truth()[:, axis], label="truth", **STYLES["truth"])
        panel.set_ylabel(f"{name} [m]")
        panel.grid(visible=True)
    panels[1].set_xlabel("time [s]")
    panels[0].legend(fontsize=8, ncols=3)


ITEM = Item(
    name="fusion-fig7",
    title="LiDAR and radar: x and y over time, with added noise (Fig. 7)",
    scans=20,
    minutes=0.1,
    run=_run,
    counts="draws",
    data=(SAMPLE_1,),
)
