"""`circles-fig5`: loss of the networks of the package during training (Fig. 5)."""

from collections.abc import Iterator
from typing import Any

from lidar_core.circles import CircleNetwork
from lidar_core.reproduce.circles.errors import PAPER_NETWORK
from lidar_core.reproduce.common import BLUE, GREY, RED
from lidar_core.reproduce.types import Item, Measured, Request, Row

PAPER = 0.023907
"""Loss on training and validation data after 106 epochs [m^2], Table III."""
SMALL = "cnn"


def _measure(request: Request) -> Measured:
    paper, small = (CircleNetwork(name).card for name in (PAPER_NETWORK, SMALL))
    request.advance(request.scans)
    return Measured(
        (paper, small),
        scans=ITEM.scans,
        note="Read from the cards of the networks, which tell how each of them was trained; passes"
        " over the training data. Shipped are the weights that validation preferred. Paper mode:"
        " paper-cnn on the lattice, the loss of eq. 7. Best mode: cnn on its own, harder data,"
        " three times its MSE, which is eq. 7, too.",
    )


def curve(card: dict[str, Any], quantity: str) -> dict[float, float]:
    """Values of one metric in a model card, by the number of passes over the training data."""
    parts, before = card["training"].get("parts", 1), card.get("start", {}).get("passes", 0)
    return {before + row["epoch"] / parts: row[quantity] for row in card["metrics"]}


def _curves(paper: dict[str, Any], small: dict[str, Any]) -> dict[str, dict[float, float]]:
    squares = curve(small, "validation_mse")
    return {
        "training": curve(paper, "train_loss"),
        "validation": curve(paper, "validation_loss"),
        SMALL: {passes: 3 * value for passes, value in squares.items()},
    }


def _rows(paper: dict[str, Any], small: dict[str, Any]) -> Iterator[Row]:
    curves = _curves(paper, small)
    shipped = {
        name: list(values.values())[int(card["best_epoch"]) - 1]
        for (name, values), card in zip(curves.items(), (paper, paper, small), strict=True)
    }
    yield Row("loss of the shipped weights, training", "m^2", PAPER, shipped["training"])
    yield Row(
        "loss of the shipped weights, validation",
        "m^2",
        PAPER,
        shipped["validation"],
        shipped[SMALL],
    )
    for name in ("training", "validation"):
        for passes, value in curves[name].items():
            yield Row(f"loss, {name}@{passes:g}", "m^2", None, value, None)
    for passes, value in curves[SMALL].items():
        yield Row(f"loss, {SMALL}, validation@{passes:g}", "m^2", None, None, value)


def _draw(figure: Any, paper: dict[str, Any], small: dict[str, Any]) -> None:
    axes = figure.subplots()
    labels = {
        "training": f"{PAPER_NETWORK}, training",
        "validation": f"{PAPER_NETWORK}, validation",
        SMALL: f"{SMALL}, validation, other data",
    }
    colours = {"training": GREY, "validation": RED, SMALL: BLUE}
    for name, values in _curves(paper, small).items():
        axes.plot(
            list(values), list(values.values()), marker=".", color=colours[name], label=labels[name]
        )
    axes.axhline(PAPER, color=GREY, ls=":", label="the paper's, 106 epochs")
    axes.set(yscale="log", xlabel="passes over the training data", ylabel="loss of eq. 7 [m^2]")
    axes.legend()


ITEM = Item(
    name="circles-fig5",
    title="loss of the networks while they learnt (Fig. 5)",
    scans=1,
    minutes=0.1,
    measure=_measure,
    rows=_rows,
    draw=_draw,
    heading="Loss while the networks learnt",
    counts="training",
)
