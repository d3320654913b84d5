"""`circles-fig8`: posts at rest and in motion that hide one another (Fig. 8), and further cases."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_core.reproduce.circles.runs import (
    CONFIRM_TIME,
    MODES,
    MapRun,
    Measure,
    Mode,
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
from lidar_core.sim import Scene, circle_scenes
from lidar_core.sim.circle_scenes import SensorMotion

WORLDS = ("open, hovering", "open, swinging", "room, hovering", "room, swinging")
SCANS = {"world": 6000, "occlusion": 240, "neighbours": 60, "hidden": 100}
CASES = {"occlusion": 100, "neighbours": 100, "hidden": 40}
"""Scenes of each kind in a full run."""
BEFORE, AFTER = 4.0, 8.5
"""Times around an occlusion at which the identity is asked for [s]."""
APART_GATE = 0.25
"""Neighbours are kept apart if each has an element so near [m]."""


def several(*, seed: int, world: str, scans: int, network: str) -> Part:
    """Simulate and map eleven posts, in the open or in a room.

    `network` is that of `config_of`, here and in `case`.
    """
    place, motion = world.split(", ")
    sensor: SensorMotion = "hovering" if motion == "hovering" else "swinging"
    scene = circle_scenes.several(seed, walls=place == "room", sensor=sensor, scans=scans)
    return mapped(scene, config_of(scene, network), seed=seed, scans=scans)


def case(*, seed: int, kind: str, number: int, scans: int, network: str) -> Part:
    """Simulate and map one occlusion, pair of neighbours, or set of hidden posts."""
    scene = _case_scene(kind, seed, "swinging" if number % 2 else "hovering")
    return mapped(scene, config_of(scene, network), seed=seed, scans=scans)


def _case_scene(kind: str, seed: int, sensor: SensorMotion) -> Scene:
    makers: dict[str, Callable[..., Scene]] = {
        "occlusion": circle_scenes.occlusion,
        "neighbours": circle_scenes.neighbours,
        "hidden": circle_scenes.hidden,
    }
    return makers[kind](seed, sensor=sensor)


def _measure(request: Request) -> Measured:
    share = min(1.0, request.scans / ITEM.scans)
    jobs = {
        mode: [*_world_jobs(request, share, mode), *_case_jobs(request, share, mode)]
        for mode in MODES
    }
    parts = iter(run([job for some in jobs.values() for job in some], request))
    made = {mode: {job.name: MapRun.of(next(parts)) for job in some} for mode, some in jobs.items()}
    return Measured(
        (_measures(made["paper"]), _measures(made["best"])),
        drawn=(_worlds(made["best"]),),
        scans=sum(len(one.seconds) for one in made["best"].values()),
        note="Seven posts at rest, four on their ways. A ghost has no post within 0.5 m for more"
        " than 0.5 s, in sight of the scanner; a post is visible with 5 rays and a quarter of its"
        " rays; errors are those of visible posts; the room has four walls. Paper"
        " mode: the network paper-cnn and all stages as published. The picture: best mode.",
        config=both_modes(),
    )


def _world_jobs(request: Request, share: float, mode: Mode) -> list[Job]:
    scans = max(60, round(share * SCANS["world"]))
    return [
        Job(
            name=f"circles-fig8-{request.seed}-{mode}-{number}",
            function=several,
            arguments={
                "seed": simulator_seed(request.seed, number // 2),
                "world": world,
                "scans": scans,
                "network": network_of(mode),
            },
            scans=scans // len(MODES),
        )
        for number, world in enumerate(WORLDS)
    ]


def _case_jobs(request: Request, share: float, mode: Mode) -> list[Job]:
    return [
        Job(
            name=f"circles-fig8-{request.seed}-{mode}-{kind}-{number}",
            function=case,
            arguments={
                "seed": simulator_seed(request.seed, number),
                "kind": kind,
                "number": number,
                "scans": SCANS[kind],
                "network": network_of(mode),
            },
            scans=SCANS[kind] // len(MODES),
        )
        for kind, count in CASES.items()
        for number in range(max(1, round(share * count)))
    ]


def _worlds(made: dict[str, MapRun]) -> dict[str, MapRun]:
    return dict(zip(WORLDS, made.values(), strict=False))


def _measures(made: dict[str, MapRun]) -> list[Measure]:
    """Measures of the maps of one mode; `made` holds the runs by the names of their jobs."""
    cases = {kind: [one for name, one in made.items() if f"-{kind}-" in name] for kind in CASES}
    found = [
        measure for name, one in _worlds(made).items() for measure in world_measures(name, one)
    ]
    return [*found, *_case_measures(cases)]


def world_measures(name: str, one: MapRun) -> list[Measure]:
    """Return the measures of the map of a scene with several posts."""
    ghosts = one.ghosts()
    reported, due = one.presence()
    errors = np.concatenate(
        [one.errors(target)[seen] for target, seen in enumerate(one.is_visible.T)]
    )
    errors = errors[np.isfinite(errors).all(axis=1)]
    rms = np.sqrt((errors**2).mean(axis=0)).tolist() if len(errors) else [None] * 3
    values: list[Measure] = [
        ("ghosts", "count", lasting(ghosts)),
        ("longest ghost", "s", float(ghosts.max(initial=0))),
        ("ghosts, also while hidden", "count", lasting(one.ghosts(hidden=True))),
        ("reported within 0.5 s", "1", mean(one.delays() <= CONFIRM_TIME)),
        ("present while visible", "1", share(reported, due)),
        ("changes of identity", "count", one.switches()),
        ("x, RMS", "m", rms[0]),
        ("y, RMS", "m", rms[1]),
        ("radius, RMS", "m", rms[2]),
    ]
    return [(f"{name}: {what}", unit, value) for what, unit, value in values]


def _case_measures(cases: dict[str, list[MapRun]]) -> list[Measure]:
    kept = np.array([is_kept(one) for one in cases["occlusion"]])
    apart = np.concatenate([are_apart(one) for one in cases["neighbours"]])
    errors = np.concatenate([hidden_errors(one) for one in cases["hidden"]])
    known = np.isfinite(errors[:, 0])
    center = np.sqrt((errors[known, :2] ** 2).sum(axis=1).mean()) if known.any() else None
    radius = np.sqrt((errors[known, 2] ** 2).mean()) if known.any() else None
    return [
        ("identity kept through 2 s behind another post", "1", mean(kept)),
        ("neighbours 0.3 m apart at 5 m kept apart", "1", mean(apart)),
        ("25-75 % hidden: centre, RMS", "m", center),
        ("25-75 % hidden: radius, RMS", "m", radius),
        ("25-75 % hidden: present", "1", mean(known)),
    ]


def is_kept(one: MapRun) -> bool:
    """True if the first post has the same element before and after it was hidden."""
    numbers = one.ids(0)
    before, after = (numbers[one.seconds.searchsorted(time)] for time in (BEFORE, AFTER))
    return bool(before >= 0 and before == after)


def are_apart(one: MapRun) -> NDArray[np.bool_]:
    """True if each post has its own element near by, in every scan after the first."""
    late = one.seconds >= CONFIRM_TIME
    near = [np.hypot(*one.errors(target)[:, :2].T) <= APART_GATE for target in (0, 1)]
    return np.asarray((near[0] & near[1])[late], np.bool_)


def hidden_errors(one: MapRun) -> NDArray[np.float64]:
    """Errors of posts while 1/4 to 3/4 of a post is hidden, (N, 3)."""
    rays = np.maximum(one.part["rays"], 1)
    hidden = 1 - one.part["hits"] / rays
    is_due = (hidden >= 0.25) & (hidden <= 0.75) & (one.seconds >= CONFIRM_TIME)[:, None]
    return np.concatenate(
        [one.errors(target)[is_due[:, target]] for target in range(0, is_due.shape[1], 2)]
    )


def _draw(figure: Any, worlds: dict[str, MapRun]) -> None:
    """Draw the paths of posts and of elements, seen from above."""
    panels = figure.subplots(1, 2, sharex=True, sharey=True)
    for axes, name in zip(panels, ("open, swinging", "room, swinging"), strict=True):
        part = worlds[name].part
        for target in range(part["center"].shape[1]):
            axes.plot(*part["center"][:, target].T, color=GREY, lw=3, alpha=0.5)
        _draw_elements(axes, part)
        axes.set(title=name, xlabel="x [m]", xlim=(-7, 10), ylim=(-7.5, 7.5), aspect="equal")
    panels[0].set_ylabel("y [m]")


def _draw_elements(axes: Any, part: Part) -> None:
    for number in np.unique(part["element_id"]).tolist():
        chosen = part["element_id"] == number
        axes.plot(*part["element_center"][chosen].T, color=BLUE, lw=0.8)
    last = part["element_scan"] == len(part["stamp_ns"]) - 1
    turn = np.linspace(0, 2 * np.pi, 48)
    for (x, y), radius in zip(
        part["element_center"][last].tolist(), part["element_radius"][last].tolist(), strict=True
    ):
        axes.plot(x + radius * np.cos(turn), y + radius * np.sin(turn), color=RED)


ITEM = Item(
    name="circles-fig8",
    title="several posts, occlusions, ghosts on walls, neighbours, hidden ones (Fig. 8)",
    scans=4 * SCANS["world"] + sum(SCANS[kind] * count for kind, count in CASES.items()),
    minutes=18,
    measure=_measure,
    rows=both,
    draw=_draw,
    heading="Posts at rest and on their ways",
)
