"""Slow oracle of the sky that is found in returns: cells of direction, evidence, free reach.

Written from the decision in `docs/adr/0008-sky.md`, with plain arrays over all cells.
"""

from dataclasses import dataclass, field

import numpy as np

from reference import haze

EDGE, PARTS = 45, 3
CELLS = 6 * EDGE * EDGE
STEP = np.pi / 2 / EDGE
BANDS, SECTORS = 90, 36
NEIGHBOUR_ANGLE = np.deg2rad(2.4)
F32 = np.float32


def part_of(cell, u, v):
    """Unit direction of a place in a cell, given as shares of its edges."""
    face, inside = np.divmod(np.asarray(cell), EDGE * EDGE)
    row, column = np.divmod(inside, EDGE)
    axis, is_back = np.divmod(face, 2)
    index = np.arange(len(axis))
    way = np.zeros((len(axis), 3))
    way[index, axis] = 1.0 - 2.0 * is_back
    way[index, (axis + 1) % 3] = np.tan((row + u) * STEP - np.pi / 4)
    way[index, (axis + 2) % 3] = np.tan((column + v) * STEP - np.pi / 4)
    return way / np.linalg.norm(way, axis=1, keepdims=True)


def cell_of(ways):
    """Cell of each direction: the face of its largest part, then equal angles."""
    axis = np.argmax(np.abs(ways), axis=1)
    index = np.arange(len(ways))
    depth = ways[index, axis]
    u, v = (ways[index, (axis + turn) % 3] / np.abs(depth) for turn in (1, 2))
    place = [np.clip((np.arctan(w) + np.pi / 4) / STEP, 0, EDGE - 1).astype(int) for w in (u, v)]
    return ((2 * axis + (depth < 0)) * EDGE + place[0]) * EDGE + place[1]


def _grid():
    cells = np.arange(CELLS)
    centers = part_of(cells, 0.5, 0.5)
    helper = np.where(np.abs(centers[:, 2:]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])
    side = np.cross(centers, helper)
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    up = np.cross(centers, side)
    beside = [cells]
    for turn in np.arange(24) / 24 * 2 * np.pi:
        offset = np.cos(turn) * side + np.sin(turn) * up
        beside.append(cell_of(centers + np.tan(NEIGHBOUR_ANGLE) * offset))
    return centers, [np.unique(row) for row in np.stack(beside, axis=1)]


CENTERS, BESIDE = _grid()
AZIMUTHS = np.arctan2(CENTERS[:, 1], CENTERS[:, 0])


def band_of(heights):
    """Band of elevation of unit directions, given their heights; on a border the upper one."""
    bands = (np.arcsin(heights) + np.pi / 2) / np.pi * BANDS + 1e-9
    return np.clip(bands, 0, BANDS - 1).astype(int)


BAND = band_of(CENTERS[:, 2])
SECTOR = ((AZIMUTHS / (2 * np.pi) + 0.5) * SECTORS + 1e-9).astype(int) % SECTORS
COLUMNS = 180
COLUMN = ((AZIMUTHS / (2 * np.pi) + 0.5) * COLUMNS + 1e-9).astype(int) % COLUMNS
WIDEST = max(map(len, BESIDE))
PADDED = np.array([np.pad(row, (0, WIDEST - len(row)), mode="edge") for row in BESIDE])
"""Neighbours of every cell, itself included; the last one repeated."""
NO_SURFACE = -(2**62)


def _solid_angles():
    inside = np.arange(CELLS) % (EDGE * EDGE)
    u, v = (np.tan((place + 0.5) * STEP - np.pi / 4) ** 2 for place in np.divmod(inside, EDGE))
    return STEP**2 * (1 + u) * (1 + v) / (1 + u + v) ** 1.5


SOLID = _solid_angles()


def ranked(values, share):
    """The value that has a share of all below it; 0 without any."""
    values = np.sort(np.asarray(values, float))
    return values[min(int(share * len(values)), len(values) - 1)] if len(values) else 0.0


def density_of(counts, scans):
    """Rays per steradian and scan in every cell of the sensor's frame, learnt from its returns."""
    solid, returns = np.zeros((2, BANDS, SECTORS))
    np.add.at(solid, (BAND, SECTOR), SOLID)
    np.add.at(returns, (BAND, SECTOR), counts)
    if (returns > 0).any(axis=0).sum() >= 21:  # it turns
        by_band = np.zeros(BANDS)
        for band in range(BANDS):
            seen = solid[band] > 0
            found = np.sort(returns[band][seen] / solid[band][seen] / scans)[::-1]
            by_band[band] = found[min(3, len(found) - 1)] if len(found) else 0.0
        return lambda ways: by_band[band_of(np.clip(ways[:, 2], -1, 1))]
    own = counts / SOLID / scans
    twins = [cell_of(CENTERS * [1, y, z]) for y in (1, -1) for z in (1, -1)]
    cells = np.max([own[twin] for twin in twins], axis=0)
    seen = np.sort(cells[cells > 0])
    typical = seen[int(0.25 * len(seen))] if len(seen) else 0.0
    widths = np.full(BANDS, -1.0)
    np.maximum.at(widths, BAND[cells > 0], np.abs(AZIMUTHS[cells > 0]))
    cells[(cells == 0) & (np.abs(AZIMUTHS) < widths[BAND])] = typical
    return lambda ways: cells[cell_of(ways)]


def floor_of(heights, ranges):
    """Height of flat ground: many returns at one height, from near and far; None if not seen."""
    depth = np.maximum(-heights / 0.1, 0.0)
    counts = np.bincount(depth[depth < 1000].astype(int), minlength=1010)[:1000]
    pairs = np.append(counts[:-1] + counts[1:], counts[-1])
    pairs = np.concatenate([pairs, np.zeros(3, int)])
    least = max(int(0.1 * len(heights)), 50)
    for layer in range(999, 4, -1):
        if pairs[layer] >= max(least, 3 * pairs[layer - 3], 3 * pairs[layer + 3]):
            low, high = -0.1 * (layer + 2.0), -0.1 * layer
            near, far = (ranked(ranges[(heights >= low) & (heights < high)], s) for s in (0.1, 0.9))
            return low + 0.1 if far >= 1.8 * near else None
    return None


@dataclass
class Seen:
    """What the sky rests on after one scan."""

    directions: np.ndarray
    reach: np.ndarray
    share: float
    is_sky: np.ndarray
    expected: np.ndarray
    is_empty: np.ndarray


@dataclass
class SkyOracle:
    """The sky of one sensor over its scans; `voxel_size` and `max_range` are those of the map."""

    voxel_size: float
    max_range: float
    has_rows: bool = False
    alone: np.ndarray = field(default_factory=lambda: np.zeros(CELLS, bool))
    evidence: np.ndarray = field(default_factory=lambda: np.zeros(CELLS, F32))
    surface: np.ndarray = field(default_factory=lambda: np.full(CELLS, np.inf, F32))
    surface_ns: np.ndarray = field(default_factory=lambda: np.full(CELLS, NO_SURFACE))
    since_ns: np.ndarray = field(default_factory=lambda: np.full(CELLS, -1))
    counts: np.ndarray = field(default_factory=lambda: np.zeros(CELLS, np.int64))
    drops: np.ndarray = field(default_factory=lambda: np.zeros(CELLS, np.int64))
    place: np.ndarray = field(default_factory=lambda: np.zeros(3))
    air: haze.Haze = field(default_factory=haze.Haze)
    lowest: float = 0.0
    usual: float = 0.0
    last_ns: int | None = None
    scans: int = 0
    learnt: int = 0
    density: object = None
    lowest_way: float = np.inf
    turns: bool = False

    def process(self, points, turn, origin, stamp_ns, state_at=None, *, air=None):
        """One scan: returns in the sensor's frame, attitude and place of the sensor.

        Rays are cast if `state_at` is given: the state of the map at points, before the scan; `air`
        is the same, and asked for droplets.
        """
        length = np.linalg.norm(points.astype(np.float64), axis=1)
        rows = np.flatnonzero(np.isfinite(length) & (length > 0.1))
        found, length = points[rows].astype(np.float64), length[rows]
        turned = found @ turn.T
        cells = cell_of(turned)
        is_drop = np.zeros(len(rows), bool)
        if air is not None:
            low = -np.inf if self.last_ns is None else self.lowest + 0.35
            is_drop = self.air.droplets(
                turned, cells, BESIDE, SECTOR, low, lambda ways: air(origin + ways) == 0, stamp_ns
            )
        drops = cell_of(found[is_drop])
        all_found = found
        rows, found, length = rows[~is_drop], found[~is_drop], length[~is_drop]
        turned, cells = turned[~is_drop], cells[~is_drop]
        hits = np.bincount(cells, minlength=CELLS)
        nearest = np.full(CELLS, np.inf, F32)
        np.minimum.at(nearest, cells, length.astype(F32))
        is_sample = rows % max(len(points) // 4096, 1) == 0
        is_sample[0] = True
        ranges, heights = length[is_sample], turned[is_sample, 2]
        before, has_returned = self.evidence, np.isfinite(self.surface)
        expected = self._expect(hits, turn, stamp_ns)
        lately = has_returned & (before < 1) & self.has_rows
        is_lost = _lost(lately, hits, cell_of(all_found), expected, turn)
        self.evidence[is_lost] = (before + F32(0.25))[is_lost]
        self._remember(hits, nearest, stamp_ns)
        limit = self._limits(stamp_ns)
        visible = min(0.8 * ranked(ranges, 0.98), self.max_range)
        low, returns = ranked(heights, 0.05), float(hits.sum())
        lowest = low if self.last_ns is None else self.lowest
        lowest = min(lowest + 0.1 * (low - lowest), low + 0.5)
        floor = floor_of(heights, ranges)
        usual = returns if self.last_ns is None else self.usual
        is_covered = returns < 0.5 * usual
        is_empty = self._empty(hits, expected)
        ground = lowest if floor is None else max(floor, lowest)
        moment = (np.asarray(origin), stamp_ns, state_at, turn)
        seen = Seen(np.empty((0, 3)), np.empty(0), 0.0, np.zeros(CELLS, bool), expected, is_empty)
        since = np.full(CELLS, -1)
        if not is_covered and self.density is not None:
            limit = _with_holes(limit, is_empty, expected)
            since = self._cast(seen, (hits, nearest), (limit, visible, ground, is_lost), moment)
        if np.linalg.norm(origin - self.place) > 0.5:
            self.place = origin
        self.lowest, self.since_ns, self.last_ns = lowest, since, stamp_ns
        self.usual = usual + (0.002 if is_covered else 0.1) * (returns - usual)
        self._learn(all_found, drops)
        return seen

    def _learn(self, found, drops):
        if self.scans < 64 or self.scans % 8 == 0:
            self.counts += np.bincount(cell_of(found), minlength=CELLS)
            self.drops += np.bincount(drops, minlength=CELLS)
            heights = found[:, 2] / np.linalg.norm(found, axis=1)
            self.lowest_way = min(self.lowest_way, heights.min(initial=np.inf))
            self.learnt += 1
            if self.learnt >= 3:
                self.density = density_of(self._rays_learnt(), self.learnt)
                sectors = np.zeros(SECTORS)
                np.add.at(sectors, SECTOR, self.counts)
                self.turns = (sectors > 0).sum() >= 21
        self.scans += 1

    def _rays_learnt(self):
        """Rays per cell: where surfaces return as well, it shows how many end on droplets."""
        if not self.drops.any():
            return self.counts
        surfaces = 2 * self.drops < self.counts
        share = max(self.drops[surfaces].sum() / max(self.counts[surfaces].sum(), 1), 0.02)
        return np.maximum(self.counts, (self.drops / share).astype(np.int64))

    def _expect(self, hits, turn, stamp_ns):
        age = 0.0 if self.last_ns is None else (stamp_ns - self.last_ns) * 1e-9
        ways = CENTERS @ turn
        rays = np.zeros(CELLS) if self.density is None else self.density(ways) * SOLID
        expected = rays.astype(F32)
        evidence = np.minimum(F32(np.exp(-age)) * self.evidence + expected, F32(50.0))
        self.evidence = np.where(hits > 0, F32(0), evidence)
        return expected

    def _remember(self, hits, nearest, stamp_ns):
        """Things larger than 2 m are surfaces; smaller ones may be targets."""
        taken, self.alone = hits == 0, np.zeros(CELLS, bool)
        for first in range(CELLS):
            if taken[first]:
                continue
            thing, taken[first] = [first], True
            for cell in thing:
                for other in BESIDE[cell]:
                    if not taken[other] and abs(nearest[other] - nearest[cell]) < F32(1.0):
                        taken[other] = True
                        thing.append(other)
            places = nearest[thing].astype(float)[:, None] * CENTERS[thing]
            is_surface = np.linalg.norm(np.ptp(places, axis=0)) > 2.0
            others = np.setdiff1d(np.flatnonzero(hits), thing)
            ways = nearest[others].astype(float)[:, None] * CENTERS[others]
            off = np.maximum(places.min(axis=0) - ways, ways - places.max(axis=0)).clip(0)
            is_beside = (np.linalg.norm(off, axis=1) < 1.5).any()
            self.alone[thing] = self.has_rows and not is_surface and not is_beside
            self.surface[thing] = nearest[thing]
            self.surface_ns[thing] = stamp_ns if is_surface else NO_SURFACE

    def _limits(self, stamp_ns):
        limit = np.where(stamp_ns - self.surface_ns <= 500_000_000, self.surface, F32(np.inf))
        for _ in range(3):
            limit = limit[PADDED].min(axis=1)
        return limit

    def _empty(self, hits, expected):
        sums = np.array([self.evidence[row].sum(dtype=np.float64) for row in BESIDE])
        is_looked_at = (expected[PADDED] > 0).any(axis=1)
        return (hits[PADDED] == 0).all(axis=1) & (sums >= 7.0) & is_looked_at

    def _cast(self, seen, returns, limits, moment):
        (hits, nearest), (limit, visible, ground, is_lost) = returns, limits
        origin, stamp_ns, state_at, turn = moment
        tilt = np.arcsin(np.clip(CENTERS[:, 2], -1, 1)) - np.deg2rad(1.4)
        fall = -np.sin(np.maximum(tilt, -np.pi / 2))
        above = np.full(CELLS, np.inf)
        above[fall > 0] = (-ground - 1.0) / fall[fall > 0]
        into_sky = np.minimum(np.minimum(visible, limit.astype(float) - 0.5), above)
        around = np.array([hits[row].sum() for row in BESIDE])
        # Between rows the space around a target is never seen: it limits its own cells alone.
        around_it = np.where(self.alone, F32(np.inf), nearest)[PADDED].min(axis=1)
        before = np.minimum(np.minimum(around_it, nearest).astype(float) - 0.5, above)
        before[(around < 7) | (around >= 400)] = 0.0
        is_sky = seen.is_empty & (into_sky >= 2.0) & ~is_lost
        reach = np.where(is_sky, into_sky, np.minimum(before, self.max_range))
        reach[is_lost] = 0.0
        is_same = np.linalg.norm(origin - self.place) <= 0.5
        is_same &= self.last_ns is None or stamp_ns - self.last_ns <= 1_000_000_000
        began = np.where(is_same & (self.since_ns >= 0), self.since_ns, stamp_ns)
        since = np.where(is_sky, began, np.where(is_lost & is_same, self.since_ns, -1))
        seen.is_sky, all_rays = is_sky, seen.expected.sum(dtype=float)
        seen.share = float(seen.expected[is_sky].sum(dtype=float) / all_rays) if all_rays else 0.0
        if state_at is not None:
            is_trusted = is_sky & (stamp_ns - since >= 2_000_000_000)
            self._rays(seen, reach, is_trusted, turn, lambda ways: state_at(origin + ways))
        return since

    def _rays(self, seen, reach, is_trusted, turn, state_of):
        """Rays through a third of the parts of every cell, another third in every scan.

        None of a sensor that turns goes below its lowest return.
        """
        parts = [
            divmod(part, PARTS)
            for part in range(PARTS * PARTS)
            if (sum(divmod(part, PARTS)) + self.scans) % PARTS == 0
        ]
        cells = np.repeat(np.flatnonzero(reach >= 2.0), len(parts))
        shares = (np.tile(parts, (len(cells) // len(parts), 1)) + 0.5) / PARTS
        ways = part_of(cells, shares[:, 0], shares[:, 1]).astype(F32)
        if self.turns:
            is_cast = (ways.astype(float) @ turn)[:, 2] >= self.lowest_way
            cells, ways = cells[is_cast], ways[is_cast]
        free = reach[cells]
        for ray in np.flatnonzero(~is_trusted[cells]):
            free[ray] = self._free(ways[ray].astype(float), free[ray], state_of)
        seen.directions, seen.reach = ways[free >= 2.0], free[free >= 2.0]

    def _free(self, way, reach, state_of):
        """Up to the first voxel that is at least tentatively occupied."""
        along = 0.5 * self.voxel_size * np.arange(1, int(2 * reach / self.voxel_size) + 1)
        met = np.flatnonzero(state_of(along[:, None] * way) >= 2)
        return along[met[0]] - self.voxel_size if len(met) else reach


def _lost(returned_lately, hits, returned, expected, turn):
    """Cells of three columns or more beside each other that gave six cells lately, and now none."""
    returns = np.bincount(COLUMN[returned], minlength=COLUMNS) > 0
    column = COLUMN[cell_of(CENTERS @ turn)]
    gave = np.bincount(column[(expected > 0) & returned_lately], minlength=COLUMNS)
    is_lost = np.zeros(COLUMNS, bool)
    for first in np.flatnonzero(returns):
        run = []
        while not returns[at := (first + 1 + len(run)) % COLUMNS]:
            run.append(at)
        is_lost[run] = np.count_nonzero(gave[run]) >= 3 and gave[run].sum() >= 6
    is_near = is_lost | np.roll(is_lost, 1) | np.roll(is_lost, -1)
    return is_near[column] & (hits == 0)


def _with_holes(limit, is_empty, expected):
    """Empty cells that surfaces enclose, within the field of view, are limited as these are."""
    limit, taken = limit.copy(), np.zeros(CELLS, bool)
    for first in np.flatnonzero(is_empty):
        if taken[first]:
            continue
        hole, edges, is_open, taken[first] = [first], [], False, True
        for cell in hole:
            for other in BESIDE[cell]:
                if is_empty[other]:
                    if not taken[other]:
                        taken[other] = True
                        hole.append(other)
                elif np.isfinite(limit[other]):
                    edges.append(limit[other])
                else:
                    is_open |= expected[other] == 0
        if not is_open and len(hole) < 400 and edges:
            limit[hole] = np.minimum(limit[hole], F32(ranked(edges, 0.5)))
    return limit
