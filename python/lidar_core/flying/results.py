"""What the flying-object detector and the tracker return: arrays, one row per object."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class Tracks:
    """Tracks at one time, by ascending number, in the world frame.

    Attributes
    ----------
    id : ndarray, shape (T,), int64
        Number of the track, never reused.
    position, velocity, acceleration : ndarray, shape (T, 3), float64
        [m], [m/s], [m/s^2].
    covariance : ndarray, shape (T, 9, 9), float64
        Of position, velocity and acceleration, in this order.
    extent : ndarray, shape (T, 3), float64
        Sides of the bounding box of the last cluster or detection [m].
    n_detections : ndarray, shape (T,), int64
        Detections that held the track.
    age : ndarray, shape (T,), float64
        Time since its first detection [s].
    stamp_ns : int
        Time of the states [ns].
    """

    id: NDArray[np.int64]
    position: NDArray[np.float64]
    velocity: NDArray[np.float64]
    acceleration: NDArray[np.float64]
    covariance: NDArray[np.float64]
    extent: NDArray[np.float64]
    n_detections: NDArray[np.int64]
    age: NDArray[np.float64]
    stamp_ns: int

    def __len__(self) -> int:
        return len(self.id)


@dataclass(frozen=True, slots=True)
class TrackEvents:
    """What one call did to the tracks, unconfirmed ones included, by their numbers.

    Attributes
    ----------
    is_late : bool
        The cloud was older than the newest one: kept for late detections, tracks untouched.
    corrected, born, confirmed, removed : ndarray, shape (K,), int64
        Tracks corrected by a cluster; new ones; reported from now on; removed.
    merged : ndarray, shape (K, 2), int64
        The track that stays and the one that went into it.
    n_rejected : int
        Measurements not used because a covariance was not positive definite.
    """

    is_late: bool
    corrected: NDArray[np.int64]
    born: NDArray[np.int64]
    confirmed: NDArray[np.int64]
    removed: NDArray[np.int64]
    merged: NDArray[np.int64]
    n_rejected: int
