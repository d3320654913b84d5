"""Voxels of a segment in exact rational arithmetic."""

import math
from collections.abc import Sequence
from fractions import Fraction
from itertools import pairwise

Voxel = tuple[int, int, int]
Point = tuple[Fraction, Fraction, Fraction]


class Segment:
    """A segment and a lattice, both exact: every float is taken at its binary value."""

    def __init__(
        self,
        start: Sequence[float],
        end: Sequence[float],
        voxel_size: float,
        origin: Sequence[float] = (0.0, 0.0, 0.0),
    ) -> None:
        self.size = Fraction(voxel_size)
        self.start = [
            (Fraction(value) - Fraction(zero)) / self.size
            for value, zero in zip(start, origin, strict=True)
        ]
        end_scaled = [
            (Fraction(value) - Fraction(zero)) / self.size
            for value, zero in zip(end, origin, strict=True)
        ]
        self.span = [b - a for a, b in zip(self.start, end_scaled, strict=True)]
        self.length = self._length()

    def _length(self) -> float:
        """Length [m]; the square is exact, so the root has one rounding."""
        square = sum(value * value for value in self.span) * self.size**2
        scale = 2**200
        return float(Fraction(math.isqrt(int(square * scale**2)), scale))

    def crossings(self) -> list[Fraction]:
        """Sorted parameters 0 <= t <= 1 at which the segment meets a wall, with both ends."""
        found = {Fraction(0), Fraction(1)}
        for start, span in zip(self.start, self.span, strict=True):
            if span:
                low, high = sorted((start, start + span))
                walls = range(math.ceil(low), math.floor(high) + 1)
                found.update((wall - start) / span for wall in walls)
        return sorted(found)

    def lengths(self) -> dict[Voxel, float]:
        """Length [m] inside every voxel of which the segment crosses more than a point."""
        found: dict[Voxel, float] = {}
        ts = self.crossings()
        for t_enter, t_exit in pairwise(ts):
            middle = (t_enter + t_exit) / 2
            voxel = tuple(
                math.floor(start + middle * span)
                for start, span in zip(self.start, self.span, strict=True)
            )
            found[voxel] = found.get(voxel, 0.0) + float(t_exit - t_enter) * self.length
        return found

    def is_near(self, voxel: Voxel, tolerance: float) -> bool:
        """Whether the segment meets the voxel grown by `tolerance` [m] on every side."""
        margin = Fraction(tolerance) / self.size
        t_enter, t_exit = Fraction(0), Fraction(1)
        for index, start, span in zip(voxel, self.start, self.span, strict=True):
            low, high = index - margin - start, index + 1 + margin - start
            if span == 0:
                if not low <= 0 <= high:
                    return False
                continue
            first, last = sorted((low / span, high / span))
            t_enter, t_exit = max(t_enter, first), min(t_exit, last)
        return t_enter <= t_exit
