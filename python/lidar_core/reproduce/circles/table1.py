"""`circles-table1`: the paper's network layer by layer, beside the small one."""

from collections.abc import Mapping
from typing import Any

from lidar_core.circles import CircleNetwork, Scanner
from lidar_core.circles.estimators.architecture import (
    CONVOLUTIONS,
    Layer,
    paper_layers,
    window_layers,
)
from lidar_core.reproduce.common import BLUE, RED
from lidar_core.reproduce.types import Item, Measured, Request, Row

PARAMETERS = 1_826_350
"""Sec. IV-A."""
INPUT, NEURONS = 1081, (125, 3)
"""Table I."""
FILTERS = (50, 50, 100, 100, 100, 100)
"""Table I."""
WIDTHS = (64, 128)
"""Of the small network that comes with the package: per ray, and on the whole."""


def _measure(request: Request) -> Measured:
    scanner = Scanner()
    paper, small = paper_layers(scanner.n_beams), window_layers(*WIDTHS)
    card = CircleNetwork("cnn").card
    request.advance(request.scans)
    return Measured(
        (paper, small, card, scanner.n_beams),
        drawn=(paper, small),
        scans=ITEM.scans,
        note="Paper mode: Table I without padding and without bias in the last layer, the only way"
        " to the published sum. Best mode: the network on windows, cnn.",
        config={"scanner": scanner},
    )


def _rows(
    paper: list[Layer], small: list[Layer], card: Mapping[str, Any], n_beams: int
) -> list[Row]:
    """Rows of the totals, then of single layers, with the values of the paper's Table I."""
    parameters = sum(layer.parameters for layer in paper)
    adds = (sum(layer.multiply_adds for layer in layers) for layers in (paper, small))
    rows = [
        Row("parameters", "count", PARAMETERS, parameters, card["parameters"]),
        Row("multiply-adds per object", "count", None, *adds),
        Row("size of the file", "byte", None, None, card["bytes"]),
        Row("input", "count", INPUT, n_beams),
    ]
    for layer, channels in zip(paper, (*FILTERS, *NEURONS), strict=True):
        rows.append(Row(f"{layer.name}: channels", "count", channels, layer.channels))
        if layer.name.startswith("C"):
            rows.append(Row(f"{layer.name}: length", "count", None, layer.length))
        rows.append(Row(f"{layer.name}: parameters", "count", None, layer.parameters))
    named = (
        Row(f"cnn, {layer.name}: parameters", "count", None, None, layer.parameters)
        for layer in small
    )
    return [*rows, *named]


def _draw(figure: Any, paper: list[Layer], small: list[Layer]) -> None:
    """Draw parameters and multiply-adds of every layer."""
    panels = figure.subplots(1, 2, sharey=True)
    for axes, what in zip(panels, ("parameters", "multiply_adds"), strict=True):
        start = 0
        for layers, colour, name in ((paper, RED, "Table I"), (small, BLUE, "cnn")):
            places = range(start, start + len(layers))
            sizes = [getattr(layer, what) for layer in layers]
            axes.barh(places, sizes, color=colour, label=f"{name}: {sum(sizes):,}")
            start += len(layers)
        axes.set(xscale="log", xlabel=what.replace("_", "-"))
        axes.set_yticks(range(start), [layer.name for layer in (*paper, *small)])
        axes.legend(fontsize=8)
    panels[0].invert_yaxis()


ITEM = Item(
    name="circles-table1",
    title="the network layer by layer: lengths, parameters, multiply-adds (Table I)",
    scans=len(CONVOLUTIONS) + len(NEURONS),
    minutes=0.05,
    measure=_measure,
    rows=_rows,
    draw=_draw,
    grid="x",
    heading="Layers of the networks",
    counts="layers",
)
