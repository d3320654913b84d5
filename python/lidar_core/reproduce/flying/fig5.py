"""`flying-fig5`: probability that the right voxel was updated, over distance and noise."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_core.flying import VoxelMapConfig, hit_probability, point_covariance
from lidar_core.reproduce.types import Item, Measured, Request, Row

LEVELS = (
    (0.01, 0.1, 0.01),
    (0.05, 0.5, 0.03),
    (0.1, 0.5, 0.05),
    (0.1, 1.0, 0.05),
    (0.2, 2.0, 0.05),
)
"""Standard deviations: position [m] and angles [deg] per axis, range [m]."""
DISTANCES = (1.0, 2.0, 5.0, 10.0, 15.0, 20.0, 30.0)
"""[m]"""


def _measure(request: Request) -> Measured:
    curves = {}
    for level in LEVELS:
        curves[level] = [
            _shares(level, distance, request.scans, request.seed) for distance in DISTANCES
        ]
        request.advance(request.scans // len(LEVELS))
    config = VoxelMapConfig()
    return Measured(
        (curves,),
        scans=request.scans,
        note=f"Mean over points in random directions, anywhere in their voxels of"
        f" {config.voxel_size} m. Linearised: eqs 41-46; drawn: share of drawn errors that leave"
        " the true point in the voxel of the measured one, which knows nothing of linearisation."
        " The paper shows curves without numbers; both modes are one.",
        config={"voxel_map": config},
    )


def _shares(
    level: tuple[float, float, float], distance: float, count: int, seed: int
) -> tuple[float, float]:
    """Mean predicted probability that the right voxel is updated, and the simulated share."""
    rng = np.random.default_rng([seed, int(distance * 10)])
    size = VoxelMapConfig().voxel_size
    position, angle, along = level[0], np.radians(level[1]), level[2]
    directions = rng.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    points = distance * directions
    shift = rng.uniform(0, size, 3)
    covariance = point_covariance(
        points,
        np.eye(4),
        pose_covariance=np.diag([position**2] * 3 + [angle**2] * 3),
        range_std=along,
    )
    expected = hit_probability(points, covariance, voxel_size=size, origin=tuple(shift.tolist()))
    ranges = distance + along * rng.normal(size=(count, 1))
    turned = _rotate(ranges * directions, angle * rng.normal(size=(count, 3)))
    drawn = turned + position * rng.normal(size=(count, 3))
    hits = (np.floor((drawn - shift) / size) == np.floor((points - shift) / size)).all(axis=1)
    return float(expected.mean()), float(hits.mean())


def _rotate(points: NDArray[np.float64], angles: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rotate every point about x, y and z by its own angles [rad]."""
    turned = points
    for axis, (first, second) in enumerate(((1, 2), (2, 0), (0, 1))):
        sine, cosine = np.sin(angles[:, axis]), np.cos(angles[:, axis])
        a, b = turned[:, first].copy(), turned[:, second].copy()
        turned = turned.copy()
        turned[:, first], turned[:, second] = cosine * a - sine * b, sine * a + cosine * b
    return turned


def _label(level: tuple[float, float, float]) -> str:
    return f"{level[0]:g} m, {level[1]:g} deg, {level[2]:g} m"


def _rows(curves: dict[tuple[float, float, float], list[tuple[float, float]]]) -> list[Row]:
    rows = []
    for level, curve in curves.items():
        for place, what in enumerate(("linearised", "drawn")):
            for distance, shares in zip(DISTANCES, curve, strict=True):
                name = f"{_label(level)}, {what}@{distance:g}m"
                rows.append(Row(name, "1", None, shares[place], shares[place]))
    return rows


def _draw(figure: Any, curves: dict[tuple[float, float, float], list[tuple[float, float]]]) -> None:
    axes = figure.subplots()
    for level, curve in curves.items():
        (line,) = axes.plot(DISTANCES, [shares[0] for shares in curve], label=_label(level))
        axes.plot(DISTANCES, [shares[1] for shares in curve], "x", color=line.get_color())
    axes.set(xlabel="distance [m]", ylabel="hit probability", ylim=(0, 1))
    axes.legend(title="position, angles, range; x: drawn", fontsize=8)


ITEM = Item(
    name="flying-fig5",
    title="probability that the right voxel was updated, over distance and noise (Fig. 5)",
    scans=20_000,
    minutes=0.5,
    measure=_measure,
    rows=_rows,
    draw=_draw,
    heading="Was the right voxel updated?",
    counts="points per distance and noise",
)
