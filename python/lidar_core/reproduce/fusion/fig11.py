"""`fusion-fig11`: the linear filter over the power of the noise."""

from typing import Any

from lidar_core.reproduce.common import BLUE, GREY, RED
from lidar_core.reproduce.fusion.contenders import LINEAR, LINEAR_LIDAR, ours, printed
from lidar_core.reproduce.fusion.fig10 import Curves, rows_of, sweep
from lidar_core.reproduce.fusion.laser_radar import LEVELS, SAMPLE_1, course
from lidar_core.reproduce.types import Item, Request, Result

NAMES = (LINEAR, LINEAR_LIDAR)


def _run(request: Request) -> Result:
    of = course(SAMPLE_1)
    filters = [{name: some[name] for name in NAMES} for some in (printed(), ours())]
    paper, best = (sweep(of, some, request) for some in filters)
    return Result(
        rows=tuple(rows_of(paper, best)),
        draw=lambda figure: _draw(figure, paper, best),
        scans=request.scans,
        note="Mean over draws of the error in the plane. Radar as a position, without its range"
        " rate. Paper mode: fixed noise; best mode: noise known. The paper shows a curve without"
        " numbers.",
        config={
            f"{mode} {name}": one.config
            for mode, some in zip(("paper", "best"), filters, strict=True)
            for name, one in some.items()
        },
    )


def _draw(figure: Any, paper: Curves, best: Curves) -> None:
    panel = figure.subplots()
    figure.suptitle("Linear Kalman filter", x=0.06, ha="left", fontweight="bold")
    for curves, mode, colour in ((paper, "paper mode", RED), (best, "best mode", BLUE)):
        for name, line in zip(NAMES, ("-", "--"), strict=True):
            panel.plot(LEVELS, curves[name], line, color=colour, label=f"{name}, {mode}")
    panel.axhline(0.21, color=GREY, ls=":", label="0.21 m, paper")
    panel.set(xlabel="power [dBW]", ylabel="RMSE in the plane [m]", yscale="log")
    panel.grid(visible=True)
    panel.legend()


ITEM = Item(
    name="fusion-fig11",
    title="LiDAR and radar: error of the linear filter over added noise (Fig. 11)",
    scans=100,
    minutes=1,
    run=_run,
    counts="draws",
    data=(SAMPLE_1,),
)
