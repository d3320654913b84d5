"""Writer of results in the format of nuScenes' tracking challenge."""

import json
from pathlib import Path
from typing import Any

from lidar_core.io.files.atomic import written_whole
from lidar_core.io.write.objects import SCORE, RunObjects, Steps
from lidar_core.io.writers import register_writer
from lidar_core.objects import Objects


@register_writer("nuScenes", [".json"], takes="objects")
def write_run(path: Path, objects: RunObjects) -> None:
    """Write the objects of a run."""
    write_nuscenes(path, objects.steps, name=objects.name, sensors=objects.sensors)


def write_nuscenes(
    path: str | Path, steps: Steps, *, name: str, sensors: tuple[str, ...] = ("lidar",)
) -> None:
    """Write the results file of nuScenes' tracking challenge atomically.

    Parameters
    ----------
    path : str or Path
        JSON file. The token of a sample is its time [ns] as text.
    steps : iterable of (int, Objects)
        All processed times [ns], also those without objects.
    name : str
        Class of all objects.
    sensors : tuple of str
        Sensors that were used, of camera, lidar, radar, map, external.
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


def _nuscenes_box(token: str, objects: Objects, row: int, name: str) -> dict[str, Any]:
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
