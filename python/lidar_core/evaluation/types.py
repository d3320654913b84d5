"""Input and output of the evaluation: long tables and scores."""

from dataclasses import dataclass, field, fields, is_dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_core.evaluation.metrics.consistency import Consistency
from lidar_core.evaluation.spread import Spread


@dataclass(frozen=True, slots=True)
class Truth:
    """Targets, one row per target and scan, in any order.

    Attributes
    ----------
    stamp_ns : ndarray, shape (R,), int64
        Time of the scan [ns].
    id : ndarray, shape (R,), int64
        ID of the target.
    position : ndarray, shape (R, 3), float64
        Centre of the target at that time [m], world frame.
    is_eligible : ndarray, shape (R,), bool
        True if the target is required in this scan (`eligible`).
    velocity : ndarray, shape (R, 3), float64, optional
        Velocity of the target [m/s], world frame.
    sensor : ndarray, shape (R, 3), float64, optional
        Position of the sensor [m], world frame; NaN if unknown.
    radius : ndarray, shape (R,), float64, optional
        Radius of a round object [m]; NaN for other objects.
    is_interpolated : ndarray, shape (R,), bool, optional
        True if the position was interpolated to the time of the scan. None if the targets are at
        the times that the file has.
    n_before, n_after : int
        Rows of the file before the first and after the last scan of the run, which were left out.
    """

    stamp_ns: NDArray[np.int64]
    id: NDArray[np.int64]
    position: NDArray[np.float64]
    is_eligible: NDArray[np.bool_]
    velocity: NDArray[np.float64] | None = None
    sensor: NDArray[np.float64] | None = None
    radius: NDArray[np.float64] | None = None
    is_interpolated: NDArray[np.bool_] | None = None
    n_before: int = 0
    n_after: int = 0


@dataclass(frozen=True, slots=True)
class Estimates:
    """Detections or tracks, one row per object and scan, in any order.

    Attributes
    ----------
    stamp_ns : ndarray, shape (E,), int64
        Time of the scan [ns].
    position : ndarray, shape (E, 3), float64
        Reported position [m], world frame.
    id : ndarray, shape (E,), int64, optional
        ID of the track; detections have none.
    velocity : ndarray, shape (E, 3), float64, optional
        Reported velocity [m/s].
    covariance : ndarray, shape (E, 3, 3) or (E, 6, 6), float64, optional
        Covariance of the position, or of position and velocity; (E, 2, 2) or (E, 4, 4) in a plane.
    time_ns : ndarray, shape (E,), int64, optional
        Time at which each position was true [ns]; default: `stamp_ns`. If the truth has velocities,
        a target is predicted to that time before the comparison.
    radius : ndarray, shape (E,), float64, optional
        Reported radius [m].
    """

    stamp_ns: NDArray[np.int64]
    position: NDArray[np.float64]
    id: NDArray[np.int64] | None = None
    velocity: NDArray[np.float64] | None = None
    covariance: NDArray[np.float64] | None = None
    time_ns: NDArray[np.int64] | None = None
    radius: NDArray[np.float64] | None = None


@dataclass(frozen=True, slots=True)
class DistanceScores:
    """Scores of one group by distance from the sensor. Ratios of nothing are None.

    Attributes
    ----------
    near, far : float
        Edges [m].
    n_eligible, n_found : int
        Number of required targets at this distance, and number of those that were found.
    n_estimates, n_matched : int
        Estimates at this distance, and those matched with any target.
    recall, precision : float or None
        `n_found / n_eligible`, `n_matched / n_estimates`.
    position_error : Spread or None
        Position errors of the found targets at this distance [m].
    """

    near: float
    far: float
    n_eligible: int
    n_found: int
    n_estimates: int
    n_matched: int
    recall: float | None
    precision: float | None
    position_error: Spread | None


@dataclass(frozen=True, slots=True)
class SetScores:
    """OSPA and GOSPA, means over the scans with a target or an estimate that counts.

    Attributes
    ----------
    n_scans : int
        Number of these scans.
    ospa, gospa : float
        Mean distances [m].
    localisation, missed, false : float
        Mean parts of GOSPA before the root [m^p].
    """

    n_scans: int
    ospa: float
    gospa: float
    localisation: float
    missed: float
    false: float


@dataclass(frozen=True, slots=True)
class DetectionScores:
    """Scores of estimates without identity. Ratios of nothing are None.

    Attributes
    ----------
    n_scans : int
        Scans with a target or an estimate.
    duration : float
        Time that these scans cover [s].
    n_eligible, n_found : int
        Number of pairs of scan and required target, and number of those that were found.
    n_estimates, n_matched, n_duplicate, n_false : int
        Estimates in all; matched with any target; within the gate of a target that another
        estimate was matched with; further than the gate from every target.
    recall : float or None
        `n_found / n_eligible`.
    precision : float or None
        `n_matched / n_estimates`.
    position_error : Spread or None
        Distances between the found targets and their estimates [m].
    radial_error, across_error : Spread or None
        Position errors along the line of sight [m], positive behind the target, and length of the
        error across that line [m]. None if the position of the sensor is unknown.
    velocity_error : Spread or None
        Length of the difference of the velocities [m/s]; None where one is unknown.
    radius_error : Spread or None
        Reported minus true radius, signed [m]; None where one is unknown.
    over_distance : tuple of DistanceScores
        Scores by distance from the sensor, for groups with a target or an estimate.
    sets : SetScores or None
        OSPA and GOSPA; None if no scan counts.
    position_nees : Consistency or None
        NEES of the position, 3 degrees of freedom, 2 in a plane; None without covariances.
    first_delay : dict
        Per target that is required at least once: time from the first such scan to its first
        estimate [s]; None without an estimate.
    longest_gap : dict
        Per target: longest time without an estimate while it was required in every scan [s], up to
        the scan with the next estimate, if there is one.
    n_fragmentations : int
        Number of times that a target was lost and found again, among the scans in which it is
        required.
    metrics : dict
        Numbers of registered metrics (`register_metric`) by name; None where one does not apply.
    stamp_ns : ndarray, shape (S,), int64
        Stamps of scans with a required target [ns].
    recall_at : ndarray, shape (S,), float64
        Share of these targets that were found, per scan.
    """

    n_scans: int
    duration: float
    n_eligible: int
    n_found: int
    n_estimates: int
    n_matched: int
    n_duplicate: int
    n_false: int
    recall: float | None
    precision: float | None
    position_error: Spread | None
    radial_error: Spread | None
    across_error: Spread | None
    velocity_error: Spread | None
    radius_error: Spread | None
    over_distance: tuple[DistanceScores, ...]
    sets: SetScores | None
    position_nees: Consistency | None
    first_delay: dict[int, float | None]
    longest_gap: dict[int, float]
    n_fragmentations: int
    metrics: dict[str, float | None]
    stamp_ns: NDArray[np.int64] = field(repr=False)
    recall_at: NDArray[np.float64] = field(repr=False)

    @property
    def mean_error(self) -> float | None:
        """Mean of `position_error` [m]."""
        return None if self.position_error is None else self.position_error.mean

    @property
    def rmse(self) -> float | None:
        """Root of the mean square of `position_error` [m]."""
        return None if self.position_error is None else self.position_error.rmse

    @property
    def max_error(self) -> float | None:
        """Largest of `position_error` [m]."""
        return None if self.position_error is None else self.position_error.largest

    def to_dict(self) -> dict[str, Any]:
        """Return every number as plain values, ready for JSON, without the arrays.

        `over_distance` becomes one value per name: `recall@10m` is that of the group up to 10 m.
        """
        values: dict[str, Any] = plain(self)
        values["over_distance"] = {
            f"{name}@{group.far:g}m": value
            for group in self.over_distance
            for name, value in (
                ("recall", group.recall),
                ("precision", group.precision),
                ("error", None if group.position_error is None else group.position_error.mean),
            )
        }
        return values


@dataclass(frozen=True, slots=True)
class TrackScores(DetectionScores):
    """Scores of tracks: those of their positions, and those of their identities.

    Attributes
    ----------
    track_ids : tuple of int
        Tracks reported at least once.
    false_ids : tuple of int
        Tracks that were further than the gate from every target in at least one scan.
    false_tracks_per_minute : float or None
        Number of `false_ids` over `duration`.
    n_switches : int
        Number of times that a target was matched with another track than before.
    state_nees : Consistency or None
        NEES of position and velocity together, 6 degrees of freedom, 4 in a plane; None if one is
        unknown.
    """

    track_ids: tuple[int, ...]
    false_ids: tuple[int, ...]
    false_tracks_per_minute: float | None
    n_switches: int
    state_nees: Consistency | None


def plain(value: Any) -> Any:
    """Convert dataclasses to dicts and tuples to lists; fields with arrays are left out."""
    if is_dataclass(value):
        held = {item.name: getattr(value, item.name) for item in fields(value)}
        return {
            name: plain(item) for name, item in held.items() if not isinstance(item, np.ndarray)
        }
    if isinstance(value, dict):
        return {name: plain(item) for name, item in value.items()}
    return [plain(item) for item in value] if isinstance(value, tuple) else value
