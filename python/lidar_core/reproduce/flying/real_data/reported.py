"""Results of the flying-object detector in a sequence of posed scans, as arrays for counting."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from lidar_core.flying import FlyingConfig, FlyingFrame, FlyingObjectDetector
from lidar_core.io import PosedScan
from lidar_core.messages import Scan
from lidar_core.reproduce.jobs import Part

OWN_REACH, OWN_DRIFT, OWN_WAY = 4.0, 0.5, 1.0
"""A track of the own body: this near the sensor, moving less in its frame than the sensor [m]."""


@dataclass(slots=True)
class Reported:
    """Collector of the tracks and states of one detector, filled scan by scan."""

    rows: list[NDArray[np.float64]] = field(default_factory=list)
    sensors: list[NDArray[np.float64]] = field(default_factory=list)
    states: list[dict[str, Any]] = field(default_factory=list)

    def add(self, number: int, item: PosedScan[Scan], frame: FlyingFrame) -> None:
        """Add the results of scan `number`."""
        world_from_lidar = item.world_from_lidar.reshape(-1, 4, 4)[0]
        tracks = frame.tracks.flying
        place = tracks.position
        in_body = (place - world_from_lidar[:3, 3]) @ world_from_lidar[:3, :3]
        spread = np.trace(tracks.covariance[:, :3, :3], axis1=1, axis2=2)
        self.rows.append(
            np.column_stack(
                [
                    np.full(len(place), number),
                    tracks.id,
                    place,
                    in_body,
                    tracks.extent,
                    tracks.velocity,
                    np.sqrt(spread),
                ]
            )
        )
        self.sensors.append(world_from_lidar[:3, 3])
        status = frame.status
        self.states.append(
            {
                "sky": getattr(status, "sky", None),
                "sky_share": getattr(status, "sky_share", None),
                "own_body": getattr(status, "own_body", None),
                "gate_open": status.gate_open,
            }
        )

    def columns(self) -> Part:
        """Return all results as arrays, with one row per track and scan or one row per scan."""
        rows = np.concatenate([*self.rows, np.empty((0, 15))])
        return {
            "scan": rows[:, 0].astype(np.int64),
            "id": rows[:, 1].astype(np.int64),
            "position": rows[:, 2:5],
            "in_body": rows[:, 5:8],
            "extent": rows[:, 8:11],
            "velocity": rows[:, 11:14],
            "std": rows[:, 14],
            "sensor": np.array(self.sensors).reshape(-1, 3),
            "sky": np.array([str(one["sky"]) for one in self.states], np.str_),
            "sky_share": _numbers(self.states, "sky_share"),
            "own_body": _numbers(self.states, "own_body"),
            "gate_open": np.array([one["gate_open"] for one in self.states], np.bool_),
        }


class Counter(Protocol):
    """Something that counts in the frames of a detector."""

    def add(self, number: int, item: PosedScan[Scan], frame: FlyingFrame) -> None:
        """Add the results of scan `number`."""

    def columns(self) -> Part:
        """Return all counts as arrays."""


def reported(
    items: Iterable[PosedScan[Scan]],
    config: FlyingConfig,
    *,
    scans: int | None = None,
    also: Counter | None = None,
) -> Part:
    """Run a detector over the first `scans` of a sequence.

    `Reported.columns` lists the results; `also` adds its own.
    """
    detector, kept = FlyingObjectDetector(config), Reported()
    for number, item in enumerate(items):
        if number == scans:
            break
        frame = detector.process(item)
        kept.add(number, item, frame)
        if also is not None:
            also.add(number, item, frame)
    return kept.columns() | (also.columns() if also is not None else {})


@dataclass(frozen=True, slots=True)
class FalseTrack:
    """A reported track ID that belongs to no target.

    Attributes
    ----------
    number : int
        Number of the track.
    scans : tuple of int
        First and last scan in which it is reported.
    distance : float
        Median distance from the sensor [m].
    in_body : ndarray, shape (3,)
        Median place in the sensor's frame [m].
    is_own_body : bool
        True if it stays near the sensor and moves along with it.
    """

    number: int
    scans: tuple[int, int]
    distance: float
    in_body: NDArray[np.float64]
    is_own_body: bool


def false_tracks(part: Part, matched: Iterable[int] = ()) -> list[FalseTrack]:
    """Tracks of a run whose IDs are not `matched` to a target in any scan."""
    names = sorted(set(part["id"].tolist()) - set(matched))
    return [_false_track(part, name) for name in names]


def _false_track(part: Part, name: int) -> FalseTrack:
    rows = part["id"] == name
    scans, in_body = part["scan"][rows], part["in_body"][rows]
    distance = np.linalg.norm(in_body, axis=1)
    drift = float(np.ptp(in_body, axis=0).max())
    way = float(np.linalg.norm(part["sensor"][scans[-1]] - part["sensor"][scans[0]]))
    is_near = float(np.median(distance)) < OWN_REACH
    return FalseTrack(
        number=int(name),
        scans=(int(scans[0]), int(scans[-1])),
        distance=float(np.median(distance)),
        in_body=np.median(in_body, axis=0),
        is_own_body=is_near and drift < OWN_DRIFT and way > min(OWN_WAY, 2 * drift + 0.1),
    )


def _numbers(states: list[dict[str, Any]], name: str) -> NDArray[np.float64]:
    return np.array([np.nan if one[name] is None else one[name] for one in states], np.float64)
