"""`fusion-fig4`: a track in the plane, elevation and pose of the drone give three dimensions."""

from collections.abc import Mapping
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from lidar_core.fusion import (
    FusionConfig,
    LevelSight,
    Measurement,
    SpaceTrack,
    in_space,
    level_overflight,
    run,
)
from lidar_core.reproduce.common import BLUE, COLOURS, MODES
from lidar_core.reproduce.fusion.tilted import config_in_space, follow_in_space
from lidar_core.reproduce.types import Item, Measured, Request, Row
from lidar_core.sim import Overflight, Overflown, overfly
from lidar_core.sim.overflight import RATE

SETTLED = 40
"""Rows at the start that do not count."""
DRIFT = 0.05
"""How fast the ground may rise or fall: root of a density [m/s^0.5]."""
NAMES = (("x", "m"), ("y", "m"), ("z", "m"))
ROUND = (("distance", "m"), ("direction", "rad"), ("height", "m"))


InSpace: TypeAlias = list[tuple[NDArray[np.float64], NDArray[np.float64]]]
"""Errors and covariances of a filter in space, flight by flight."""
Flown: TypeAlias = tuple[list[Overflown], dict[str, list[SpaceTrack]], dict[str, InSpace]]
"""Flights of a scene, the tracks of both modes in them, and of level and tilted drones in space."""
FLIGHTS = {"level": False, "rolling and climbing": True}


def scenes() -> dict[str, Overflight]:
    """Scenes with a walking person and with a car, by name."""
    car = Overflight(height=15.0, speed=7.5, target_speed=8.0, target_turn_rate=0.2)
    return {"walking": Overflight(), "driving": car}


def _measure(request: Request) -> Measured:
    found: dict[str, Flown] = {}
    for name, scene in scenes().items():
        made = [overfly(scene, seed=request.seed * 1_000_003 + n) for n in range(request.scans)]
        seeds = [request.seed * 1_000_003 + n for n in range(request.scans)]
        in_space = {
            flight: [
                follow_in_space(one, tilted=tilted, seed=seed)
                for one, seed in zip(made, seeds, strict=True)
            ]
            for flight, tilted in FLIGHTS.items()
        }
        follows = {mode: [_follow(one, mode) for one in made] for mode in MODES}
        found[name] = made, follows, in_space
    request.advance(request.scans)
    return Measured(
        (found,),
        scans=request.scans,
        note="Simulated: the paper shows a sketch. The drone swings in yaw and pitch. Paper mode:"
        " the equations as printed in the frame of the sensors, every elevation by itself. Best"
        " mode: poses told, heights filtered. In space: defaults with model ctrv-3d; the level"
        " drone keeps its height, the other one rolls by up to 0.2 rad, climbs and sinks by up"
        " to 1 m/s, and has its sensors 0.2 m off its origin. RMSE over all draws, without"
        f" the first {SETTLED} rows.",
        config={
            "paper": FusionConfig.paper(),
            "best": FusionConfig(),
            "in_space": config_in_space(tilted=True),
            **scenes(),
        },
    )


def _follow(made: Overflown, mode: str) -> SpaceTrack:
    """Project the measurements onto the plane, filter them there, and add the height."""
    sight = level_overflight(made)
    if mode == "paper":
        found = run(_flat(made, sight), FusionConfig.paper())
        c, s = np.cos(made.yaw), np.sin(made.yaw)
        turn = np.moveaxis(np.array([[c, -s], [s, c]]), 2, 0)
        position = (turn @ found.states[:, :2, None])[..., 0] + made.drone[:, :2]
        covariance = turn @ found.covariances[:, :2, :2] @ np.swapaxes(turn, 1, 2)
        return in_space(position, covariance, sight.elevation, sight.elevation_variance, made.drone)
    seen = [one for pair in zip(_poses(made), _flat(made, sight), strict=True) for one in pair]
    found = run(seen, FusionConfig())
    drift = np.full(len(made.yaw), DRIFT**2 / RATE)
    return in_space(
        found.states[1::2, :2],
        found.covariances[1::2, :2, :2],
        sight.elevation,
        sight.elevation_variance,
        made.drone,
        drift=drift,
    )


def _flat(made: Overflown, sight: LevelSight) -> list[Measurement]:
    """Return the level measurements with their covariances."""
    seen = []
    for row, stamp_ns in enumerate(made.stamps_ns.tolist()):
        values, noise = sight.values[row], sight.covariances[row]
        if made.is_lidar[row]:
            rho, (c, s) = values[0], (np.cos(values[1]), np.sin(values[1]))
            T = np.array([[c, -rho * s], [s, rho * c]])
            place = rho * np.array([c, s])
            seen.append(Measurement(stamp_ns, "lidar", place, T @ noise[:2, :2] @ T.T))
        else:
            seen.append(Measurement(stamp_ns, "radar", values, noise))
    return seen


def _poses(made: Overflown) -> list[Measurement]:
    rows = np.column_stack([made.drone[:, :2], made.yaw, made.drone_velocity[:, :2], made.gyro])
    return [
        Measurement(stamp_ns, "pose", row)
        for stamp_ns, row in zip(made.stamps_ns.tolist(), rows, strict=True)
    ]


def _cylindrical(made: Overflown) -> NDArray[np.float64]:
    x, y, z = (made.position - made.drone).T
    return np.stack([np.hypot(x, y), np.arctan2(y, x), z], axis=1)


def _rows(found: Mapping[str, Flown]) -> list[Row]:
    return [
        row
        for scene, (made, follows, in_space) in found.items()
        for row in [*_rows_of(scene, made, follows), *_rows_in_space(scene, in_space)]
    ]


def _rows_in_space(scene: str, flights: Mapping[str, InSpace]) -> list[Row]:
    """Rows of error and consistency with a level and a tilted drone, and the ratio of errors."""
    rows, rmse = [], {}
    for flight, runs in flights.items():
        wrong = np.array([errors for errors, _ in runs])
        rmse[flight] = float(np.sqrt(np.square(wrong[:, SETTLED:]).sum(axis=2).mean()))
        consistency = _nees(wrong, [covariance for _, covariance in runs])
        rows += [
            Row(f"{scene}, in space, {flight}: 3-D RMSE", "m", None, None, rmse[flight]),
            Row(f"{scene}, in space, {flight}: NEES / 3", "1", None, None, consistency),
        ]
    level, tilted = rmse.values()
    ratio = Row(f"{scene}, in space: RMSE over that of level", "1", None, None, tilted / level)
    return [*rows, ratio]


def _rows_of(scene: str, made: list[Overflown], found: Mapping[str, list[SpaceTrack]]) -> list[Row]:
    """Rows of errors in Cartesian and cylindrical form, and of the mean NEES / 3."""
    values: dict[str, list[float]] = {}
    for mode, tracks in found.items():
        wrong = np.array(
            [track.position - one.position for track, one in zip(tracks, made, strict=True)]
        )
        about = np.array(
            [track.cylindrical - _cylindrical(one) for track, one in zip(tracks, made, strict=True)]
        )
        about[..., 1] -= 2 * np.pi * np.round(about[..., 1] / (2 * np.pi))
        both = np.concatenate([wrong, about], axis=2)[:, SETTLED:]
        rmse = np.sqrt(np.square(both).mean(axis=(0, 1))).tolist()
        values[mode] = [
            *rmse,
            float(np.hypot(np.hypot(rmse[0], rmse[1]), rmse[2])),
            _nees(wrong, [track.covariance for track in tracks]),
        ]
    names = [(f"RMSE of {name}", unit) for name, unit in (*NAMES, *ROUND)]
    names += [("3-D RMSE", "m"), ("mean NEES / 3", "1")]
    return [
        Row(f"{scene}: {name}", unit, None, paper, best)
        for (name, unit), paper, best in zip(names, values["paper"], values["best"], strict=True)
    ]


def _nees(wrong: NDArray[np.float64], covariances: list[NDArray[np.float64]]) -> float:
    """Mean NEES per dimension; singular covariances count with their pseudoinverse."""
    P = np.array(covariances)[:, SETTLED:]
    e = wrong[:, SETTLED:, :, None]
    return float((np.swapaxes(e, 2, 3) @ np.linalg.pinv(P) @ e).mean() / 3)


def _draw(figure: Any, found: Mapping[str, Flown]) -> None:
    """Draw both scenes from above and from the side."""
    panels = figure.subplots(2, len(found))
    for column, (scene, (flights, follows, _)) in zip(panels.T, found.items(), strict=True):
        made = flights[0]
        for panel, (axis, name) in zip(column, ((1, "y"), (2, "z")), strict=True):
            for mode, tracks in follows.items():
                track = tracks[0]
                panel.plot(
                    track.position[:, 0],
                    track.position[:, axis],
                    color=COLOURS[mode],
                    lw=0.9,
                    label=f"{mode} mode",
                )
            panel.plot(
                made.position[:, 0], made.position[:, axis], color="black", lw=1.2, label="truth"
            )
            panel.plot(made.drone[:, 0], made.drone[:, axis], color=BLUE, ls=":", label="drone")
            panel.set(xlabel="x [m]", ylabel=f"{name} [m]", title=scene)
    panels[0, 0].legend(fontsize=8)


ITEM = Item(
    name="fusion-fig4",
    title="LiDAR and radar on a drone: the target in three dimensions (Fig. 4)",
    scans=20,
    minutes=0.3,
    measure=_measure,
    rows=_rows,
    draw=_draw,
    heading="From the plane into space",
    counts="draws",
)
