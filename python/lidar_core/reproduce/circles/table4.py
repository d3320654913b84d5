"""`circles-table4`: one cylinder on a circle, for five radii (Table IV)."""

from lidar_core.reproduce.circles.errors import PAPER_NETWORK
from lidar_core.reproduce.circles.single import draw_errors, rows, runs, worst_rows
from lidar_core.reproduce.types import Item, Request, Result

PAPER = {
    0.1: (8.7482e-6, 0.0073, 0.0014, 0.0610, 0.0011, 0.0680),
    0.15: (1.1542e-5, 0.0097, 0.0014, 0.0638, 0.0012, 0.0715),
    0.3: (7.5769e-6, 0.0081, 0.0013, 0.0691, 0.0015, 0.0711),
    0.45: (7.7660e-6, 0.0075, 0.0013, 0.0735, 0.0014, 0.0714),
    0.6: (0.0019, 0.0751, 0.0054, 0.1552, 0.0012, 0.0724),
}
"""Table IV, by radius [m]: MSE and largest error of radius, x and y."""
TRAJECTORY = 2


def _run(request: Request) -> Result:
    from lidar_core.circles import CirclesConfig

    found = runs("circles-table4", [(radius, TRAJECTORY) for radius in PAPER], request)
    table = []
    for radius, paper in PAPER.items():
        some = {
            mode: [one for key, one in made.items() if (key[0], key[2]) == (radius, 1.0)]
            for mode, made in found.items()
        }
        table += rows(f"r = {radius:g} m", some, paper)
    best = found["best"]
    shown = {f"r = {key[0]:g} m": one for key, one in best.items() if key[2:] == (1.0, "swinging")}
    return Result(
        rows=(*table, *worst_rows({mode: list(made.values()) for mode, made in found.items()})),
        draw=lambda figure: draw_errors(figure, shown, "A cylinder on a circle, tilting sensor"),
        scans=sum(len(one.seconds) for one in best.values()),
        note="On a circle of 2 m, 4 m ahead; rows at 1 m/s, hovering and swinging sensor together;"
        " the worst of 0.3, 1 and 1.5 m/s below. Largest errors from 2 s after the first report"
        " on. Paper mode: the network paper-cnn and all stages as published.",
        config={"paper": CirclesConfig.paper(detector=PAPER_NETWORK), "best": CirclesConfig()},
    )


ITEM = Item(
    name="circles-table4",
    title="single cylinders of five radii: errors of radius and centre (Table IV)",
    scans=36_000,
    minutes=2,
    run=_run,
)
