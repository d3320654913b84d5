"""Short scripted encounters in front of a hovering sensor, and the IDs of their tracks."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_core import sim
from lidar_core.evaluation import EvaluationConfig, TrackScores, pair, score_tracks
from lidar_core.extras import require
from lidar_core.reproduce.common import BLUE, MODES, PALE, RED, share
from lidar_core.reproduce.flying.simulated.flights import both_modes, fly, tables
from lidar_core.reproduce.jobs import Job, Part, run
from lidar_core.reproduce.types import Request, Row
from lidar_core.sim import Body, Box, LidarModel, Plane, Scene, Simulator, Target

SENSOR = (0.0, 0.0, 3.0)
"""Where it hovers [m]."""
SETTLED = 15
"""Scans from which on targets have to be tracked: the burn-in, and a few to be confirmed."""


def cases(function: Callable[..., Part], name: str, request: Request, scans: int) -> list[Part]:
    """Run `request.scans` encounters made by `function(seed=, number=, scans=)`."""
    same = {"seed": request.seed, "scans": scans}
    jobs = [
        Job(f"{name}-{request.seed}-{number}-{scans}", function, {"number": number, **same}, 1)
        for number in range(request.scans)
    ]
    return run(jobs, request)


def flown(scene: Scene, seed: int) -> Part:
    """Simulate a scene and run the detectors of both modes on it."""
    return fly(Simulator(scene, seed=seed), both_modes(), scans=scene.scans)


def os1() -> LidarModel:
    """Return the sensor: ideal ranges, rolling scans."""
    return LidarModel.preset("os1-128", ideal=True, range_std=0.0)


def drone(
    rng: np.random.Generator, times: NDArray[np.float64], places: NDArray[np.float64]
) -> Target:
    """Make a sphere or a hexacopter of 0.325 m with its path."""
    shape = sim.Sphere(radius=sim.scenes.DRONE_RADIUS) if rng.random() < 0.5 else sim.Hexacopter()
    motion = sim.Waypoints(
        times=tuple(times.tolist()), positions=tuple(map(tuple, places.tolist()))
    )
    return sim.Target(shape=shape, motion=motion)


def yard() -> tuple[Body, ...]:
    """Make ground and houses on three sides, further away than any target."""
    houses = (
        (22.0, 0.0, 1.0, 44.0, 8.0),
        (0.0, -22.0, 44.0, 1.0, 8.0),
        (-22.0, 20.0, 6.0, 6.0, 9.0),
    )
    return (
        Body(shape=Plane(size=(80.0, 80.0))),
        *(
            Body(shape=Box(size=(size_x, size_y, height)), position=(x, y, height / 2))
            for x, y, size_x, size_y, height in houses
        ),
    )


def in_sight(places: NDArray[np.float64]) -> bool:
    """Return whether all places are 4 to 19 m away, in the field of view, and above the ground."""
    offset = places - np.array(SENSOR)
    distance = np.linalg.norm(offset, axis=-1)
    steepest = np.abs(offset[..., 2] / distance).max()
    is_near = distance.min() > 4.0 and distance.max() < 19.0
    is_inside = np.hypot(places[..., 0], places[..., 1]).max() < 16.0
    return bool(
        is_near and is_inside and steepest < np.sin(np.deg2rad(18.0)) and places[..., 2].min() > 1.8
    )


def scores(part: Part, mode: str) -> TrackScores:
    """Score the tracks of a mode after the burn-in."""
    config = EvaluationConfig(burn_in_scans=SETTLED)
    return score_tracks(*tables(part, mode, "tracks", config=config), config=config)


def tracking_rows(found: Sequence[Sequence[TrackScores]]) -> list[Row]:
    """Rows of the scores of all encounters in both modes."""
    recall: list[float | None] = []
    for mode in found:
        eligible = sum(one.n_eligible for one in mode)
        recall.append(share(sum(one.n_found for one in mode), eligible))
    false = (sum(len(one.false_ids) for one in mode) for mode in found)
    return [
        Row("recall of tracks", "1", None, *recall),
        Row("false tracks", "1", None, *false),
    ]


def numbers(part: Part, mode: str) -> NDArray[np.int64]:
    """Track of every target in every scan, (S, T); -1 for none."""
    config = EvaluationConfig()
    row = pair(*tables(part, mode, "tracks", config=config), config=config).estimate_of
    known = np.append(part[f"{mode}_tracks_id"], -1)  # -1, no row, is the last one
    return known[row].reshape(part["hits"].shape)


def draw_numbers(figure: Any, parts: Sequence[Part]) -> None:
    """Draw every target as a line in time: its first track, other tracks, none, hidden."""
    colours = ["#ffffff", BLUE, RED, PALE]
    colormap = require("matplotlib.colors", extra="plot", purpose="the picture")
    panels = figure.subplots(1, 2, sharey=True)
    for axes, mode in zip(panels, MODES, strict=True):
        picture = np.concatenate([_states(part, mode).T for part in parts])
        seconds = parts[0]["stamp_ns"] * 1e-9
        axes.pcolormesh(
            seconds,
            np.arange(len(picture)),
            picture,
            cmap=colormap.ListedColormap(colours),
            vmin=0,
            vmax=3,
            shading="nearest",
        )
        axes.set(title=f"{mode} mode", xlabel="time [s]")
    panels[0].set_ylabel("target")
    names = ("first track", "another track", "hidden, no track")
    patches = require("matplotlib.patches", extra="plot", purpose="the picture")
    handles = [patches.Patch(color=colour) for colour in colours[1:]]
    figure.legend(handles, names, loc="upper right", ncols=3)


def _states(part: Part, mode: str) -> NDArray[np.int64]:
    """State of every target and scan.

    0: no track, 1: the target's first track, 2: another track, 3: hidden and without a track.
    """
    table = numbers(part, mode)
    first = np.array([next(iter(line[line >= 0]), -1) for line in table.T])
    states = np.where(table < 0, 0, np.where(table == first, 1, 2))
    return np.where((table < 0) & (part["hits"] == 0), 3, states)
