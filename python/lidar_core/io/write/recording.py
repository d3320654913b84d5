"""Which writer a path needs, by its ending."""

from collections.abc import Callable, Iterable
from pathlib import Path

from lidar_core.errors import ConfigError
from lidar_core.messages import Message

WRITABLE = ".npz, .mcap (Foxglove's messages), .bag (ROS 1), a new folder (ROS 2)"
Write = Callable[[str | Path, Iterable[Message]], None]


def writer_of(path: Path) -> Write:
    """The function that writes recordings of the format that the ending of `path` names.

    Raises
    ------
    ConfigError
        Another ending.
    """
    suffix = path.suffix.lower()
    if suffix == ".npz":
        from lidar_core.io.formats.npz import write_npz

        return write_npz
    if suffix == ".mcap":
        from lidar_core.io.write.mcap import write_mcap

        return write_mcap
    if suffix in (".bag", ""):
        from lidar_core.io.write.ros import write_ros

        return write_ros
    raise ConfigError(f"{path}: unknown ending {suffix!r}; writable are: {WRITABLE}")


def write_recording(path: str | Path, items: Iterable[Message]) -> None:
    """Write scans and poses to a recording; the ending of `path` chooses the format.

    Parameters
    ----------
    path : str or Path
        NAME.npz (exact), NAME.mcap (Foxglove's messages; no covariances of poses), NAME.bag
        (ROS 1), or a name without ending: the new folder of a ROS 2 recording.
    items : iterable of Scan, LaserScan and Pose
        In the order of their times.

    Raises
    ------
    ConfigError
        Another ending.
    InputError
        What the format cannot hold.
    MissingExtraError
        The format needs a package that is not installed.
    """
    place = Path(path)
    writer_of(place)(place, items)
