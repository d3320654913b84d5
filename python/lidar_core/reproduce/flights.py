"""Simulated flights through detectors of several configurations, and what is kept of them."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from lidar_core.flying import FlyingConfig, FlyingFrame, FlyingObjectDetector

if TYPE_CHECKING:
    from lidar_core.reproduce.jobs import Part
    from lidar_core.sim import SimulatedScan, Simulator

Kind: TypeAlias = Literal["detections", "tracks"]
Observe: TypeAlias = "Callable[[SimulatedScan], SimulatedScan]"
"""What the detectors are given of a scan: as it is, or with noise on its poses."""
DIFFERENCE_NS = 50_000_000
"""Half the time over which true velocities are compared, for accelerations [ns]."""


def both_modes() -> dict[str, FlyingConfig]:
    """Return the paper's configuration and the best one."""
    return {"paper": FlyingConfig.paper(), "best": FlyingConfig()}


def fly(
    simulator: "Simulator",
    configs: Mapping[str, FlyingConfig],
    *,
    scans: int,
    observe: "Observe" = lambda made: made,
) -> "Part":
    """Give the first `scans` scans to a detector of every configuration.

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
        given = observe(made)
        for name, detector in detectors.items():
            seen[name].add(number, processed(detector, given))
    columns = truth_columns(simulator, truth)
    for name, one in seen.items():
        columns |= {f"{name}_{key}": value for key, value in one.columns().items()}
    return columns


def processed(detector: FlyingObjectDetector, made: "SimulatedScan") -> FlyingFrame:
    """Give one scan to a detector, with everything that is known about it."""
    scan = made.scan
    return detector.process(
        scan.points,
        made.poses,
        scan.stamp_ns,
        no_return=scan.no_return,
        directions=scan.directions,
        point_time_ns=scan.point_time_ns,
        pose_stamps_ns=made.pose_stamps_ns,
    )


@dataclass(slots=True)
class Seen:
    """Detections and tracks of one detector so far."""

    detections_scan: list[int] = field(default_factory=list)
    detections_position: list[NDArray[np.float64]] = field(default_factory=list)
    tracks_scan: list[int] = field(default_factory=list)
    tracks_id: list[int] = field(default_factory=list)
    tracks_position: list[NDArray[np.float64]] = field(default_factory=list)

    def add(self, number: int, frame: FlyingFrame) -> None:
        """Keep what scan `number` gave."""
        self.detections_scan += [number] * len(frame.detections)
        self.detections_position += list(frame.detections.position)
        self.tracks_scan += [number] * len(frame.tracks)
        self.tracks_id += frame.tracks.id.tolist()
        self.tracks_position += list(frame.tracks.position)

    def columns(self) -> "Part":
        """Everything as arrays."""
        return {
            "detections_scan": np.array(self.detections_scan, np.int64),
            "detections_position": np.reshape(np.array(self.detections_position, float), (-1, 3)),
            "tracks_scan": np.array(self.tracks_scan, np.int64),
            "tracks_id": np.array(self.tracks_id, np.int64),
            "tracks_position": np.reshape(np.array(self.tracks_position, float), (-1, 3)),
        }


def truth_columns(simulator: "Simulator", scans: "Iterable[SimulatedScan]") -> "Part":
    """What is true at the start of every scan: arrays of (S,), (S, 3), (S, T) or (S, T, 3)."""
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
        "velocity": np.array([one.truth.velocity for one in made]),
        "acceleration": np.stack(change, axis=1) / (2e-9 * DIFFERENCE_NS),
        "hits": np.array([one.truth.hits for one in made]),
    }


@dataclass(frozen=True, slots=True)
class Pairs:
    """Estimates of one flight, each with the target that it was assigned to.

    Attributes
    ----------
    scan, target : ndarray, shape (E,), int64
        Scan, and place of the target among the targets; -1 where it has none within the gate.
    position : ndarray, shape (E, 3), float64
        Estimate [m].
    nearest : ndarray, shape (E,), float64
        Distance to the nearest target [m].
    """

    scan: NDArray[np.int64]
    target: NDArray[np.int64]
    position: NDArray[np.float64]
    nearest: NDArray[np.float64]


def pairs(part: "Part", name: str, kind: Kind) -> Pairs:
    """Assign the detections or tracks of the configuration `name` to the targets, per scan."""
    from lidar_core.evaluation import EvaluationConfig, match

    scan = part[f"{name}_{kind}_scan"]
    position = part[f"{name}_{kind}_position"]
    target = np.full(len(scan), -1, np.int64)
    nearest = np.full(len(scan), np.inf)
    for number in np.unique(scan).tolist():
        here = np.flatnonzero(scan == number)
        matches = match(position[here], part["position"][number], gate=EvaluationConfig().gate)
        target[here[matches.estimate]] = matches.target
        nearest[here] = matches.nearest
    return Pairs(scan, target, position, nearest)
