"""Selection of the writer of a path by its ending."""

from collections.abc import Callable, Collection, Iterable
from pathlib import Path

from lidar_core.errors import InputError
from lidar_core.io.write.mcap import McapWriter, write_mcap
from lidar_core.io.write.ros import RosWriter, write_ros
from lidar_core.io.writers import Write, writer_of
from lidar_core.messages import Message

WORLD = "world"
KEEPS_ARRIVALS: dict[Write, Callable[[Path, Collection[str]], McapWriter | RosWriter]] = {
    write_mcap: lambda path, odometry: McapWriter(path, tracks_frame=WORLD, odometry=odometry),
    write_ros: lambda path, odometry: RosWriter(path, odometry=odometry),
}
"""Formats that have a time beside the message, for its arrival."""


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


def write_arrivals(
    path: str | Path,
    items: Iterable[tuple[Message, int | None]],
    *,
    odometry: Collection[str] = (),
) -> None:
    """Write scans and poses with the times at which they arrived, where the format keeps them.

    Parameters
    ----------
    path : str or Path
        Recording to write, as for `write_recording`.
    items : iterable of (Scan, LaserScan or Pose, int or None)
        Messages in the order of their arrivals, each with its time [ns]; None: its stamp.
    odometry : collection of str
        Topics whose poses are no transforms; poses without child frame never are.

    Raises
    ------
    ConfigError, InputError, MissingExtraError
        As `write_recording`.
    """
    place = Path(path)
    writer = writer_of(place, "messages")
    if (opened := KEEPS_ARRIVALS.get(writer.write)) is None:
        writer(place, (message for message, _ in items))
        return
    with opened(place, odometry) as file:
        for message, arrival_ns in items:
            file.write(message, log_time_ns=arrival_ns)
