"""Conversion of the objects of a run for other programs, by `lidar-core convert`."""

from pathlib import Path
from typing import Any

from lidar_core.io import RunObjects
from lidar_core.io.writers import writer_of
from lidar_core.run_folder import RUN_FILE
from lidar_core.viz.playback import Playback

NAMES = {"flying": "flying", "circles": "circle", "fusion": "target"}
"""Class of the objects, by what found them."""
SENSORS = {"flying": ("lidar",), "circles": ("lidar",), "fusion": ("lidar", "radar")}


def is_run(place: Path) -> bool:
    """Return whether this folder is one that a command wrote."""
    return (place / RUN_FILE).is_file()


def convert_run(run: Path, output: Path, *, name: str | None) -> dict[str, Any]:
    """Write the objects of a run; return paths, counts and topics as plain values.

    Raises
    ------
    ConfigError
        No writer for the ending of `output`.
    """
    played = Playback(run)
    called = NAMES[played.capability] if name is None else name
    steps = list(played.steps())
    objects = RunObjects(
        steps, called, SENSORS[played.capability], played.frame_id, played.segments()
    )
    topics = writer_of(output, "objects")(output, objects) or []
    numbers = [number for _, found in steps for number in found.id.tolist()]
    return {
        "input": str(run),
        "output": str(output),
        "times": len(steps),
        "states": len(numbers),
        "objects": len(set(numbers)),
        "topics": topics,
    }
