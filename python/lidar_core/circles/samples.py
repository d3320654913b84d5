"""Samples of single circles, each seen by one scan of which only the window is kept."""

from dataclasses import dataclass, fields
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from lidar_core import _core
from lidar_core.circles.dataset_config import DatasetConfig
from lidar_core.circles.scanner import Scanner

SIDES = ("free", "occluded", "field_edge", "range_cut")
"""What the numbers in `Samples.sides` say of what lies beside a window."""
HITS = ((1, 1), (2, 2), (3, 3), (4, 4), (5, 6), (7, 9), (10, 14), (15, 19), (20, 39), (40, None))
"""Numbers of hits, from and to, by which errors are told apart."""


@dataclass(frozen=True, slots=True)
class Samples:
    """Circles, and the part of a scan that each of them fills.

    Attributes
    ----------
    circles : ndarray, shape (N, 3), float32
        Centre x, centre y, radius [m], in the frame of the scanner.
    range_std : ndarray, shape (N,), float32
        Standard deviation of the ranges [m].
    beam_half_width : ndarray, shape (N,), float32
        Half the width of the rays [rad].
    first_ray, n_rays : ndarray, shape (N,), uint32
        Rays of the window, from the first that hit the circle to the last; the window may continue
        from the end of the sweep at ray 0.
    sides : ndarray, shape (N, 2), uint8
        Kind of the neighbours before and after the window: indices into `SIDES`.
    ranges : ndarray, shape (R,), float32
        Ranges of all windows, one after the other [m]; +inf is a miss.
    """

    circles: NDArray[np.float32]
    range_std: NDArray[np.float32]
    beam_half_width: NDArray[np.float32]
    first_ray: NDArray[np.uint32]
    n_rays: NDArray[np.uint32]
    sides: NDArray[np.uint8]
    ranges: NDArray[np.float32]

    def __len__(self) -> int:
        return len(self.circles)

    @property
    def starts(self) -> NDArray[np.int64]:
        """Start of each window in `ranges`, and end of the last window; shape (N + 1,)."""
        ends = np.cumsum(self.n_rays, dtype=np.int64)
        return np.concatenate([np.zeros(1, np.int64), ends])

    @property
    def n_hits(self) -> NDArray[np.int64]:
        """Number of rays with a return, per sample."""
        hits = np.concatenate([[0], np.cumsum(np.isfinite(self.ranges), dtype=np.int64)])
        counts: NDArray[np.int64] = np.diff(hits[self.starts])
        return counts

    def is_whole(self, scanner: Scanner) -> NDArray[np.bool_]:
        """True for circles whose near side is complete: nothing hides it, no limit cuts it."""
        x, y, radius = self.circles.astype(np.float64).T
        distance = np.hypot(x, y)
        half = np.arcsin(np.minimum(radius / distance, 1.0))
        middle = scanner.angle_min + 0.5 * scanner.angle_increment * (scanner.n_beams - 1)
        off = np.abs((np.arctan2(y, x) - middle + np.pi) % (2 * np.pi) - np.pi)
        is_round = scanner.field_of_view > 2 * np.pi - 0.1
        edge = np.inf if is_round else scanner.field_of_view / 2
        tangent = np.sqrt(np.maximum(distance**2 - radius**2, 0.0))
        in_range = (tangent <= scanner.range_max) & (distance - radius >= scanner.range_min)
        is_free = (self.sides != SIDES.index("occluded")).all(axis=1)
        return np.asarray(in_range & is_free & (off + half <= edge))

    def take(
        self, numbers: NDArray[np.integer[Any]], *, starts: NDArray[np.int64] | None = None
    ) -> Self:
        """Return the samples with these indices, in this order; faster if `starts` is given."""
        starts = self.starts if starts is None else starts
        counts = self.n_rays[numbers].astype(np.int64)
        within = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        ranges = values.pop("ranges")[np.repeat(starts[numbers], counts) + within]
        return type(self)(**{name: value[numbers] for name, value in values.items()}, ranges=ranges)

    def scans(self, scanner: Scanner) -> NDArray[np.float32]:
        """Return whole scans (N, n_beams), +inf outside the window, NaN beside hidden sides."""
        rows = np.repeat(np.arange(len(self)), self.n_rays)
        within = np.arange(len(rows)) - np.repeat(self.starts[:-1], self.n_rays)
        first = self.first_ray.astype(np.int64)
        scans = np.full((len(self), scanner.n_beams), np.inf, np.float32)
        scans[rows, (first[rows] + within) % scanner.n_beams] = self.ranges
        beside = np.stack([first - 1, first + self.n_rays], axis=1) % scanner.n_beams
        sample, side = np.nonzero(self.sides == SIDES.index("occluded"))
        scans[sample, beside[sample, side]] = np.nan
        return scans


def joined(parts: list[Samples]) -> Samples:
    """Join several collections of samples, one after the other."""
    return Samples(
        *(
            np.concatenate([getattr(part, field.name) for part in parts])
            for field in fields(Samples)
        )
    )


def make_samples(
    config: DatasetConfig,
    *,
    count: int,
    seed: int,
    start: int = 0,
    circles: NDArray[np.float64] | None = None,
    threads: int = 1,
) -> Samples:
    """Make samples `start` to `start + count` of a seed; they depend on nothing else.

    Parameters
    ----------
    config : DatasetConfig
        Disturbances of the view; for continuous datasets also the circles.
    count, start : int
        Number of samples, and index of the first one.
    seed : int
        Decides circles and noise.
    circles : ndarray, shape (N, 3), float64, optional
        Look at these, `config.draws` times each, instead of drawing circles.
    threads : int
        Number of threads; the result does not depend on it.

    Returns
    -------
    samples : Samples

    Raises
    ------
    InputError
        The scanner does not see one of `circles`, or is inside of it.
    LimitError
        The circles that are drawn are never visible.

    Examples
    --------
    >>> samples = make_samples(DatasetConfig.continuous(circles=5), count=5, seed=1)
    >>> len(samples), samples.scans(Scanner()).shape
    (5, (5, 1081))
    """
    arrays = _core.make_circle_samples(
        config,
        circles=circles,
        draws=config.draws,
        seed=seed,
        start=start,
        count=count,
        threads=threads,
    )
    return Samples(*arrays)
