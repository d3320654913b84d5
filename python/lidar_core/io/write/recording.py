"""Selection of the writer of a path by its ending."""

from collections.abc import Iterable
from pathlib import Path

from lidar_core.errors import InputError
from lidar_core.io.writers import writer_of
from lidar_core.messages import Message


def write_recording(path: str | Path, items: Iterable[Message]) -> None:
    """Write scans and poses to a recording; the ending of `path` chooses the format.

    Parameters
    ----------
    path : str or Path
        NAME.npz (exact), NAME.mcap (Foxglove's messages; no covariances of poses), NAME.bag
        (ROS 1), or a name without ending: the new folder of a ROS 2 recording.
    items : iterable of Scan, LaserScan and Pose
        Messages in the order of their times.

    Raises
    ------
    ConfigError
        Another ending.
    InputError
        Something else than a message, a value of another shape or type, or one that the format
        cannot store.
    MissingExtraError
        The format needs a package that is not installed.
    """
    given: object = items
    if isinstance(given, Message):
        kind = type(given).__name__
        raise InputError(f"items: expected a list of messages, got one {kind}; put it in a list")
    place = Path(path)
    writer_of(place, "messages")(place, items)
