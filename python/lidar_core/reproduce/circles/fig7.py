"""`circles-fig7`: place and radius of one cylinder over time, with their errors (Fig. 7)."""

from typing import Any

import numpy as np

from lidar_core.reproduce.circles.errors import PAPER_NETWORK
from lidar_core.reproduce.circles.runs import MODES, MapRun, Mode, network_of
from lidar_core.reproduce.circles.single import LEAST_SCANS, rows, settled, single
from lidar_core.reproduce.common import BLUE, GREY, RED, simulator_seed
from lidar_core.reproduce.types import Item, Request, Result, Row

RADIUS, TRAJECTORY, SPEED = 0.3, 2, 1.0
PAPER = (7.5769e-6, 0.0081, 0.0013, 0.0691, 0.0015, 0.0711)


def _run(request: Request) -> Result:
    from lidar_core.circles import CirclesConfig

    scans = max(LEAST_SCANS, request.scans)
    made = {mode: _made(mode, request.seed, scans) for mode in MODES}
    request.advance(scans)
    one = made["best"]
    table = zip(("x", "y", "radius"), *(_bias(made[mode]) for mode in MODES), strict=True)
    return Result(
        rows=(
            *rows("trajectory 2", {mode: [made[mode]] for mode in MODES}, PAPER),
            *(Row(f"trajectory 2: {name}, mean error", "m", None, *both) for name, *both in table),
        ),
        draw=lambda figure: _draw(figure, one),
        scans=len(one.seconds),
        note="Radius 0.3 m on a circle of 2 m at 1 m/s; the sensor moves and tilts."
        " Paper mode: the network paper-cnn and all stages as published. The picture: best mode.",
        config={"paper": CirclesConfig.paper(detector=PAPER_NETWORK), "best": CirclesConfig()},
    )


def _made(mode: Mode, seed: int, scans: int) -> MapRun:
    part = single(
        seed=simulator_seed(seed, 0),
        radius=RADIUS,
        trajectory=TRAJECTORY,
        speed=SPEED,
        sensor="swinging",
        scans=scans,
        network=network_of(mode),
    )
    return MapRun.of(part)


def _bias(one: MapRun) -> list[float | None]:
    """Mean errors of x, y and radius [m]."""
    late = settled(one)
    return late.mean(axis=0).tolist() if len(late) else [None] * 3


def _draw(figure: Any, one: MapRun) -> None:
    """Truth and estimate above, errors below, as the paper does."""
    panels = figure.subplots(2, 3, sharex=True)
    figure.suptitle("A cylinder of 0.3 m on a circle", x=0.06, ha="left", fontweight="bold")
    errors = one.errors(0)
    center = one.part["center"][:, 0]
    radius = np.full(len(center), one.part["radius"][0])
    for column, name in enumerate(("x", "y", "radius")):
        truth = radius if name == "radius" else center[:, column]
        panels[0, column].plot(one.seconds, truth, color=BLUE, label="truth")
        panels[0, column].plot(
            one.seconds, truth + errors[:, column], color=RED, ls=":", label="map"
        )
        panels[1, column].plot(one.seconds, 1e3 * errors[:, column], color=RED, lw=0.8)
        panels[1, column].axhline(0, color=GREY, lw=0.8)
        panels[0, column].set(title=f"{name} [m]")
        panels[1, column].set(xlabel="time [s]")
        for panel in panels[:, column]:
            panel.grid(visible=True)
    panels[0, 2].set_ylim(RADIUS - 0.02, RADIUS + 0.02)
    panels[0, 0].legend()
    panels[1, 0].set_ylabel("error [mm]")


ITEM = Item(
    name="circles-fig7",
    title="place and radius of a cylinder over time (Fig. 7)",
    scans=1200,
    minutes=0.1,
    run=_run,
)
