"""Tables for the scores, from simulated scans and from what the detector returned."""

from collections.abc import Iterable

import numpy as np

from lidar_core.evaluation.config import EvaluationConfig
from lidar_core.evaluation.scoring import eligible
from lidar_core.evaluation.types import Estimates, Truth
from lidar_core.flying import FlyingFrame, Tracks
from lidar_core.sim import SimulatedScan


def truth_of(
    made: SimulatedScan, *, is_burn_in: bool, config: EvaluationConfig | None = None
) -> Truth:
    """Targets of one simulated scan; during the burn-in none of them has to be found."""
    targets = made.truth
    sensor = made.world_from_lidar[:3, 3]
    return Truth(
        stamp_ns=np.full(len(targets.id), made.scan.stamp_ns, np.int64),
        id=targets.id.astype(np.int64),
        position=targets.position,
        is_eligible=eligible(targets.position, targets.hits, sensor, config=config)
        & np.bool_(not is_burn_in),
    )


def joined(parts: Iterable[Truth]) -> Truth:
    """Several tables as one."""
    tables = list(parts)
    return Truth(
        stamp_ns=np.concatenate([np.empty(0, np.int64), *(part.stamp_ns for part in tables)]),
        id=np.concatenate([np.empty(0, np.int64), *(part.id for part in tables)]),
        position=np.concatenate([np.empty((0, 3)), *(part.position for part in tables)]),
        is_eligible=np.concatenate([np.empty(0, bool), *(part.is_eligible for part in tables)]),
    )


def estimates_of_tracks(tracks: Iterable[Tracks]) -> Estimates:
    """Tracks at successive times as one table."""
    states = list(tracks)
    stamps = np.array([state.stamp_ns for state in states], np.int64)
    return Estimates(
        stamp_ns=np.repeat(stamps, [len(state) for state in states]),
        position=np.concatenate([np.empty((0, 3)), *(state.position for state in states)]),
        id=np.concatenate([np.empty(0, np.int64), *(state.id for state in states)]),
    )


def estimates_of_detections(frames: Iterable[FlyingFrame]) -> Estimates:
    """Detections of successive scans as one table."""
    results = list(frames)
    stamps = np.array([frame.stamp_ns for frame in results], np.int64)
    found = [frame.detections for frame in results]
    return Estimates(
        stamp_ns=np.repeat(stamps, [len(item) for item in found]),
        position=np.concatenate([np.empty((0, 3)), *(item.position for item in found)]),
    )
