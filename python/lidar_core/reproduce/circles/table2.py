"""`circles-table2`: number of circles on the lattice, and their split."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from lidar_core.circles import CircleNetwork, DatasetConfig
from lidar_core.circles.dataset import Part, lattice, split
from lidar_core.reproduce.common import BLUE, GREY, RED
from lidar_core.reproduce.types import Item, Measured, Request, Row

PAPER = {"train": 1_287_356, "validation": 321_839, "test": 402_299, "all": 2_011_494}
"""Samples, Table II."""
PARTS: tuple[Part, ...] = ("train", "validation", "test", "all")


def _measure(request: Request) -> Measured:
    config = DatasetConfig()
    circles = len(lattice(config))
    paper = _counts([(config, circles * config.draws)], request.seed)
    learnt = [DatasetConfig.load(one) for one in CircleNetwork("cnn").card["training"]["datasets"]]
    best = _counts([(one, one.circles) for one in learnt], request.seed)
    request.advance(request.scans)
    return Measured(
        (circles, sum(one.circles for one in learnt), paper, best),
        drawn=(paper, best),
        scans=ITEM.scans,
        note="Paper mode: the lattice of sec. IV-B, kept when a ray of the paper's scanner meets"
        " the circle in range; two measurements of each. Circles that rays just touch decide the"
        " last 50. Best mode: what the small network, cnn, learnt from; each circle once.",
        config={"lattice": config},
    )


def _rows(circles: int, learnt: int, paper: dict[str, float], best: dict[str, float]) -> list[Row]:
    return [
        Row("circles", "count", PAPER["all"] / 2, circles, learnt),
        *(Row(part, "count", PAPER[part], paper[part], best[part]) for part in PARTS),
        Row("share of the test whose twin is in train", "1", None, paper["twins"], best["twins"]),
    ]


def _counts(datasets: list[tuple[DatasetConfig, int]], seed: int) -> dict[str, float]:
    """Samples per part; under `twins` the share of test samples whose circle is also in train."""
    counts: dict[str, float] = dict.fromkeys(PARTS, 0.0)
    with_twin = 0
    for config, samples in datasets:
        numbers = {part: split(config, samples, part, seed=seed) for part in PARTS}
        for part in PARTS:
            counts[part] += len(numbers[part])
        tested, learnt = numbers["test"] // config.draws, numbers["train"] // config.draws
        with_twin += int(np.isin(tested, learnt).sum())
    return counts | {"twins": with_twin / counts["test"]}


def _draw(figure: Any, paper: dict[str, float], best: dict[str, float]) -> None:
    """Draw the samples per part."""
    axes = figure.subplots()
    columns: tuple[tuple[str, Mapping[Any, float], str], ...] = (
        ("paper", PAPER, GREY),
        ("paper mode", paper, RED),
        ("best mode", best, BLUE),
    )
    for offset, (name, counts, colour) in zip((-0.25, 0, 0.25), columns, strict=True):
        bars = axes.bar(
            np.arange(len(PARTS)) + offset,
            [counts[part] for part in PARTS],
            0.24,
            color=colour,
            label=name,
        )
        axes.bar_label(bars, fmt="{:,.0f}", fontsize=6)
    axes.set_xticks(range(len(PARTS)), PARTS)
    axes.legend()


ITEM = Item(
    name="circles-table2",
    title="circles of the lattice, dealt out to train, validation and test (Table II)",
    scans=1,
    minutes=0.1,
    measure=_measure,
    rows=_rows,
    draw=_draw,
    grid="y",
    heading="Samples",
    counts="dataset",
)
