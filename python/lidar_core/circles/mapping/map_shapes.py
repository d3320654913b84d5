"""Elements of the map that are no circles."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class ShapeElements:
    """Lines, ellipses and rectangles of the map at one time, by number, in the world frame.

    Attributes
    ----------
    id : ndarray, shape (K,), int64
        Number of the element, never reused. An ellipse or rectangle that is not large is a circle
        of the map, too, with the same number, which it keeps whatever it is taken for.
    kind : ndarray, shape (K,), uint8
        A `ShapeKind`.
    center, velocity : ndarray, shape (K, 2), float64
        [m], [m/s]; lines are at rest. The centre of an ellipse or rectangle is its own, not that
        of the circle.
    heading : ndarray, shape (K,), float64
        Bearing of the longer half length [rad], -pi/2 to pi/2. Of a line that of the way from its
        first to its second end, on the left of which it was seen.
    half_size : ndarray, shape (K, 2), float64
        Longer and shorter half length [m]; of a line half of what was seen of it, and 0.
    ends : ndarray, shape (K, 2, 2), float64
        Both ends of a line [m]: as far as it was seen.
    covariance : ndarray, shape (K, 7, 7), float64
        Of x, y, vx, vy, heading and the half lengths, in this order; of a line across it and of
        its heading only: where it ends was seen, not estimated.
    age : ndarray, shape (K,), float64
        Time since its first measurement [s].
    seen_ns : ndarray, shape (K,), int64
        Time of its last measurement [ns].
    visible : ndarray, shape (K,), bool
        A sensor's newest scan measured it, or should have: it is neither hidden nor out of view.
    stamp_ns : int
        Time of the states [ns].
    """

    id: NDArray[np.int64]
    kind: NDArray[np.uint8]
    center: NDArray[np.float64]
    velocity: NDArray[np.float64]
    heading: NDArray[np.float64]
    half_size: NDArray[np.float64]
    ends: NDArray[np.float64]
    covariance: NDArray[np.float64]
    age: NDArray[np.float64]
    seen_ns: NDArray[np.int64]
    visible: NDArray[np.bool_]
    stamp_ns: int

    def __len__(self) -> int:
        return len(self.id)


def shape_elements_of(arrays: tuple[NDArray[Any], ...], stamp_ns: int) -> ShapeElements:
    """Confirmed elements of those that the core gives."""
    *columns, confirmed = arrays
    number, kind, mean, covariance, ends, age, seen_ns, visible = (
        column[confirmed] for column in columns
    )
    return ShapeElements(
        id=number,
        kind=kind,
        center=mean[:, 0:2],
        velocity=mean[:, 2:4],
        heading=mean[:, 4],
        half_size=mean[:, 5:7],
        ends=ends,
        covariance=covariance,
        age=age,
        seen_ns=seen_ns,
        visible=visible,
        stamp_ns=stamp_ns,
    )
