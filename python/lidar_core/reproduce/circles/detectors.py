"""`circles-detectors`: all circle estimators on the same circles at random places."""

from collections.abc import Callable, Iterator
from time import perf_counter
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from lidar_core.circles import CircleDetector, DatasetConfig, FitConfig, Samples, make_samples
from lidar_core.circles.samples import HITS
from lidar_core.reproduce.circles.chord_circles import chord_circles
from lidar_core.reproduce.circles.errors import (
    MEASURES,
    PAPER_NETWORK,
    checksums,
    groups,
    hits_name,
    measures,
)
from lidar_core.reproduce.common import RED
from lidar_core.reproduce.jobs import Job, Part, run
from lidar_core.reproduce.types import Item, Measured, Request, Row

CHORD = "triangle"
"""Name of the rule of ROS packages, see `chord_circles`."""
DETECTORS = (PAPER_NETWORK, "cnn", "ml", "mode", "taubin", "pratt", "kasa", CHORD)
BY_HITS = tuple(hits_name(low, high) for low, high in HITS)
"""Groups without p99: some are small."""
PER_JOB, OBJECTS, ROWS = 5_000, 10, 2_000
"""Circles per part, objects of one call whose time is taken, scans in one call."""
TIMED = 500
"""Circles of a part that are estimated once more for their time."""

Estimate: TypeAlias = Callable[[NDArray[np.float32]], NDArray[np.float64]]


def _measure(request: Request) -> Measured:
    parts = run(list(_jobs(request)), request)
    joined = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    chosen = groups(joined["hits"], joined["is_whole"])
    return Measured(
        (joined, chosen),
        scans=len(joined["hits"]),
        note="The paper's scanner, ranges with 0.01 m, circles anywhere. Paper mode: its network;"
        " best mode: each of the others. triangle: the circle around"
        " an equilateral triangle on the chord. Times: this computer, one thread,"
        f" {OBJECTS} scans of one object each in a call, median.",
        config={"dataset": DatasetConfig.continuous(circles=request.scans), "fit": FitConfig()},
    )


def _jobs(request: Request) -> Iterator[Job]:
    for start in range(0, request.scans, PER_JOB):
        count = min(PER_JOB, request.scans - start)
        arguments = {
            "seed": request.seed,
            "start": start,
            "count": count,
            "models": tuple(checksums().items()),
        }
        name = f"circles-detectors-{request.seed}-{start}-{count}"
        yield Job(name, estimated, arguments, count)


def estimated(seed: int, start: int, count: int, models: tuple[tuple[str, str], ...]) -> Part:
    """Return errors (N, 3) [m] of every detector, and times per circle [s].

    `models`: checksums of the networks. With another network, the part is computed again.
    """
    config = DatasetConfig.continuous(circles=start + count)
    samples = make_samples(config, count=count, seed=seed, start=start)
    bearings = config.scanner.bearings()
    part: Part = {"hits": samples.n_hits, "is_whole": samples.is_whole(config.scanner)}
    for name in DETECTORS:
        estimate = _estimate(name, bearings)
        part[name] = _errors(estimate, samples, config)
        if name != CHORD:  # numpy here: its time would say nothing
            part[f"{name}, seconds"] = _seconds(estimate, samples, config)
    return part


def _estimate(name: str, bearings: NDArray[np.float64]) -> Estimate:
    if name == CHORD:
        return lambda scans: chord_circles(scans, bearings)
    detector = CircleDetector(name)
    return lambda scans: np.asarray(detector.detect(scans, bearings))


def _errors(estimate: Estimate, samples: Samples, config: DatasetConfig) -> NDArray[np.float64]:
    found = []
    for start in range(0, len(samples), ROWS):
        rows = samples.take(np.arange(start, min(start + ROWS, len(samples))))
        found.append(estimate(rows.scans(config.scanner)) - rows.circles)
    return np.concatenate(found)


def _seconds(estimate: Estimate, samples: Samples, config: DatasetConfig) -> NDArray[np.float64]:
    """Time per circle of each call of an estimator [s], (calls,)."""
    scans = samples.take(np.arange(min(TIMED, len(samples)))).scans(config.scanner)
    times = []
    for start in range(0, len(scans), OBJECTS):
        some = scans[start : start + OBJECTS]
        before = perf_counter()
        estimate(some)
        times.append((perf_counter() - before) / len(some))
    return np.array(times)


def _rows(joined: Part, chosen: dict[str, NDArray[np.bool_]]) -> Iterator[Row]:
    """Yield rows of the errors per group, measure and detector, then the times per object."""
    for group, is_in in chosen.items():
        columns = {name: measures(joined[name][is_in]) for name in DETECTORS}
        told = [one for one in MEASURES.items() if one[0] != "p99" or group not in BY_HITS]
        for place, (measure, unit) in enumerate(told):
            for name in DETECTORS:
                yield _row(f"{group}, {name}: {measure}", unit, name, columns[name][place])
    for name in DETECTORS[: DETECTORS.index(CHORD)]:
        value = float(np.median(joined[f"{name}, seconds"])) * 1e6
        yield _row(f"{name}: time per object", "us", name, value)


def _row(title: str, unit: str, name: str, value: float | None) -> Row:
    is_paper = name == PAPER_NETWORK
    return Row(title, unit, None, value if is_paper else None, None if is_paper else value)


def _draw(figure: Any, joined: Part, chosen: dict[str, NDArray[np.bool_]]) -> None:
    """Draw MSE and MAE per detector over the number of hits."""
    panels = figure.subplots(1, 2)
    for place, (axes, measure) in enumerate(zip(panels, ("MSE", "MAE"), strict=True)):
        for number, name in enumerate(DETECTORS):
            values = [measures(joined[name][chosen[group]])[place] for group in BY_HITS]
            colour = RED if name == PAPER_NETWORK else f"C{number}"
            line = [np.nan if value is None else value for value in values]
            axes.plot(range(len(BY_HITS)), line, marker=".", color=colour, label=name)
        labels = [
            f"{low}+" if high is None else f"{low}-{high}" if high > low else f"{low}"
            for low, high in HITS
        ]
        axes.set_xticks(range(len(BY_HITS)), labels, rotation=60, fontsize=7)
        axes.set(yscale="log", xlabel="hits", ylabel=f"{measure} [{MEASURES[measure]}]")
    panels[1].legend(fontsize=8)


ITEM = Item(
    name="circles-detectors",
    title="networks, fits and a rule of thumb on circles anywhere: errors and times",
    scans=50_000,
    minutes=2,
    measure=_measure,
    rows=_rows,
    draw=_draw,
    heading="Ways to estimate a circle",
    counts="circles",
)
