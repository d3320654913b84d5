"""Recordings of 2D scanners, and their scans with poses."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lidar_core.circles import CirclesConfig
from lidar_core.circles.scan_layout import scanner_of
from lidar_core.errors import FormatError
from lidar_core.io import (
    NoTransformError,
    PosedScan,
    TransformBuffer,
    open_recording,
    posed_laser_scans,
)
from lidar_core.messages import LaserScan, Pose
from lidar_core.reproduce.recordings import recording

NAMELESS = "world"
"""Stands for a frame without a name, which no transform may have."""
STEP_NS = 100_000_000
"""Half of the time over which velocities of motion capture are taken [ns]."""


@dataclass(frozen=True, slots=True)
class Room:
    """A recording of one 2D scanner.

    Attributes
    ----------
    name : str
        Name in the rows.
    path : str
        Place within the folder of recordings.
    pose : str
        Source of the poses, as `PoseOptions.pose`.
    mounting : tuple of str
        Mountings that the recording does not state, as `PoseOptions.mounting`.
    vehicle : str or None
        Topic of the poses of a vehicle with motion capture.
    first : int
        Scans before this one are left out.
    scans : int
        Largest number of scans that are used.
    """

    name: str
    path: str
    pose: str = "auto"
    mounting: tuple[str, ...] = ()
    vehicle: str | None = None
    first: int = 0
    scans: int = 100_000


_CAR = ("ego_pose laser -0.12 0 0 0 0 0",)
ROOMS = (
    Room("intersection", "2d/datmo/intersection.bag", mounting=_CAR, vehicle="/red_pose"),
    Room("overtake_ego", "2d/datmo/overtake_ego.bag", mounting=_CAR, vehicle="/red_pose"),
    Room("overtake_red", "2d/datmo/overtake_red.bag", mounting=_CAR, vehicle="/red_pose"),
    Room("parallel", "2d/datmo/parallel.bag", mounting=_CAR, vehicle="/red_pose"),
    Room("aces", "2d/radish/aces.clf.bz2", first=500, scans=400),
    Room("fr079", "2d/radish/fr079.clf.bz2", first=500, scans=400),
    Room("intel", "2d/radish/intel.clf.bz2", first=3000, scans=400),
    Room("mit-csail", "2d/radish/mit-csail.clf.bz2", scans=400),
)
"""Robots that drive: rooms with motion capture, offices and halls with odometry."""
CORRIDOR = tuple(
    Room(f"example{number}", f"people/corridor/example{number}/example{number}.db3", pose="static")
    for number in (1, 3, 4, 5, 7, 8)
)
"""A scanner that stands beside a corridor in which people pass."""
PERSONS = {
    "example1": 1,
    "example3": 2,
    "example4": 1,
    "example5": 2,
    "example7": 5,
    "example8": 4,
}
"""Different people who pass, as the recordings' authors counted."""


@contextmanager
def _opened(room: Room) -> Iterator[Iterator[PosedScan[LaserScan]]]:
    with open_recording(recording(room.path)) as opened:
        posed = posed_laser_scans(opened, pose=room.pose, mounting=room.mounting)
        yield (item for number, item in enumerate(posed) if number >= room.first)


def room_scans(room: Room) -> list[PosedScan[LaserScan]]:
    """Scans of a recording with their poses, by time."""
    with _opened(room) as items:
        found = [item for _, item in zip(range(room.scans), items, strict=False)]
    found.sort(key=lambda item: item.scan.stamp_ns)
    return found


def room_config(items: list[PosedScan[LaserScan]], config: CirclesConfig) -> CirclesConfig:
    """Return `config` with the scanner of the scans, like the command `circles`."""
    scan = items[0].scan
    if any(len(item.scan.ranges) != len(scan.ranges) for item in items):
        raise FormatError("scans: expected one number of rays in all scans")
    name = scan.topic or scan.frame_id
    return type(config).load(
        config.model_dump() | {"scanners": {name: scanner_of(scan, config, name)}}
    )


def vehicle_at(
    path: Path, topic: str, stamps: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Place and velocity (K, 2) of a vehicle in the frame of motion capture; NaN if unknown."""
    buffer, frame = TransformBuffer(max_gap=0.5, max_extrapolation=0.1), NAMELESS
    with open_recording(path) as opened:
        for found, pose in opened.poses():
            if found.name == topic:
                frame = pose.frame_id or NAMELESS
                buffer.add(Pose(pose.stamp_ns, frame, "vehicle", pose.matrix))
    place, velocity = np.full((len(stamps), 2), np.nan), np.full((len(stamps), 2), np.nan)
    for number, stamp in enumerate(stamps.tolist()):
        try:
            around = buffer.lookup(frame, "vehicle", [stamp - STEP_NS, stamp, stamp + STEP_NS])
        except NoTransformError:
            continue
        before, place[number], after = around[:, :2, 3]
        velocity[number] = (after - before) / (2 * STEP_NS * 1e-9)
    return place, velocity
