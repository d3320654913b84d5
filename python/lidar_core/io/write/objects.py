"""Objects with numbers over time, as other programs want them: nuScenes, MOTChallenge."""

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from lidar_core.io.files.atomic import written_whole

SCORE = 1.0
"""Of every track: a tracker that reports one is sure of it."""


class ObjectsLike(Protocol):
    """Objects at one time, one row each, as `lidar_core.viz.Objects` holds them."""

    @property
    def id(self) -> NDArray[np.int64]:
        """Numbers, shape (K,)."""

    @property
    def position(self) -> NDArray[np.float64]:
        """Positions [m], shape (K, 3)."""

    @property
    def velocity(self) -> NDArray[np.float64]:
        """Velocities [m/s], shape (K, 3)."""

    @property
    def covariance(self) -> NDArray[np.float64]:
        """Covariances of the positions [m^2], shape (K, 3, 3)."""

    @property
    def size(self) -> NDArray[np.float64]:
        """Sides of the bounding boxes [m], shape (K, 3); circles have no height; zero: unknown."""


Steps: TypeAlias = Iterable[tuple[int, ObjectsLike]]
"""Times [ns] and the objects at each, in the order of time."""


def write_nuscenes(
    path: str | Path, steps: Steps, *, name: str, sensors: tuple[str, ...] = ("lidar",)
) -> None:
    """Write the results file of nuScenes' tracking challenge, whole or not at all.

    Parameters
    ----------
    path : str or Path
        JSON file. The token of a sample is its time [ns] as text.
    steps : iterable of (int, Objects)
        Every time that was looked at, also those without objects.
    name : str
        Class of all objects.
    sensors : tuple of str
        Of camera, lidar, radar, map, external: what was used.
    """
    used = {f"use_{one}": one in sensors for one in ("camera", "lidar", "radar", "map", "external")}
    results = {
        str(stamp): [
            _nuscenes_box(str(stamp), objects, row, name) for row in range(len(objects.id))
        ]
        for stamp, objects in steps
    }
    with written_whole(path) as temporary:
        temporary.write_text(json.dumps({"meta": used, "results": results}), encoding="utf-8")


def write_mot(path: str | Path, steps: Steps) -> None:
    """Write a results file of MOTChallenge's 3D tracking, whole or not at all.

    Parameters
    ----------
    path : str or Path
        Text file, ten values a line: frame, number, four sides of a box that is unknown (-1),
        score, x, y, z [m]. Frames are counted from 1.
    steps : iterable of (int, Objects)
        Every time that was looked at, also those without objects: each is a frame.
    """
    lines = []
    for frame, (_, objects) in enumerate(steps, start=1):
        for number, place in zip(objects.id.tolist(), objects.position.tolist(), strict=True):
            x, y, z = (f"{value:.6f}" for value in place)
            lines.append(f"{frame},{number},-1,-1,-1,-1,{SCORE:g},{x},{y},{z}\n")
    with written_whole(path) as temporary:
        temporary.write_text("".join(lines), encoding="utf-8")


def _nuscenes_box(token: str, objects: ObjectsLike, row: int, name: str) -> dict[str, Any]:
    length, width, height = objects.size[row].tolist()
    return {
        "sample_token": token,
        "translation": objects.position[row].tolist(),
        "size": [width, length, height],
        "rotation": [1.0, 0.0, 0.0, 0.0],
        "velocity": objects.velocity[row, :2].tolist(),
        "tracking_id": str(int(objects.id[row])),
        "tracking_name": name,
        "tracking_score": SCORE,
    }
