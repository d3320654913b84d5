"""`circles-table5`: one cylinder of 0.3 m on five ways (Table V)."""

from lidar_core.reproduce.circles.errors import PAPER_NETWORK
from lidar_core.reproduce.circles.single import draw_errors, rows, runs, worst_rows
from lidar_core.reproduce.types import Item, Request, Result

RADIUS = 0.3
PAPER = {
    1: (1.3187e-5, 0.0088, 0.0012, 0.0628, 0.0016, 0.0766),
    2: (7.5769e-6, 0.0081, 0.0013, 0.0691, 0.0015, 0.0711),
    3: (9.2896e-6, 0.0141, 0.0015, 0.0725, 0.0013, 0.0632),
    4: (2.8435e-5, 0.0099, 0.0018, 0.0703, 0.0010, 0.0588),
    5: (1.8651e-5, 0.0111, 0.0014, 0.0795, 0.0016, 0.0792),
}
"""Table V, by trajectory: MSE and largest error of radius, x and y."""
NAMES = {1: "line", 2: "circle", 3: "eight", 4: "stop and go", 5: "wandering"}
"""Our ways; the paper does not say what its are."""


def _run(request: Request) -> Result:
    from lidar_core.circles import CirclesConfig

    found = runs("circles-table5", [(RADIUS, number) for number in PAPER], request)
    table = []
    for number, paper in PAPER.items():
        some = {
            mode: [one for key, one in made.items() if key[1:3] == (number, 1.0)]
            for mode, made in found.items()
        }
        table += rows(f"{number} {NAMES[number]}", some, paper)
    best = found["best"]
    shown = {NAMES[key[1]]: one for key, one in best.items() if key[2:] == (1.0, "swinging")}
    return Result(
        rows=(*table, *worst_rows({mode: list(made.values()) for mode, made in found.items()})),
        draw=lambda figure: draw_errors(figure, shown, "A cylinder of 0.3 m, tilting sensor"),
        scans=sum(len(one.seconds) for one in best.values()),
        note="Radius 0.3 m; rows at 1 m/s, hovering and swinging sensor together; the worst of"
        " 0.3, 1 and 1.5 m/s below. Largest errors from 2 s after the first report on. The paper"
        " does not define its trajectories. Paper mode: the network paper-cnn and all stages as"
        " published.",
        config={"paper": CirclesConfig.paper(detector=PAPER_NETWORK), "best": CirclesConfig()},
    )


ITEM = Item(
    name="circles-table5",
    title="a cylinder on five ways: errors of radius and centre (Table V)",
    scans=30_000,
    minutes=2,
    run=_run,
)
