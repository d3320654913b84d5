"""The voxel map as a dictionary: eqs 6-12 and 20-22, one voxel at a time.

Rays are walked and lengths summed in whole numbers, as the map does (docs/adr/0002).
"""

import math
from collections import Counter
from fractions import Fraction

import numpy as np

from lidar_core import VoxelMapConfig
from reference.traverse import Voxel

UNITS_PER_EDGE = 16_384
FURTHEST = 2**31 - 2  # sub-units
MOST_MERGED = 64
MOST_UNITS = 2**30 - 1
BACKGROUND, FLYING, UNKNOWN = 1, 2, 3
STRONGEST_FIRST = (BACKGROUND, FLYING, UNKNOWN)


def walk(start, end) -> list[tuple[Voxel, int]]:
    """Voxels of a segment given in units of voxels, in order, and the units of length in each."""
    span = [b - a for a, b in zip(start, end, strict=True)]
    length = math.sqrt(span[0] * span[0] + span[1] * span[1] + span[2] * span[2]) * UNITS_PER_EDGE
    shift = math.frexp(min(FURTHEST / length, 2.0**31))[1] - 1 if length else 31
    ahead = math.ceil(length * 2**shift)
    voxel, last = [[math.floor(value) for value in point] for point in (start, end)]
    walls = []
    for axis in range(3):
        n = abs(last[axis] - voxel[axis])
        if n == 0:
            continue
        gap = abs(voxel[axis] + (last[axis] > voxel[axis]) - start[axis])
        rate = min(length * 2**shift / abs(span[axis]), np.finfo(np.float64).max)
        pace = min(round(rate), ahead // (n - 1) if n > 1 else ahead + 1)  # half to even
        wall = max(min(round(gap * rate), ahead - (n - 1) * pace), ahead + 1 - n * pace)
        walls += [(wall + k * pace, axis) for k in range(n)]
    visits, entered = [], 0
    for wall, axis in sorted(walls):  # of walls at one place the lowest axis first
        visits.append((tuple(voxel), (wall >> shift) - entered))
        entered = wall >> shift
        voxel[axis] += 1 if last[axis] > voxel[axis] else -1
    return [*visits, (tuple(voxel), (ahead >> shift) - entered)]


class VoxelMap:
    """Values of G for the voxels that have been observed."""

    def __init__(self, config: VoxelMapConfig) -> None:
        self.config = config
        self.initial = np.float32(config.initial)
        self.values: dict[Voxel, np.float32] = {}

    def voxel_at(self, point) -> Voxel:
        size = Fraction(self.config.voxel_size)
        return tuple(math.floor(Fraction(float(value)) / size) for value in point)

    def admits(self, voxel: Voxel) -> bool:
        if self.config.bounds is None:
            return True
        low, high = map(self.voxel_at, self.config.bounds)
        return all(a <= index <= b for a, index, b in zip(low, voxel, high, strict=True))

    def value(self, voxel: Voxel) -> np.float32:
        return self.values.get(voxel, self.initial)

    def values_at(self, points) -> np.ndarray:
        return np.array([self.value(self.voxel_at(point)) for point in points], np.float32)

    def state(self, value: np.float32) -> int:
        c = self.config
        bounds = (c.threshold_uncertain, c.threshold_tentative, c.threshold_confident)
        return sum(value >= np.float32(bound) for bound in (*bounds, *c.extra_thresholds))

    def is_free(self, voxel: Voxel) -> bool:
        return self.value(voxel) < np.float32(self.config.threshold_uncertain)

    def is_tentative(self, voxel: Voxel) -> bool:
        return self.value(voxel) >= np.float32(self.config.threshold_tentative)

    def is_confident(self, voxel: Voxel) -> bool:
        return self.value(voxel) >= np.float32(self.config.threshold_confident)

    def occupied(self) -> list[Voxel]:
        least = np.float32(self.config.threshold_tentative)
        return sorted(voxel for voxel, value in self.values.items() if value >= least)

    def set_all(self, points, value: float) -> None:
        for voxel in map(self.voxel_at, points):
            if self.admits(voxel):
                self.values[voxel] = np.float32(value)

    def pull(self, voxel: Voxel, target: float, weight: float) -> None:
        """Eq. 12; a permanent voxel stays (sec. III-E)."""
        old = self.value(voxel)
        if math.isinf(old):
            return
        keep = 0.0 if weight > 1000 else 2.0**-weight
        self.values[voxel] = np.float32(keep * float(old) + (1 - keep) * float(np.float32(target)))

    def settle(self, voxel: Voxel) -> None:
        """A value that rays have pulled to within 64 steps from g_free becomes g_free."""
        free = np.float32(self.config.g_free)
        near = abs(float(self.value(voxel)) - float(free)) <= 64 * float(np.spacing(abs(free)))
        if self.config.saturation == "settled" and near:
            self.values[voxel] = free

    def ray_end(self, origin, point):
        """Eq. 20 with the margin before a hit."""
        span = point - origin
        distance = math.sqrt(float(span @ span))
        reach = min(max(distance - self.config.end_margin, 0.0), self.config.max_range)
        return point if reach >= distance else origin + (reach / distance) * span

    def integrate(self, points, classes, origins, directions=None, no_return=None) -> None:
        """One scan: eqs 9, 12 and 16-22."""
        origins = np.broadcast_to(np.asarray(origins, np.float64), (len(points), 3))
        contents: dict[Voxel, list[int]] = {}
        rays: list[tuple] = []
        for row, point in enumerate(np.asarray(points, np.float64)):
            if no_return is not None and no_return[row]:
                direction = np.asarray(directions[row], np.float64)
                norm = math.sqrt(float(direction @ direction))
                if math.isfinite(norm) and norm > 0:
                    end = origins[row] + (self.config.max_range / norm) * direction
                    rays.append((origins[row], end))
            elif classes[row] and np.isfinite(point).all():
                contents.setdefault(self.voxel_at(point), []).append(int(classes[row]))
                rays.append((origins[row], self.ray_end(origins[row], point)))
        units: Counter[Voxel] = Counter()
        for start, end, count in self._cast(rays):
            self._add_ray(units, start, end, count)
        self._update(contents, units)

    def _cast(self, rays: list[tuple]) -> list[list]:
        """Start, end and weight of the rays that are cast."""
        if self.config.rays == "all":
            return [[start, end, 1] for start, end in rays]
        cast: list[list] = []
        last: dict[Voxel, list] = {}
        for start, end in rays:
            voxel = tuple(np.floor(np.asarray(end) / self.config.voxel_size).astype(int))
            if voxel in last and last[voxel][2] < MOST_MERGED:
                last[voxel][2] += 1
            else:
                last[voxel] = [start, end, 1]
                cast.append(last[voxel])
        return cast

    def _add_ray(self, units: Counter[Voxel], start, end, count: int) -> None:
        size = self.config.voxel_size
        for voxel, length in walk(*[[float(x) / size for x in point] for point in (start, end)]):
            if length:
                units[voxel] = min(units[voxel] + count * length, MOST_UNITS)

    def _update(self, contents: dict[Voxel, list[int]], units: Counter[Voxel]) -> None:
        c = self.config
        unit = {"edges": 1.0, "metres": c.voxel_size, "diagonals": 1 / math.sqrt(3)}[c.ray_unit]
        target = {BACKGROUND: c.g_occ, FLYING: c.g_unk, UNKNOWN: c.g_unk}
        for voxel in filter(self.admits, contents.keys() | units.keys()):
            found = contents.get(voxel)
            if found is None:
                self.pull(voxel, c.g_free, units[voxel] / UNITS_PER_EDGE * unit * c.ray_gain)
                self.settle(voxel)
                continue
            strongest = next(kind for kind in STRONGEST_FIRST if kind in found)
            weight = math.inf if strongest == FLYING else found.count(strongest)
            self.pull(voxel, target[strongest], weight)
