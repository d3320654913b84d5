"""Points of what moves on the ground, in plain Python: sets of voxels, one voxel at a time.

Written from the text of `rust/lidar_core/src/flying/moving/`: `arrivals.rs`, `past_hits.rs`,
`stay.rs`, `entered.rs`, `free_space.rs`, `ground_movers.rs`. Not here: what things of unknown
class hide, flat ground, and objects in the air.
"""

import itertools
from collections import Counter

import numpy as np

REMEMBERED, STANDS, HIDDEN = 10.0, 10.0, 2.0  # [s]
LATER = 0.4
NEXT = 1.0  # [s]
FASTEST, SIZE = 15.0, 1.0  # [m/s], [m]
FEWEST_POINTS, FEWEST_OPEN = 8, 2
ABOVE_GROUND = 0.75  # [m]
AROUND = [one for one in itertools.product((-1, 0, 1), repeat=3) if any(one)]


def beside(voxel):
    return [(voxel[0] + x, voxel[1] + y, voxel[2] + z) for x, y, z in AROUND]


def parts(voxels):
    """Sets of voxels that hang together, also by edges and corners."""
    left = set(voxels)
    while left:
        part, new = set(), {min(left)}
        while new:
            part |= new
            new = {one for voxel in new for one in beside(voxel)} & left - part
        left -= part
        yield part


class Movers:
    """One scan after another. Times are in seconds."""

    def __init__(self, config) -> None:
        self.c = config.voxel_map
        self.sure = self.c.g_free + (self.c.initial - self.c.g_free) * 2.0**-8
        # voxel: times of the first and the last return, and whether it came from beside
        self.entered = {}
        self.arrived = {}  # voxel: times of the first and the last return
        self.newer, self.older, self.since = set(), set(), None
        self.newest = None

    def find(self, points, time, value):
        """Which points (N, 3) are of movers. `value`: of a voxel, in the map before the scan."""

        def is_free(voxel):
            return value(voxel) < self.c.threshold_uncertain

        def is_certain(voxel):
            return value(voxel) <= self.sure

        def is_standing(voxel):
            return voxel in self.newer or voxel in self.older

        self.forget(time)
        known = np.isfinite(points).all(axis=1)
        rows = {}
        for row in np.flatnonzero(known):
            voxel = tuple(np.floor(points[row].astype(float) / self.c.voxel_size).astype(int))
            rows.setdefault(voxel, []).append(row)
        come = {v for v in rows if is_free(v) or v in self.entered or v in self.arrived}
        self.newer |= set(rows) - come
        here = come & set(self.entered)
        left = [
            v
            for v, stay in self.entered.items()
            if stay[1] == self.newest and v not in come and not here & set(beside(v))
        ]
        for voxel in come:
            if voxel in self.entered:
                _, last, moves = self.entered[voxel]
                if not moves and is_certain(voxel) and last < self.newest:
                    del self.entered[voxel]
                    self.newer.add(voxel)
            elif voxel in self.arrived:
                first, last = self.arrived.pop(voxel)
                if is_certain(voxel) and last < self.newest:
                    self.newer.add(voxel)
                else:
                    self.arrived[voxel] = first, time
            elif is_certain(voxel) and not is_standing(voxel):
                self.arrived[voxel] = time, time
            elif is_certain(voxel):
                self.newer.add(voxel)
        since = 0.0 if self.newest is None else time - self.newest
        self.newest = time

        def is_entered(voxel):
            return voxel in self.entered and not is_standing(voxel)

        def has_come(voxel):
            came = self.arrived.get(voxel)
            return is_entered(voxel) or (came is not None and time - came[0] <= NEXT)

        def is_open(voxel, also):
            is_empty = not is_standing(voxel) and (is_certain(voxel) or also(voxel))
            return is_empty and all(also(one) or is_free(one) for one in beside(voxel))

        candidates = {voxel for voxel in come if is_open(voxel, has_come)}
        core = set()
        for part in parts(candidates):
            firsts = [self.arrived[voxel][0] for voxel in part if voxel in self.arrived]
            later = sum(first > min(firsts) for first in firsts)
            moves = later > 0 and later >= LATER * len(firsts)
            if moves or any(map(is_entered, part)):
                core |= part
            else:
                core |= {voxel for voxel in part if is_open(voxel, is_entered)}
        large = [part for part in parts(core) if len(part) >= FEWEST_OPEN]
        chosen = {one for part in large for v in part for one in [v, *beside(v)]} & come
        is_mover = np.zeros(len(points), bool)
        found = [part for part in parts(chosen) if sum(len(rows[v]) for v in part) >= FEWEST_POINTS]
        before = set(self.entered)
        for part in found:
            assert any(self.stands_on(voxel, before, value) for voxel in part), "may be in the air"
        origins = [self.comes_from(part, left, time, since) for part in found]
        for part in found:
            for voxel in part:
                is_mover[rows[voxel]] = True
                self.arrived.pop(voxel, None)
                first, _, moves = self.entered.get(voxel, (time, time, False))
                self.entered[voxel] = first, time, moves
        for part, origin in zip(found, origins, strict=True):
            own = {one for v in part for one in [v, *beside(v)]} if origin is not None else set()
            for voxel in own.union(origin or ()) & set(self.entered):
                self.entered[voxel] = *self.entered[voxel][:2], True
        return is_mover

    def comes_from(self, part, left, time, since):
        """Voxels that a part has left, if it came from beside. `since`: of the last scan."""
        first = {v: self.entered.get(v, self.arrived.get(v, (time,)))[0] for v in part}
        early = {voxel[:2] for voxel in part if first[voxel] == min(first.values())}
        if min(first.values()) < time:
            later = sum(voxel[:2] not in early for voxel in part)
            return [] if later > 0 and later >= LATER * len(part) else None
        reach = (FASTEST * since + SIZE) / self.c.voxel_size
        spans = [(min(v[axis] for v in part), max(v[axis] for v in part)) for axis in (0, 1)]
        near = [
            v
            for v in left
            if all(low - reach <= v[axis] <= high + reach for axis, (low, high) in enumerate(spans))
        ]
        return near or None

    def forget(self, time):
        if self.since is None:
            self.since = time
        if time - self.since > REMEMBERED:
            is_late = time - self.since > 2 * REMEMBERED
            self.newer, self.older = set(), set() if is_late else self.newer
            self.since = time

        def is_kept(stay):
            return time - stay[1] <= HIDDEN and time - stay[0] <= STANDS

        gone = {voxel: stay for voxel, stay in self.arrived.items() if not is_kept(stay)}
        self.newer |= {voxel for voxel, (first, last) in gone.items() if last > first}
        self.arrived = {v: stay for v, stay in self.arrived.items() if v not in gone}
        over = {voxel for voxel, stay in self.entered.items() if not is_kept(stay)}
        self.newer |= {voxel for voxel in over if not self.entered[voxel][2]}
        self.entered = {v: stay for v, stay in self.entered.items() if v not in over}

    def stands_on(self, voxel, before, value):
        """Something occupied is close below that is not of the mover itself."""
        steps = int(np.ceil(ABOVE_GROUND / self.c.voxel_size))
        below = itertools.product((-1, 0, 1), (-1, 0, 1), range(1, steps + 1))
        places = [(voxel[0] + x, voxel[1] + y, voxel[2] - down) for x, y, down in below]
        return any(value(v) >= self.c.threshold_tentative and v not in before for v in places)


def values_of(voxel_map, size):
    """Function that gives the value of a voxel of a map, looked up once."""
    known = {}

    def value(voxel):
        if voxel not in known:
            near = [voxel, *beside(voxel)]
            centers = (np.array(near, np.float32) + 0.5) * size
            known.update(zip(near, voxel_map.values_at(centers).tolist(), strict=True))
        return known[voxel]

    return value


def counted(is_mover, is_moving):
    """Numbers of points that both name, only the first, only the second."""
    pairs = Counter(zip(is_mover.tolist(), is_moving.tolist(), strict=True))
    return pairs[True, True], pairs[True, False], pairs[False, True]
