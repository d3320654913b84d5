"""Writer of results in the format of MOTChallenge's 3D tracking."""

from pathlib import Path

from lidar_core.io.files.atomic import written_whole
from lidar_core.io.write.objects import SCORE, RunObjects, Steps
from lidar_core.io.writers import register_writer


@register_writer("MOTChallenge", [".txt"], takes="objects")
def write_run(path: Path, objects: RunObjects) -> None:
    """Write the objects of a run."""
    write_mot(path, objects.steps)


def write_mot(path: str | Path, steps: Steps) -> None:
    """Write a results file of MOTChallenge's 3D tracking atomically.

    Parameters
    ----------
    path : str or Path
        Text file, ten values a line: frame, number, four sides of a box that is unknown (-1),
        score, x, y, z [m]. Frames are counted from 1.
    steps : iterable of (int, Objects)
        All processed times, also those without objects: each is a frame.
    """
    lines = []
    for frame, (_, objects) in enumerate(steps, start=1):
        for number, place in zip(objects.id.tolist(), objects.position.tolist(), strict=True):
            x, y, z = (f"{value:.6f}" for value in place)
            lines.append(f"{frame},{number},-1,-1,-1,-1,{SCORE:g},{x},{y},{z}\n")
    with written_whole(path) as temporary:
        temporary.write_text("".join(lines), encoding="utf-8")
