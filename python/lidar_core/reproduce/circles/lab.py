"""`circles-lab`: a person who walks with swinging arms, and a barrel, in an operating volume."""

from typing import Any

import numpy as np

from lidar_core import circles
from lidar_core.reproduce.circles.runs import (
    GATE,
    MODES,
    MapRun,
    Measure,
    both,
    both_modes,
    config_of,
    lasting,
    mapped,
    network_of,
)
from lidar_core.reproduce.common import BLUE, GREY, RED, mean, share, simulator_seed
from lidar_core.reproduce.jobs import Job, Part, run
from lidar_core.reproduce.types import Item, Measured, Request
from lidar_core.sim import circle_scenes

WALKS = 10
PERSON, BARREL = 0, 1


def walk(*, seed: int, scans: int, network: str) -> Part:
    """Simulate and map one walk; `network` is that of `config_of`."""
    scene = circle_scenes.lab(seed, scans=scans)
    box = circles.PreprocessConfig.box(*circle_scenes.LAB_VOLUME)
    config = config_of(scene, network)
    volume = config.preprocess.model_copy(update={"planes": box.planes})
    config = config.model_copy(update={"preprocess": volume})
    return mapped(scene, config, seed=seed, scans=scans)


def _measure(request: Request) -> Measured:
    scans = max(60, request.scans // WALKS)
    count = max(1, min(WALKS, request.scans // scans))
    jobs = [
        Job(
            name=f"circles-lab-{request.seed}-{mode}-{number}",
            function=walk,
            arguments={
                "seed": simulator_seed(request.seed, number),
                "scans": scans,
                "network": network_of(mode),
            },
            scans=scans // len(MODES),
        )
        for mode in MODES
        for number in range(count)
    ]
    walks = [MapRun.of(part) for part in run(jobs, request)]
    paper, best = walks[:count], walks[count:]
    return Measured(
        (_measures(paper), _measures(best)),
        drawn=(best[0],),
        scans=scans * count,
        note="The paper shows its experiment without numbers; its person became two or three"
        " circles at times. Volume 5 x 6 x 4.9 m; the walls lie outside."
        " Paper mode: the network paper-cnn and all stages as published. The picture: best mode.",
        config=both_modes(),
    )


def _measures(walks: list[MapRun]) -> list[Measure]:
    reported, due = np.sum([one.presence() for one in walks], axis=0).tolist()
    person = np.concatenate([one.errors(PERSON)[:, :2] for one in walks])
    barrel = np.concatenate([one.errors(BARREL) for one in walks])
    parts = np.concatenate([elements_near(one, PERSON) for one in walks])
    return [
        ("person is one element", "1", mean(parts == 1)),
        ("person is several elements", "1", mean(parts > 1)),
        ("person: centre, RMS", "m", _rms(person)),
        ("barrel: centre, RMS", "m", _rms(barrel[:, :2])),
        ("barrel: radius, RMS", "m", _rms(barrel[:, 2:])),
        ("present while visible", "1", share(reported, due)),
        ("changes of identity", "count", sum(one.switches() for one in walks)),
        ("ghosts", "count", sum(lasting(one.ghosts()) for one in walks)),
    ]


def elements_near(one: MapRun, target: int) -> np.ndarray[Any, np.dtype[np.int64]]:
    """Elements within `GATE` of an object in every scan in which it is visible."""
    way = one.part["element_center"] - one.part["center"][one.part["element_scan"], target]
    near = one.part["element_scan"][np.hypot(*way.T) <= GATE]
    counts = np.bincount(near, minlength=len(one.seconds))
    return counts[one.is_visible[:, target] & (one.seconds >= 0.5)]


def _rms(errors: np.ndarray[Any, np.dtype[np.float64]]) -> float | None:
    """Root mean square of the lengths of the finite rows; None without such rows."""
    known = errors[np.isfinite(errors).all(axis=1)]
    return float(np.sqrt((known**2).sum(axis=1).mean())) if len(known) else None


def _draw(figure: Any, one: MapRun) -> None:
    """Draw the paths of person and barrel, and of the elements, seen from above."""
    axes = figure.subplots()
    axes.set_title("A person and a barrel", loc="left", fontweight="bold")
    for target, colour in ((PERSON, GREY), (BARREL, RED)):
        axes.plot(*one.part["center"][:, target].T, ".", color=colour)
    for number in np.unique(one.part["element_id"]).tolist():
        chosen = one.part["element_id"] == number
        axes.plot(*one.part["element_center"][chosen].T, color=BLUE, lw=0.8)
    axes.set(xlabel="x [m]", ylabel="y [m]", xlim=(-2.5, 2.5), ylim=(-3, 3), aspect="equal")


ITEM = Item(
    name="circles-lab",
    title="a person with swinging arms and a barrel in a volume (Figs 9, 10)",
    scans=12_000,
    minutes=2,
    measure=_measure,
    rows=both,
    draw=_draw,
)
