"""Tables for the scores, from simulated scans and from results of the detector."""

from collections.abc import Iterable
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from lidar_core.config import as_config
from lidar_core.evaluation.config import EvaluationConfig
from lidar_core.evaluation.matching.pairing import checked_estimates
from lidar_core.evaluation.scoring import eligible
from lidar_core.evaluation.types import Estimates, Truth
from lidar_core.util.steps import nearest_row

if TYPE_CHECKING:
    from lidar_core.flying import FlyingFrame, Tracks
    from lidar_core.sim import SimulatedScan


def truth_of(
    made: "SimulatedScan", *, is_burn_in: bool, config: EvaluationConfig | None = None
) -> Truth:
    """Return the targets of one simulated scan; none is required during the burn-in."""
    targets = made.truth
    sensor = made.world_from_lidar[:3, 3]
    return Truth(
        stamp_ns=np.full(len(targets.id), made.scan.stamp_ns, np.int64),
        id=targets.id.astype(np.int64),
        position=targets.position,
        is_eligible=eligible(targets.position, targets.hits, sensor, config=config)
        & np.bool_(not is_burn_in),
        velocity=targets.velocity,
        sensor=np.tile(sensor, (len(targets.id), 1)),
    )


def joined(parts: Iterable[Truth]) -> Truth:
    """Join several tables; a column that is missing in one of them is left out."""
    tables = list(parts)
    velocity = [part.velocity for part in tables if part.velocity is not None]
    sensor = [part.sensor for part in tables if part.sensor is not None]
    radius = [part.radius for part in tables if part.radius is not None]
    is_new = [part.is_interpolated for part in tables if part.is_interpolated is not None]
    return Truth(
        stamp_ns=np.concatenate([np.empty(0, np.int64), *(part.stamp_ns for part in tables)]),
        id=np.concatenate([np.empty(0, np.int64), *(part.id for part in tables)]),
        position=_concatenate([part.position for part in tables]),
        is_eligible=np.concatenate([np.empty(0, bool), *(part.is_eligible for part in tables)]),
        velocity=_concatenate(velocity) if len(velocity) == len(tables) else None,
        sensor=_concatenate(sensor) if len(sensor) == len(tables) else None,
        radius=np.concatenate([np.empty(0), *radius]) if len(radius) == len(tables) else None,
        is_interpolated=np.concatenate([np.empty(0, bool), *is_new])
        if is_new and len(is_new) == len(tables)
        else None,
    )


def estimates_of_tracks(tracks: "Iterable[Tracks]") -> Estimates:
    """Return flying tracks at successive times as one table; at equal times the last state."""
    states = [state.flying for state in {state.stamp_ns: state for state in tracks}.values()]
    stamps = np.array([state.stamp_ns for state in states], np.int64)
    covariance = [state.covariance[:, :6, :6] for state in states]
    return Estimates(
        stamp_ns=np.repeat(stamps, [len(state) for state in states]),
        position=_concatenate([state.position for state in states]),
        id=np.concatenate([np.empty(0, np.int64), *(state.id for state in states)]),
        velocity=_concatenate([state.velocity for state in states]),
        covariance=np.concatenate([np.empty((0, 6, 6)), *covariance]),
    )


def estimates_of_detections(frames: "Iterable[FlyingFrame]") -> Estimates:
    """Return detections of successive scans as one table."""
    results = list(frames)
    stamps = np.array([frame.stamp_ns for frame in results], np.int64)
    found = [frame.detections for frame in results]
    return Estimates(
        stamp_ns=np.repeat(stamps, [len(item) for item in found]),
        position=_concatenate([item.position for item in found]),
        covariance=np.concatenate([np.empty((0, 3, 3)), *(item.covariance for item in found)]),
        time_ns=np.concatenate([np.empty(0, np.int64), *(item.time_ns for item in found)]),
    )


def aligned(
    estimates: Estimates, truth: Truth, *, config: EvaluationConfig | None = None
) -> Estimates:
    """Return the estimates with times of the truth, if one is within `time_tolerance`.

    The time within the scan, `time_ns - stamp_ns`, does not change.
    """
    tolerance = as_config(config, EvaluationConfig).time_tolerance * 1e9
    when = np.unique(truth.stamp_ns)
    if not len(when):
        return estimates
    estimates = checked_estimates(estimates)
    stamps, times = estimates.stamp_ns, estimates.time_ns
    nearest = when[nearest_row(when, stamps)]
    is_near = np.abs(nearest - stamps) <= tolerance
    shift = np.where(is_near, nearest - stamps, np.int64(0))
    if times is not None:
        times = times + shift
    return replace(estimates, stamp_ns=stamps + shift, time_ns=times)


def _concatenate(parts: Iterable[NDArray[np.float64]]) -> NDArray[np.float64]:
    return np.concatenate([np.empty((0, 3)), *parts])
