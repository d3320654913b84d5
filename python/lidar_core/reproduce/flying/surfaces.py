"""`flying-surfaces`: fog, dark, wet and glass streets; true sky, and surfaces that look like it."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_core import sim
from lidar_core.flying import FlyingConfig, FlyingObjectDetector
from lidar_core.reproduce.common import BLUE, GREY, RED, scene_rng, share, simulator_seed
from lidar_core.reproduce.flying.real_data.reported import Reported, false_tracks
from lidar_core.reproduce.flying.real_data.scores import FEWEST, START_S, scores
from lidar_core.reproduce.jobs import Job, Part, grouped, run
from lidar_core.reproduce.types import Item, Measured, Request, Row
from lidar_core.sim import Scene, SimulatedScan, Simulator

CONDITIONS = ("fog", "dark", "wet", "glass")
SENSORS = ("hdl-32e", "livox-mid360", "vlp-16", "livox-avia", "xt32")
SHAPES = ("quadcopter",)
SPEEDS = (0.0, 8.0)
"""Of the car that carries the sensor [m/s]."""
SCANS_PER_FLIGHT = 100
EMPTY_PER_FLIGHT = 4
"""Flights without a target for every one with a quadcopter."""
VISIBILITIES = (40.0, 60.0, 100.0)
"""Of the fog, in turn [m]."""
SCENE_SEEDS = 1000
"""Seeds of the scenes stay below this one."""
PROBE_S, PROBES = 2.0, 4
"""The sky is asked for from here on [s], in so many scans of a flight."""
FREE, RANGES = 0, (4.0, 8.0, 12.0)
"""The way into the sky is looked at here [m]."""
BEFORE_SKY = 0.9
"""A target is before the sky if this share of the rays around it meets nothing behind it."""


def _measure(request: Request) -> Measured:
    todo = jobs(request)
    of = grouped(todo, run(todo, request), "condition", CONDITIONS)
    return Measured(
        (of,),
        scans=sum(job.scans for job in todo),
        note="Default configuration, scans as the sensor's driver gives them, a car whose roof is"
        " in view stands or drives at 8 m/s. sky known: share of the rays that would meet nothing"
        f" in clear air whose way is free up to that distance, from"
        f" {PROBE_S:g} s on. surfaces cleared: share of the places whose return is lost that are"
        f" free in the map. Recall from {START_S} s on, where the quadcopter has {FEWEST} returns"
        " and nothing but sky behind it.",
        config={"best": FlyingConfig()},
    )


def jobs(request: Request) -> list[Job]:
    """Return flights in every condition and for each sensor, with and without target."""
    each = max(12, min(SCANS_PER_FLIGHT, request.scans // (4 * len(CONDITIONS))))
    count = max(2, round(request.scans / (each * len(CONDITIONS))))
    found = []
    for condition in CONDITIONS:
        for number in range(count):
            arguments = {
                "seed": request.seed,
                "number": number,
                "scans": each,
                "condition": condition,
            }
            name = f"flying-surfaces-{condition}-{request.seed}-{number}-{each}"
            found.append(Job(name, flight, arguments, each))
    return found


def is_with_target(number: int) -> bool:
    """Return whether a quadcopter flies in flight `number`."""
    return number % (EMPTY_PER_FLIGHT + 1) == 1


def flight(*, seed: int, number: int, scans: int, condition: str) -> Part:
    """Simulate one flight, run the detector over it, and ask it for the sky.

    Returns
    -------
    part : dict
        The columns of `Reported`; `place` (S, T, 3), `hits` (S, T) of the target, 0 where the sky
        is not behind it; `seconds` (S,), and `sky` and `lost`: rays, and how many are free.
    """
    world, sensor = scene(seed, number, scans, condition), turn_of(number)[0]
    name = simulator_seed(seed, number)
    simulator, truth = Simulator(world, seed=name), Truth(world, name)
    detector, kept = FlyingObjectDetector(FlyingConfig()), Reported()
    first = min(round(PROBE_S * world.lidar.scan_rate), scans - 1)
    probes = set(np.linspace(first, scans - 1, PROBES).astype(int).tolist())
    places, hits, seconds, known = [], [], [], []
    for step in range(scans):
        made = simulator.scan(step)
        kept.add(step, made.posed, detector.process(made, sensor=sensor))
        places.append(made.truth.position)
        is_before_sky = truth.is_before_sky(step, made)
        hits.append(np.where(is_before_sky, made.truth.hits, 0))
        seconds.append(made.scan.stamp_ns * 1e-9)
        if step in probes:
            known.append(truth.count_rays(step, detector))
    return kept.columns() | {
        "place": np.reshape(places, (scans, -1, 3)),
        "hits": np.reshape(hits, (scans, -1)).astype(np.int64),
        "seconds": np.array(seconds) - seconds[0],
        "number": np.array(number),
        "known": np.array(known, np.int64),
    }


def turn_of(number: int) -> tuple[str, float]:
    """Return sensor and speed of flight `number`: flights go through all pairs in order."""
    group, place = divmod(number, EMPTY_PER_FLIGHT + 1)
    turn = group if is_with_target(number) else EMPTY_PER_FLIGHT * group + place - (place > 1)
    speed, sensor = divmod(turn, len(SENSORS))
    return SENSORS[sensor], SPEEDS[speed % len(SPEEDS)]


def scene(seed: int, number: int, scans: int, condition: str) -> Scene:
    """Make a street in the given condition with a car, and a quadcopter or none."""
    rng = scene_rng(seed, number, CONDITIONS.index(condition))
    sensor, speed = turn_of(number)
    named: dict[str, Any] = {
        "seed": int(rng.integers(SCENE_SEEDS)),
        "scans": scans,
        "sensor": sensor,
        "speed": speed,
        "drone": is_with_target(number),
    }
    if condition == "fog":
        return sim.scenes.fog_street(**named, visibility=float(rng.choice(VISIBILITIES)))
    fronts, road = {
        "dark": ((sim.surfaces.DARK, sim.surfaces.GLOSSY), sim.surfaces.ASPHALT),
        "wet": ((sim.surfaces.CONCRETE,), sim.surfaces.WET),
        "glass": ((sim.surfaces.GLASS,), sim.surfaces.ASPHALT),
    }[condition]
    return sim.scenes.dark_street(**named, fronts=fronts, road=road)


class Truth:
    """True hits of the rays of a scene: in clear air, as if every surface returned all rays.

    Parameters
    ----------
    world : Scene
        The scene as it is.
    seed : int
        Seed of its simulator.
    """

    def __init__(self, world: Scene, seed: int) -> None:
        bare = world.model_copy(update={"targets": ()})
        ideal = bare.lidar.model_copy(update={"ideal": True})
        self._clear = Simulator(bare.idealised(), seed=seed)
        self._rays = Simulator(bare.model_copy(update={"lidar": ideal}), seed=seed)

    def is_before_sky(self, step: int, made: SimulatedScan) -> NDArray[np.bool_]:
        """Return for each target of a scan whether the sky is behind it."""
        if not len(made.truth.position):
            return np.zeros(0, np.bool_)
        clear = self._clear.scan(step)
        directions, is_sky = _directions(clear), np.asarray(clear.scan.no_return)
        lidar_from_world = np.linalg.inv(made.world_from_lidar)
        found = []
        for place, radius in zip(made.truth.position, made.truth.radius, strict=True):
            seen = lidar_from_world[:3, :3] @ place + lidar_from_world[:3, 3]
            distance = np.linalg.norm(seen)
            cosine = np.sqrt(max(0.0, 1.0 - (radius / distance) ** 2))
            around = directions @ (seen / distance) >= cosine
            found.append(around.any() and is_sky[around].mean() >= BEFORE_SKY)
        return np.array(found, np.bool_)

    def count_rays(self, step: int, detector: FlyingObjectDetector) -> list[int]:
        """Count the rays of the true sky and the lost returns that the detector takes as free.

        Returns
        -------
        counts : list of int
            Rays of the true sky; of these, those free up to each of `RANGES`; lost returns; of
            these, those whose place is free.
        """
        clear, rays = self._clear.scan(step), self._rays.scan(step)
        points, directions = clear.scan.points.reshape(-1, 3), _directions(clear)
        times, stamps = np.asarray(clear.scan.point_time_ns), clear.pose_stamps_ns
        nearest = np.abs(times[:, None] - stamps).argmin(axis=1)
        turn, place = clear.poses[nearest, :3, :3], clear.poses[nearest, :3, 3]
        sky = np.asarray(clear.scan.no_return)
        ahead = np.einsum("nij,nj->ni", turn[sky], directions[sky])
        is_free = [detector.state_at(place[sky] + one * ahead) == FREE for one in RANGES]
        free = np.logical_and.accumulate(is_free).sum(axis=1)
        lost = (clear.label >= 0) & np.asarray(rays.scan.no_return)
        surfaces = np.einsum("nij,nj->ni", turn[lost], points[lost]) + place[lost]
        cleared = (detector.state_at(surfaces) == FREE).sum()
        return [len(ahead), *free.tolist(), len(surfaces), int(cleared)]


def _directions(made: SimulatedScan) -> NDArray[np.float64]:
    """Unit directions of all rays of a scan that knows them."""
    points = made.scan.points.reshape(-1, 3).astype(np.float64)
    met = np.isfinite(points).all(axis=1, keepdims=True)
    found = np.where(met, points, np.asarray(made.scan.directions).reshape(-1, 3))
    return np.asarray(found / np.linalg.norm(found, axis=1, keepdims=True), np.float64)


def _rows(of: dict[str, list[Part]]) -> list[Row]:
    groups = {**of, "all": [part for parts in of.values() for part in parts]}
    rows = []
    for name, parts in groups.items():
        empty = [part for part in parts if not is_with_target(int(part["number"]))]
        scored = scores([part for part in parts if is_with_target(int(part["number"]))], SHAPES)
        counts = np.concatenate([part["known"] for part in parts]).sum(axis=0)
        sky, *free, lost, cleared = counts.tolist()
        known = zip(RANGES, free, strict=True)
        wanted = ("target scans", "recall", "error", "false_tracks, with targets")
        values: list[tuple[str, str, float | None]] = [
            ("scans without targets", "1", float(sum(len(part["sensor"]) for part in empty))),
            ("false_tracks", "1", float(sum(len(false_tracks(part)) for part in empty))),
            *((f"sky known@{one:g}m", "1", share(rays, sky)) for one, rays in known),
            ("surfaces cleared", "1", share(cleared, lost)),
            *(one for one in scored if one[0] in wanted),
        ]
        rows += [Row(f"{name}/{what}", unit, None, None, value) for what, unit, value in values]
    return rows


def _draw(figure: Any, of: dict[str, list[Part]]) -> None:
    """Draw recall, share of the sky, and false tracks per condition."""
    rows = {row.name: row.best_mode for row in _rows(of)}
    shares, false = figure.subplots(2, 1, sharex=True)
    for offset, what, colour in ((-0.2, "recall", BLUE), (0.2, "sky known@8m", GREY)):
        values = [rows[f"{name}/{what}"] or 0.0 for name in of]
        shares.bar(np.arange(len(of)) + offset, values, 0.38, color=colour, label=what)
    shares.set(ylabel="share", ylim=(0, 1))
    shares.legend()
    counts = [rows[f"{name}/false_tracks"] or 0.0 for name in of]
    bars = false.bar(np.arange(len(of)), counts, 0.5, color=RED)
    false.bar_label(bars)
    false.set(ylabel="false tracks without targets")
    false.set_xticks(range(len(of)), list(of))


ITEM = Item(
    name="flying-surfaces",
    title="fog, dark, wet and glass streets: false tracks, recall, share of the sky",
    scans=12_800,
    minutes=25,
    measure=_measure,
    rows=_rows,
    draw=_draw,
    grid="",
)
