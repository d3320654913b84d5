"""Input of the networks: windows in their own frames, or whole scans, normalised."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_core import _core
from lidar_core.circles.samples import Samples
from lidar_core.circles.scanner import Scanner
from lidar_core.circles.segmentation import Segments, Side

MISSING = -1.0
"""What the paper's network is shown where there is no range, sec. IV-A."""
_OUTWARD = np.array([-1, 1])


@dataclass(frozen=True, slots=True)
class Spans:
    """Rays between the first and the last hit of each of several objects.

    Attributes
    ----------
    rays, owner : ndarray, shape (R,), int64
        Index of each ray in its sweep, and number of its object.
    starts : ndarray, shape (N + 1,), int64
        Index of the first ray of each object.
    """

    rays: NDArray[np.int64]
    owner: NDArray[np.int64]
    starts: NDArray[np.int64]

    @classmethod
    def between(cls, first: NDArray[np.int64], count: NDArray[np.int64], n_beams: int) -> "Spans":
        """Make spans of `count` rays from each ray `first` on, over the end of the sweep."""
        starts = np.concatenate([np.zeros(1, np.int64), np.cumsum(count)])
        owner = np.repeat(np.arange(len(first)), count)
        rays = (first[owner] + np.arange(starts[-1]) - starts[owner]) % n_beams
        return cls(rays, owner, starts)


def windows_of_samples(samples: Samples, scanner: Scanner) -> tuple[NDArray[Any], ...]:
    """Make windows of samples of a dataset: slots (N, S, 4), context (N, 21), frames (N, 5)."""
    first, count = samples.first_ray.astype(np.int64), samples.n_rays.astype(np.int64)
    spans = Spans.between(first, count, scanner.n_beams)
    noise = np.stack([samples.range_std, samples.beam_half_width], axis=1)
    return _windows(
        spans, samples.ranges, scanner.bearings(), samples.sides, noise.astype(np.float64), scanner
    )


def windows_of_segments(
    ranges: NDArray[np.float64],
    bearings: NDArray[np.float64],
    segments: Segments,
    *,
    scanner: Scanner,
    noise: tuple[float, float],
) -> tuple[NDArray[Any], ...]:
    """Make windows of the segments of one scan; `noise`: deviation of a range, half beam width."""
    first = segments.rays[segments.starts[:-1]].astype(np.int64)
    last = segments.rays[segments.starts[1:] - 1].astype(np.int64)
    spans = Spans.between(first, (last - first) % len(bearings) + 1, len(bearings))
    own = segments.labels[spans.rays] == spans.owner + 1
    shown = np.where(own, ranges[spans.rays], np.nan)
    return _windows(
        spans, shown, bearings, segments.sides, np.tile(noise, (len(segments), 1)), scanner
    )


def windows_of_rows(
    ranges: NDArray[np.float32],
    bearings: NDArray[np.float64],
    *,
    scanner: Scanner,
    noise: tuple[float, float],
) -> tuple[NDArray[Any], ...]:
    """Make windows of scans (B, n_beams) that show one object each, with at least one hit."""
    hits = np.isfinite(ranges)
    n_beams = len(bearings)
    first, last = hits.argmax(axis=1), n_beams - 1 - hits[:, ::-1].argmax(axis=1)
    if _is_closed(bearings):
        first, last = _across_the_seam(hits, first, last)
    spans = Spans.between(first, (last - first) % n_beams + 1, n_beams)
    sides = _sides(ranges, bearings, np.stack([first, last], axis=1), scanner)
    shown = ranges[spans.owner, spans.rays]
    return _windows(spans, shown, bearings, sides, np.tile(noise, (len(ranges), 1)), scanner)


def normalised(scans: NDArray[np.float32], low: float, high: float) -> NDArray[np.float32]:
    """Convert scans (B, n_beams) to input of the paper's network, (B, 1, n_beams), sec. IV-A."""
    shown = np.full_like(scans, MISSING)
    np.divide(scans - np.float32(low), np.float32(high - low), out=shown, where=np.isfinite(scans))
    return shown[:, None, :]


def _windows(
    spans: Spans,
    ranges: NDArray[np.floating[Any]],
    bearings: NDArray[np.float64],
    sides: NDArray[np.uint8],
    noise: NDArray[np.float64],
    scanner: Scanner,
) -> tuple[NDArray[Any], ...]:
    step = float(np.median(_turn(np.diff(bearings)))) if len(bearings) > 1 else 0.0
    ends = np.stack([spans.rays[spans.starts[:-1]], spans.rays[spans.starts[1:] - 1]], axis=1)
    beside = (ends + _OUTWARD) % len(bearings)
    gaps = _turn(bearings[beside] - bearings[ends]) * _OUTWARD
    gaps = np.where(sides == Side.FIELD_EDGE, step, gaps)
    return _core.circle_windows(
        bearings[spans.rays],
        np.asarray(ranges, dtype=np.float64),
        spans.starts,
        np.ascontiguousarray(sides),
        gaps=np.ascontiguousarray(gaps, dtype=np.float64),
        noise=np.ascontiguousarray(noise, dtype=np.float64),
        range_limits=(scanner.range_min, scanner.range_max),
    )


def _turn(angles: NDArray[np.float64]) -> NDArray[np.float64]:
    """Wrap angles to -pi to pi [rad]."""
    return angles - np.round(angles / (2 * np.pi)) * (2 * np.pi)


def _is_closed(bearings: NDArray[np.float64]) -> bool:
    """Return whether the first ray is the neighbour of the last."""
    steps = np.abs(_turn(np.diff(bearings)))
    turned = float(steps.sum())
    return len(bearings) > 2 and 2 * np.pi - turned <= 1.5 * turned / len(steps)


def _across_the_seam(
    hits: NDArray[np.bool_], first: NDArray[np.int64], last: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Correct first and last hit of objects that lie across the seam of a full circle.

    Such an object then begins after the longest gap between its hits.
    """
    for row in np.flatnonzero(hits[:, 0] & hits[:, -1] & ~hits.all(axis=1)):
        places = np.flatnonzero(hits[row])
        widest = int(np.argmax(np.diff(places)))
        first[row], last[row] = places[widest + 1], places[widest]
    return first, last


def _sides(
    ranges: NDArray[np.float32],
    bearings: NDArray[np.float64],
    ends: NDArray[np.int64],
    scanner: Scanner,
) -> NDArray[np.uint8]:
    """Kind of the neighbour (`Side`) before and after the hits of scans with one object each."""
    rows = np.arange(len(ranges))[:, None]
    beside = (ends + _OUTWARD) % len(bearings)
    near, far = _core.CIRCLE_CUT_MARGINS
    end_ranges = ranges[rows, ends]
    is_cut = (end_ranges < scanner.range_min + near) | (end_ranges > scanner.range_max - far)
    sides = np.where(is_cut, Side.RANGE_CUT, Side.FREE)
    sides = np.where(np.isnan(ranges[rows, beside]), Side.OCCLUDED, sides)
    if not _is_closed(bearings):
        sides = np.where(ends == [0, len(bearings) - 1], Side.FIELD_EDGE, sides)
    return sides.astype(np.uint8)
