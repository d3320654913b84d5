"""Recordings of many targets, by the content of their files."""

from collections.abc import Callable
from pathlib import Path

from lidar_core.fusion.recordings.autoferry import DetectionScan, read_autoferry
from lidar_core.fusion.recordings.continental import ENDINGS as YAML
from lidar_core.fusion.recordings.continental import is_continental, read_continental
from lidar_core.fusion.recordings.delphi import is_delphi, read_delphi
from lidar_core.fusion.recordings.nuscenes import (
    is_boxes,
    is_radar_sweep,
    read_nuscenes_boxes,
    read_nuscenes_radar,
)

Reader = Callable[[Path], list[DetectionScan]]


def list_reader(path: Path) -> tuple[str, Reader] | None:
    """Format of a list of detections or objects and its reader; None for other recordings.

    Examples
    --------
    >>> list_reader(Path("boats_detections.json"))[0]
    'Autoferry'
    """
    suffix = path.suffix.lower()
    if suffix == ".json":
        if is_boxes(path):
            return "nuScenes boxes", read_nuscenes_boxes
        return "Autoferry", read_autoferry
    # By its ending what nothing else has: then the errors are those of its reader.
    if suffix in YAML or is_continental(path):
        return "Continental", read_continental
    if suffix == ".pcd" or is_radar_sweep(path):
        return "nuScenes radar", read_nuscenes_radar
    return ("Delphi ESR", read_delphi) if is_delphi(path) else None
