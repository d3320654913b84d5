"""Groups of rays of a scan that hit the same object."""

from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lidar_core import _core
from lidar_core.arrays import as_rows
from lidar_core.circles.config import CirclesConfig
from lidar_core.circles.preprocess import as_scan
from lidar_core.circles.scan_config import SegmentConfig
from lidar_core.circles.scanner import Scanner
from lidar_core.config import as_config
from lidar_core.errors import InputError
from lidar_core.messages import ShortRepr


class Side(IntEnum):
    """Kind of the neighbour beside a segment."""

    FREE = 0
    """The next ray went past: no return, or a hit farther away. The object ends before it."""
    OCCLUDED = 1
    """The next ray ended on something nearer, or tells nothing: the object may go on behind."""
    FIELD_EDGE = 2
    """There is no next ray: the object may go on outside the field of view."""
    RANGE_CUT = 3
    """The next ray returned nothing, but the surface may lie beyond the range limits."""


@dataclass(frozen=True, slots=True, repr=False)
class Segments(ShortRepr):
    """Groups of rays, one per object.

    Attributes
    ----------
    labels : ndarray, shape (B,), int32
        Per ray: 0 for none, else the number of its segment, from 1 (m of eq. 6).
    sides : ndarray, shape (S, 2), uint8
        Kind of the neighbour before the first and after the last ray of each segment: a `Side`.
    rays : ndarray, shape (K,), uint32
        Rays of all segments, one segment after the other, each in the order of its sweep: over
        the seam of a full circle from the last ray to the first.
    starts : ndarray, shape (S + 1,), int64
        Index in `rays` at which each segment begins.
    """

    labels: NDArray[np.int32]
    sides: NDArray[np.uint8]
    rays: NDArray[np.uint32]
    starts: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.sides)

    def rays_of(self, number: int) -> NDArray[np.uint32]:
        """Rays of the segment with this number, from 1, in the order of the sweep."""
        if not 1 <= number <= len(self):
            raise IndexError(f"segments are numbered 1 to {len(self)}, got {number}")
        return self.rays[self.starts[number - 1] : self.starts[number]]


def segment(
    ranges: ArrayLike,
    bearings: ArrayLike,
    *,
    config: SegmentConfig | CirclesConfig | None = None,
    scanner: Scanner | None = None,
) -> Segments:
    """Group the rays of a scan by object.

    Parameters
    ----------
    ranges : array_like, shape (B,), float
        Range of every ray [m], level frame; +inf is a miss, NaN no information.
    bearings : array_like, shape (B,), float
        Directions of the rays [rad] in the order of the sweep; need not be equally spaced. In a
        full circle, the first ray is the neighbour of the last.
    config : SegmentConfig or CirclesConfig, optional
        None for the defaults. A `CirclesConfig` also contains its scanner.
    scanner : Scanner, optional
        Scanner whose range limits apply; None for the defaults.

    Returns
    -------
    Segments
        Numbered in the order of their first rays; over the seam of a full circle the last.

    Raises
    ------
    InputError
        Wrong shape, dtype or value.

    Notes
    -----
    Source: Sanchez-Lopez et al., eq. 6. Deterministic; releases the GIL.

    Examples
    --------
    >>> ranges = [np.inf, 2, 2.01, 2, 2.02, 5, 5, 5, 5]
    >>> found = segment(ranges, np.radians(np.arange(9.0)))
    >>> found.labels
    array([0, 1, 1, 1, 1, 2, 2, 2, 2], dtype=int32)
    >>> [[Side(side).name for side in sides] for sides in found.sides]
    [['FREE', 'FREE'], ['OCCLUDED', 'FIELD_EDGE']]
    """
    scan, angles = as_scan(ranges, bearings)
    if isinstance(config, CirclesConfig):
        scanner = scanner or config.scanner
        config = config.segment
    options, limits = as_config(config, SegmentConfig), as_config(scanner, Scanner)
    return segments_of(_core.segment_scan(scan, angles, config=options, scanner=limits))


def segments_of(arrays: tuple[NDArray[Any], ...]) -> Segments:
    """Convert the core's segments."""
    labels, rays, starts, sides = arrays
    return Segments(labels=labels, sides=sides, rays=rays, starts=starts)


def arrays_of(
    segments: Segments,
) -> tuple[NDArray[np.uint32], NDArray[np.int64], NDArray[np.uint8]]:
    """Return rays, starts and sides of segments for the core.

    Raises
    ------
    InputError
        The argument is not segments, or its arrays have a wrong type.
    """
    if not isinstance(segments, Segments):
        raise InputError(f"segments: expected Segments, got {type(segments).__name__}")
    name = "segments."
    return (
        as_rows(segments.rays, name=name + "rays", rows=None, shape=(), dtype=np.uint32),
        as_rows(segments.starts, name=name + "starts", rows=None, shape=(), dtype=np.int64),
        as_rows(segments.sides, name=name + "sides", rows=None, shape=(2,), dtype=np.uint8),
    )
