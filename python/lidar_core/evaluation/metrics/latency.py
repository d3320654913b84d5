"""Processing time of scans."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Self

from numpy.typing import ArrayLike

from lidar_core.evaluation.spread import Spread

if TYPE_CHECKING:
    from lidar_core.flying import FlyingFrame


@dataclass(frozen=True, slots=True)
class Latency:
    """Time per scan.

    Attributes
    ----------
    total : Spread
        Whole scan [ms].
    stages : dict of Spread
        Times of each stage [ms].
    """

    total: Spread
    stages: dict[str, Spread]

    @classmethod
    def of(cls, total: ArrayLike, stages: Mapping[str, ArrayLike]) -> Self | None:
        """Compute statistics of times [ms], one per scan; None without scans.

        Raises
        ------
        InputError
            A time is not finite.
        """
        whole = Spread.of(total)
        if whole is None:
            return None
        spreads = ((name, Spread.of(times)) for name, times in stages.items())
        return cls(whole, {name: spread for name, spread in spreads if spread is not None})

    @classmethod
    def of_frames(cls, frames: "Iterable[FlyingFrame]") -> Self | None:
        """Compute statistics of `timing_ms`; the total of a scan is the sum of its stages."""
        timings = [frame.timing_ms for frame in frames]
        names = list(timings[0]) if timings else []
        return cls.of(
            [sum(timing.values()) for timing in timings],
            {name: [timing[name] for timing in timings] for name in names},
        )
