"""What the evaluation reads and returns: long tables in, scores out."""

from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class Truth:
    """Targets, one row per target and scan, in any order.

    Attributes
    ----------
    stamp_ns : ndarray, shape (R,), int64
        Time of the scan [ns].
    id : ndarray, shape (R,), int64
        Number of the target.
    position : ndarray, shape (R, 3), float64
        Its centre [m], world frame.
    is_eligible : ndarray, shape (R,), bool
        Whether it had to be found in this scan (`eligible`).
    """

    stamp_ns: NDArray[np.int64]
    id: NDArray[np.int64]
    position: NDArray[np.float64]
    is_eligible: NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Estimates:
    """Detections or tracks, one row per object and scan, in any order.

    Attributes
    ----------
    stamp_ns : ndarray, shape (E,), int64
        Time of the scan [ns].
    position : ndarray, shape (E, 3), float64
        Where the object was reported [m], world frame.
    id : ndarray, shape (E,), int64, optional
        Number of the track; detections have none.
    """

    stamp_ns: NDArray[np.int64]
    position: NDArray[np.float64]
    id: NDArray[np.int64] | None = None


@dataclass(frozen=True, slots=True)
class DetectionScores:
    """Scores of estimates without identity. Ratios of nothing are None.

    Attributes
    ----------
    n_scans : int
        Scans with a target or an estimate.
    n_eligible, n_found : int
        Target-scans that had to be found, and those of them that were.
    n_estimates, n_matched, n_duplicate, n_false : int
        Estimates in all; matched with any target; within the gate of a target that another
        estimate was matched with; further than the gate from every target.
    recall : float or None
        `n_found / n_eligible`.
    precision : float or None
        `n_matched / n_estimates`.
    mean_error, rmse, max_error : float or None
        Of the distances between the found targets and their estimates [m].
    stamp_ns : ndarray, shape (S,), int64
        Scans in which a target had to be found [ns].
    recall_at : ndarray, shape (S,), float64
        Share of these targets that were found, per scan.
    """

    n_scans: int
    n_eligible: int
    n_found: int
    n_estimates: int
    n_matched: int
    n_duplicate: int
    n_false: int
    recall: float | None
    precision: float | None
    mean_error: float | None
    rmse: float | None
    max_error: float | None
    stamp_ns: NDArray[np.int64] = field(repr=False)
    recall_at: NDArray[np.float64] = field(repr=False)

    def to_dict(self) -> dict[str, Any]:
        """Every number as plain values, ready for JSON; the arrays are left out."""
        return {
            name: value for name, value in asdict(self).items() if not isinstance(value, np.ndarray)
        }


@dataclass(frozen=True, slots=True)
class TrackScores(DetectionScores):
    """Scores of tracks: those of their positions, and those of their identities.

    Attributes
    ----------
    track_ids : tuple of int
        Tracks reported at least once.
    false_ids : tuple of int
        Tracks that were further than the gate from every target in at least one scan.
    n_switches : int
        How often a target was matched with another track than the last time.
    first_delay : dict
        Per target that ever had to be found: time from the first such scan to its first track
        [s]; None if it never had one.
    longest_gap : dict
        Per target: longest time without a track in which it had to be found in every scan [s];
        up to the scan that has the track, where there is one.
    """

    track_ids: tuple[int, ...]
    false_ids: tuple[int, ...]
    n_switches: int
    first_delay: dict[int, float | None]
    longest_gap: dict[int, float]
