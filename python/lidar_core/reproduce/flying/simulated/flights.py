"""Simulated flights, detectors of several configurations, and their stored results."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from lidar_core.evaluation import Estimates, EvaluationConfig, Truth, eligible
from lidar_core.flying import FlyingConfig, FlyingFrame, FlyingObjectDetector
from lidar_core.reproduce.common import Kind
from lidar_core.reproduce.jobs import Part
from lidar_core.sim import SimulatedScan, Simulator

DIFFERENCE_NS = 50_000_000
"""Half the time over which true velocities are compared, for accelerations [ns]."""


class PoseErrors(Protocol):
    """Source of pose errors of successive scans, such as `lidar_core.sim.NoisyPoses`."""

    @property
    def covariance(self) -> NDArray[np.float64]:
        """Covariance of the pose error of a scan, shape (6, 6)."""

    def observed(self, made: SimulatedScan) -> SimulatedScan:
        """Return the scan as a detector gets it."""


def both_modes() -> dict[str, FlyingConfig]:
    """Return the paper's configuration and the best one."""
    return {"paper": FlyingConfig.paper(), "best": FlyingConfig()}


def fly(
    simulator: Simulator,
    configs: Mapping[str, FlyingConfig],
    *,
    scans: int,
    noise: PoseErrors | None = None,
) -> Part:
    """Give the first `scans` scans to a detector of every configuration, with wrong poses.

    Detectors of best mode get the noise of the poses; the paper's detector has no use for it.

    Returns
    -------
    part : dict
        The columns of `Flight`: those of the truth, and for each configuration NAME those of
        its detections and tracks as NAME_detections_scan, NAME_tracks_id and so on.
    """
    detectors = {name: FlyingObjectDetector(config) for name, config in configs.items()}
    seen = {name: Seen() for name in detectors}
    truth: list[SimulatedScan] = []
    for number in range(scans):
        made = simulator.scan(number)
        truth.append(made)
        given = made if noise is None else noise.observed(made)
        for name, detector in detectors.items():
            covariance = None if noise is None or is_paper(name) else noise.covariance
            seen[name].add(number, processed(detector, given, pose_covariance=covariance))
    columns = truth_columns(simulator, truth)
    for name, one in seen.items():
        columns |= {f"{name}_{key}": value for key, value in one.columns().items()}
    return columns


def is_paper(name: str) -> bool:
    """Return whether a configuration of this name is the paper's."""
    return name.startswith("paper")


def processed(
    detector: FlyingObjectDetector,
    made: SimulatedScan,
    *,
    pose_covariance: NDArray[np.float64] | None = None,
) -> FlyingFrame:
    """Process one scan with all its data in a detector."""
    return detector.process(replace(made.posed, pose_covariance=pose_covariance))


@dataclass(slots=True)
class Seen:
    """Collector of the detections and tracks of one detector, filled scan by scan."""

    detections_scan: list[int] = field(default_factory=list)
    detections_position: list[NDArray[np.float64]] = field(default_factory=list)
    tracks_scan: list[int] = field(default_factory=list)
    tracks_id: list[int] = field(default_factory=list)
    tracks_position: list[NDArray[np.float64]] = field(default_factory=list)
    burn_in_scans: int = 0

    def add(self, number: int, frame: FlyingFrame) -> None:
        """Add the results of scan `number`."""
        self.detections_scan += [number] * len(frame.detections)
        self.detections_position += list(frame.detections.position)
        flying = frame.tracks.flying
        self.tracks_scan += [number] * len(flying)
        self.tracks_id += flying.id.tolist()
        self.tracks_position += list(flying.position)
        self.burn_in_scans += frame.status.is_burn_in

    def columns(self) -> Part:
        """Return the collected detections and tracks as arrays."""
        return {
            "detections_scan": np.array(self.detections_scan, np.int64),
            "detections_position": np.reshape(np.array(self.detections_position, float), (-1, 3)),
            "tracks_scan": np.array(self.tracks_scan, np.int64),
            "tracks_id": np.array(self.tracks_id, np.int64),
            "tracks_position": np.reshape(np.array(self.tracks_position, float), (-1, 3)),
            "burn_in_scans": np.array(self.burn_in_scans),
        }


def truth_columns(simulator: Simulator, scans: Iterable[SimulatedScan]) -> Part:
    """Ground truth of every scan: arrays of shape (S,), (S, 3), (S, T) or (S, T, 3).

    All of it is at the start of the scan, but `position_hit` at the mean time of the target's
    points, or of all points where it has none.
    """
    made = list(scans)
    stamps = np.array([one.scan.stamp_ns for one in made], np.int64)
    change = [
        way.velocities_at(stamps + DIFFERENCE_NS) - way.velocities_at(stamps - DIFFERENCE_NS)
        for way in simulator.targets
    ]
    return {
        "stamp_ns": stamps,
        "sensor": np.array([one.world_from_lidar[:3, 3] for one in made]),
        "id": made[0].truth.id.astype(np.int64),
        "radius": made[0].truth.radius,
        "position": np.array([one.truth.position for one in made]),
        "position_hit": np.array([_position_hit(simulator, one) for one in made]),
        "velocity": np.array([one.truth.velocity for one in made]),
        "acceleration": np.stack(change, axis=1) / (2e-9 * DIFFERENCE_NS),
        "hits": np.array([one.truth.hits for one in made]),
    }


def _position_hit(simulator: Simulator, made: SimulatedScan) -> NDArray[np.float64]:
    """Positions of the targets at the mean time of their points, (T, 3) [m]."""
    times = made.scan.point_time_ns
    if times is None:
        return made.truth.position
    start = made.scan.stamp_ns
    middle = float(np.mean(times - start))
    places = []
    for way, name in zip(simulator.targets, made.truth.id.tolist(), strict=True):
        met = times[made.label == name] - start
        when = start + round(float(met.mean()) if len(met) else middle)
        places.append(way.poses_at(np.array([when]))[0, :3, 3])
    return np.reshape(places, (-1, 3))


def tables(
    part: Part, name: str, kind: Kind, *, config: EvaluationConfig
) -> tuple[Estimates, Truth]:
    """Detections or tracks of the configuration `name`, and the targets, for the evaluation.

    The truth has one row per scan and target, in this order: for tracks the place at the start of
    the scan, for detections the place where rays hit the target. No target is required in the scans
    of the burn-in, as the run counted them, or in the first ones of `config`.
    """
    count = len(part["id"])
    stamps = part["stamp_ns"]
    position = part["position" if kind == "tracks" else "position_hit"].reshape(-1, 3)
    sensor = np.repeat(part["sensor"], count, axis=0)
    held = max(config.burn_in_scans, int(part.get(f"{name}_burn_in_scans", 0)))
    after = np.repeat(np.arange(len(stamps)) >= held, count)
    estimates = Estimates(
        stamp_ns=stamps[part[f"{name}_{kind}_scan"]],
        position=part[f"{name}_{kind}_position"],
        id=part[f"{name}_tracks_id"] if kind == "tracks" else None,
    )
    truth = Truth(
        stamp_ns=np.repeat(stamps, count),
        id=np.tile(part["id"], len(stamps)),
        position=position,
        is_eligible=eligible(position, part["hits"].reshape(-1), sensor, config=config) & after,
        sensor=sensor,
    )
    return estimates, truth
