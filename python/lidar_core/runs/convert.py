"""What `lidar-core convert` makes of a run: its objects for other programs."""

from pathlib import Path
from typing import Any

from lidar_core.errors import ConfigError
from lidar_core.io import write_mot, write_nuscenes, write_ros_objects
from lidar_core.run_folder import RUN_FILE
from lidar_core.viz.playback import Playback

WRITABLE = ".json (nuScenes), .txt (MOTChallenge), .bag (ROS 1), a new folder (ROS 2)"
NAMES = {"flying": "flying", "circles": "circle", "fusion": "target"}
"""Class of the objects, by what found them."""
SENSORS = {"flying": ("lidar",), "circles": ("lidar",), "fusion": ("lidar", "radar")}


def is_run(place: Path) -> bool:
    """Whether a command left this folder."""
    return (place / RUN_FILE).is_file()


def convert_run(run: Path, output: Path, *, name: str | None) -> dict[str, Any]:
    """Write the objects of a run; return what was written, as plain values.

    Raises
    ------
    ConfigError
        Another ending.
    """
    played = Playback(run)
    called = NAMES[played.capability] if name is None else name
    steps = list(played.steps())
    suffix, topics = output.suffix.lower(), list[str]()
    if suffix == ".json":
        write_nuscenes(output, steps, name=called, sensors=SENSORS[played.capability])
    elif suffix == ".txt":
        write_mot(output, steps)
    elif suffix in (".bag", ""):
        topics = write_ros_objects(
            output, steps, frame_id=played.frame_id, name=called, segments=played.segments()
        )
    else:
        raise ConfigError(f"{output}: unknown ending {suffix!r}; a run becomes: {WRITABLE}")
    numbers = [number for _, found in steps for number in found.id.tolist()]
    return {
        "input": str(run),
        "output": str(output),
        "times": len(steps),
        "states": len(numbers),
        "objects": len(set(numbers)),
        "topics": topics,
    }
