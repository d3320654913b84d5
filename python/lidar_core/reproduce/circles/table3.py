"""`circles-table3`: errors of networks on the lattice of circles."""

from collections.abc import Iterator, Sequence
from functools import cache
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from lidar_core.circles import CircleDetector, DatasetConfig, FitConfig, make_samples
from lidar_core.circles.dataset import lattice, split
from lidar_core.circles.samples import HITS
from lidar_core.reproduce.circles.errors import (
    PAPER_NETWORK,
    checksums,
    errors_of,
    groups,
    hits_name,
)
from lidar_core.reproduce.common import BLUE, GREY, RED
from lidar_core.reproduce.jobs import Job, Part, run
from lidar_core.reproduce.types import Item, Measured, Request, Row

Errors: TypeAlias = tuple[float, float, float]
Table: TypeAlias = dict[tuple[str, str], Errors | None]
NOTHING = (None, None, None)
PAPER: dict[str, Errors] = {
    "test": (0.025035, 0.008345, 0.014296),
    "train + validation": (0.023907, 0.007969, 0.014166),
}
"""Loss [m^2], MSE [m^2], MAE [m], Table III."""
DETECTORS = (PAPER_NETWORK, "cnn", "ml")
GROUPS = ("whole, 4 hits or more", "cut", *(hits_name(low, high) for low, high in HITS))
"""Of test samples, see `groups`."""
QUANTITIES = (("loss", "m^2"), ("MSE", "m^2"), ("MAE", "m"))
BLOCK, BLOCKS_PER_JOB = 4096, 4
"""Neighbouring samples that are made together; blocks are taken in random order."""
OTHERS = 4
"""One in so many samples of train and validation is looked at: about as many as of the test."""


def _measure(request: Request) -> Measured:
    models = tuple(checksums().items())
    parts = run(list(_jobs(request, models)), request)
    errors = {
        (name, where): _quantities(parts, name, where)
        for name in DETECTORS
        for where in (*PAPER, *GROUPS)
    }
    return Measured(
        (errors,),
        scans=int(sum(part["cnn, test"][0] for part in parts)),
        note="Paper mode: the network of Table I, paper-cnn. Best mode: cnn and the likelihood fit,"
        " ml. Neither of these learnt from the lattice; train + validation, of which every"
        f" {OTHERS}th sample is taken, is as new to them as the test. Loss: eq. 7.",
        config={"lattice": DatasetConfig(), "fit": FitConfig()},
    )


@cache
def _circles() -> NDArray[np.float64]:
    return lattice(DatasetConfig())


@cache
def _is_test(seed: int) -> NDArray[np.bool_]:
    """Return which samples belong to the test part, shape (samples,)."""
    config = DatasetConfig()
    count = len(_circles()) * config.draws
    is_test = np.zeros(count, np.bool_)
    is_test[split(config, count, "test", seed=seed)] = True
    return is_test


def _jobs(request: Request, models: tuple[tuple[str, str], ...]) -> Iterator[Job]:
    """Yield jobs with at least `request.scans` test samples together, or with all there are."""
    is_test = _is_test(request.seed)
    starts = np.arange(0, len(is_test), BLOCK)
    order = np.random.default_rng([request.seed, BLOCK]).permutation(starts)
    sizes = np.array([is_test[start : start + BLOCK].sum() for start in order])
    enough = int(np.searchsorted(np.cumsum(sizes), request.scans)) + 1
    for first in range(0, min(enough, len(order)), BLOCKS_PER_JOB):
        chosen = slice(first, min(first + BLOCKS_PER_JOB, enough))
        arguments = {
            "seed": request.seed,
            "starts": tuple(map(int, order[chosen])),
            "models": models,
        }
        name = f"circles-table3-{request.seed}-{first}-{len(order[chosen])}"
        yield Job(name, sums, arguments, int(sizes[chosen].sum()))


def sums(seed: int, starts: tuple[int, ...], models: tuple[tuple[str, str], ...]) -> Part:
    """Return sums over blocks of the lattice: samples, squared and absolute errors per detector.

    The sums are over `PAPER` and, for the test set alone, over `GROUPS`. `models`: checksums of the
    networks. With another network, the part is computed again.
    """
    config = DatasetConfig()
    is_test = _is_test(seed)
    found: Part = {}
    known = {name: CircleDetector(name) for name in DETECTORS}
    for start in starts:
        count = min(BLOCK, len(is_test) - start)
        samples = make_samples(config, count=count, seed=seed, start=start, circles=_circles())
        here = is_test[start : start + count]
        chosen = {
            "test": np.flatnonzero(here),
            "train + validation": np.flatnonzero(~here)[::OTHERS],
        }
        for where, numbers in chosen.items():
            some = samples.take(numbers)
            places = groups(some.n_hits, some.is_whole(config.scanner)) if where == "test" else {}
            for name, detector in known.items():
                errors = errors_of(detector, some, config.scanner)
                _add(found, f"{name}, {where}", errors)
                for group in GROUPS if places else ():
                    _add(found, f"{name}, {group}", errors[places[group]])
    return found


def _add(found: Part, name: str, errors: NDArray[np.float64]) -> None:
    value = np.array([len(errors), np.square(errors).sum(), np.abs(errors).sum()])
    found[name] = found.get(name, 0.0) + value


def _quantities(parts: Sequence[Part], name: str, where: str) -> Errors | None:
    """Values of `QUANTITIES` of a detector `name` over the samples `where`; None without samples.

    The first is the loss of eq. 7: the sum of the squared errors of x, y and radius, 3 MSE.
    """
    count, squares, absolutes = np.sum([part[f"{name}, {where}"] for part in parts], axis=0)
    if not count:
        return None
    return (float(squares / count), float(squares / count) / 3, float(absolutes / count) / 3)


def _rows(errors: Table) -> Iterator[Row]:
    for where, published in PAPER.items():
        paper, small, fit = (errors[name, where] or NOTHING for name in DETECTORS)
        for place, (quantity, unit) in enumerate(QUANTITIES):
            yield Row(f"{where}: {quantity}", unit, published[place], paper[place], small[place])
            yield Row(f"{where}, ml: {quantity}", unit, published[place], None, fit[place])
    for group in GROUPS:
        paper, small, fit = (errors[name, group] or NOTHING for name in DETECTORS)
        for place, (quantity, unit) in enumerate(QUANTITIES[1:], start=1):
            yield Row(f"test, {group}: {quantity}", unit, None, paper[place], small[place])
            yield Row(f"test, {group}, ml: {quantity}", unit, None, None, fit[place])


def _draw(figure: Any, errors: Table) -> None:
    """Draw MSE and MAE on the test samples."""
    panels = figure.subplots(1, 2)
    colours = {"paper": GREY, PAPER_NETWORK: RED}
    values = {"paper": PAPER["test"]}
    values |= {name: found for name in DETECTORS if (found := errors[name, "test"]) is not None}
    for axes, place, scale in zip(panels, (1, 2), ("log", "linear"), strict=True):
        bars = axes.bar(
            list(values),
            [found[place] for found in values.values()],
            color=[colours.get(name, BLUE) for name in values],
        )
        axes.bar_label(bars, fmt="{:.2g}")
        axes.set(yscale=scale, ylabel=" [".join(QUANTITIES[place]) + "]")


ITEM = Item(
    name="circles-table3",
    title="errors of networks on the test samples of the lattice (Table III)",
    scans=402_308,
    minutes=17,
    measure=_measure,
    rows=_rows,
    draw=_draw,
    grid="y",
    heading="Circles of the lattice: test samples",
    counts="test samples",
)
