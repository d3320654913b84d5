"""`circles-table3`: how wrong networks are on the lattice of circles."""

from collections.abc import Iterator, Sequence
from functools import cache
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from lidar_core.circles import CircleDetector, DatasetConfig, FitConfig, make_samples
from lidar_core.circles.dataset import lattice, split
from lidar_core.reproduce.circle_errors import PAPER_NETWORK, checksums, errors_of
from lidar_core.reproduce.common import BLUE, GREY, RED
from lidar_core.reproduce.jobs import Job, Part, run
from lidar_core.reproduce.types import Item, Request, Result, Row

Errors: TypeAlias = tuple[float, float, float]
PAPER: dict[str, Errors] = {
    "test": (0.025035, 0.008345, 0.014296),
    "train + validation": (0.023907, 0.007969, 0.014166),
}
"""Loss [m^2], MSE [m^2], MAE [m], Table III."""
QUANTITIES = (("loss", "m^2"), ("MSE", "m^2"), ("MAE", "m"))
BLOCK, BLOCKS_PER_JOB = 4096, 4
"""Neighbouring samples that are made together; blocks are taken in random order."""
OTHERS = 4
"""One in so many samples of train and validation is looked at: about as many as of the test."""


def _run(request: Request) -> Result:
    models = tuple(checksums().items())
    detectors = _detectors(models)
    parts = run(list(_jobs(request, models)), request)
    errors = {
        (name, where): _quantities(parts, name, where) for name in detectors for where in PAPER
    }
    return Result(
        rows=tuple(_rows(errors)),
        draw=lambda figure: _draw(figure, errors),
        scans=int(sum(part["test"][0] for part in parts)),
        note="Paper mode: Table I trained as published, if it comes with the package. Best mode:"
        " cnn and the likelihood fit, ml. Neither learnt from the lattice; train + validation, of"
        f" which every {OTHERS}th sample is taken, is as new to them as the test. Loss: eq. 7.",
        config={"lattice": DatasetConfig(), "fit": FitConfig()},
    )


@cache
def _circles() -> NDArray[np.float64]:
    return lattice(DatasetConfig())


@cache
def _is_test(seed: int) -> NDArray[np.bool_]:
    """Which samples are of the test."""
    config = DatasetConfig()
    count = len(_circles()) * config.draws
    is_test = np.zeros(count, np.bool_)
    is_test[split(config, count, "test", seed=seed)] = True
    return is_test


def _detectors(models: tuple[tuple[str, str], ...]) -> tuple[str, ...]:
    return (*(name for name, _ in models if name == PAPER_NETWORK), "cnn", "ml")


def _jobs(request: Request, models: tuple[tuple[str, str], ...]) -> Iterator[Job]:
    """Jobs with at least `request.scans` test samples, if there are so many."""
    is_test = _is_test(request.seed)
    starts = np.arange(0, len(is_test), BLOCK)
    order = np.random.default_rng([request.seed, BLOCK]).permutation(starts)
    sizes = np.array([is_test[start : start + BLOCK].sum() for start in order])
    enough = int(np.searchsorted(np.cumsum(sizes), request.scans)) + 1
    for first in range(0, min(enough, len(order)), BLOCKS_PER_JOB):
        chosen = slice(first, min(first + BLOCKS_PER_JOB, enough))
        arguments = {"seed": request.seed, "starts": tuple(map(int, order[chosen])),
                     "models": models}  # fmt: skip
        name = f"circles-table3-{request.seed}-{first}-{len(order[chosen])}"
        yield Job(name, sums, arguments, int(sizes[chosen].sum()))


def sums(seed: int, starts: tuple[int, ...], models: tuple[tuple[str, str], ...]) -> Part:
    """Sums over blocks of the lattice: samples; squared and absolute errors of each detector.

    `models` are the checksums of the networks: another network, another part.
    """
    config = DatasetConfig()
    is_test = _is_test(seed)
    found: Part = {where: np.zeros(1) for where in PAPER}
    known = {name: CircleDetector(name) for name in _detectors(models)}
    for start in starts:
        count = min(BLOCK, len(is_test) - start)
        samples = make_samples(config, count=count, seed=seed, start=start, circles=_circles())
        here = is_test[start : start + count]
        chosen = {"test": np.flatnonzero(here),
                  "train + validation": np.flatnonzero(~here)[::OTHERS]}  # fmt: skip
        for where, numbers in chosen.items():
            found[where] += len(numbers)
            for name, detector in known.items():
                errors = errors_of(detector, samples.take(numbers), config.scanner)
                value = np.array([np.square(errors).sum(), np.abs(errors).sum()])
                found[f"{name}, {where}"] = found.get(f"{name}, {where}", 0.0) + value
    return found


def _quantities(parts: Sequence[Part], name: str, where: str) -> Errors:
    """Values of `QUANTITIES`. Eq. 7 sums the squared errors of x, y and radius: 3 MSE."""
    count = sum(float(part[where][0]) for part in parts)
    squares, absolutes = np.sum([part[f"{name}, {where}"] for part in parts], axis=0) / count
    return (float(squares), float(squares) / 3, float(absolutes) / 3)


def _rows(errors: dict[tuple[str, str], Errors]) -> Iterator[Row]:
    for where, published in PAPER.items():
        for place, (quantity, unit) in enumerate(QUANTITIES):
            paper = errors.get((PAPER_NETWORK, where))
            yield Row(f"{where}: {quantity}", unit, published[place],
                      None if paper is None else paper[place],
                      errors["cnn", where][place])  # fmt: skip
            yield Row(f"{where}, ml: {quantity}", unit, published[place], None,
                      errors["ml", where][place])  # fmt: skip


def _draw(figure: Any, errors: dict[tuple[str, str], Errors]) -> None:
    """MSE and MAE on the test samples."""
    panels = figure.subplots(1, 2)
    figure.suptitle("Circles of the lattice: test samples", x=0.06, ha="left", fontweight="bold")
    colours = {"paper": GREY, PAPER_NETWORK: RED}
    values = {"paper": PAPER["test"]}
    values |= {name: found for (name, where), found in errors.items() if where == "test"}
    for axes, place, scale in zip(panels, (1, 2), ("log", "linear"), strict=True):
        bars = axes.bar(list(values), [found[place] for found in values.values()],
                        color=[colours.get(name, BLUE) for name in values])  # fmt: skip
        axes.bar_label(bars, fmt="{:.2g}")
        axes.set(yscale=scale, ylabel=" [".join(QUANTITIES[place]) + "]")
        axes.grid(visible=True, axis="y")


ITEM = Item(
    name="circles-table3",
    title="errors of networks on the test samples of the lattice (Table III)",
    scans=402_308,
    minutes=3,
    run=_run,
    counts="test samples",
)
