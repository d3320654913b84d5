"""Classes of clusters: sec. III-B, Algorithm 1, and the gates and the shadow of best mode."""

import itertools
import math
from collections import deque

import numpy as np

from reference.voxel_map import BACKGROUND, FLYING, UNKNOWN, Voxel, VoxelMap

WAY_TOLERANCE = 1e-9  # [voxels]: 3 m are 12 steps of 0.25 m


def beside(voxel: Voxel) -> list[Voxel]:
    x, y, z = voxel
    return [
        (x - 1, y, z),
        (x + 1, y, z),
        (x, y - 1, z),
        (x, y + 1, z),
        (x, y, z - 1),
        (x, y, z + 1),
    ]


def finds_a_way_out(
    vmap: VoxelMap,
    start: Voxel,
    search_distance: float,
    *,
    open_border=True,
    is_wall=None,
    expand_start=False,
):
    """Algorithm 1, lines 9-33, for one start."""
    queue, met = deque([start]), {start}
    while queue:
        voxel = queue.popleft()
        if vmap.is_tentative(voxel):
            return True
        if vmap.is_free(voxel) and not (expand_start and voxel == start):
            continue
        if is_wall is not None and is_wall(voxel):
            continue
        steps = sum(abs(a - b) for a, b in zip(voxel, start, strict=True))
        if steps >= search_distance / vmap.config.voxel_size - WAY_TOLERANCE:
            return True
        for neighbour in beside(voxel):
            if not vmap.admits(neighbour):
                if open_border:
                    return True
            elif neighbour not in met:
                met.add(neighbour)
                queue.append(neighbour)
    return False


def is_floating(vmap: VoxelMap, points, search_distance: float, **options) -> bool:
    """Algorithm 1; no point is no flying object."""
    starts = {vmap.voxel_at(point) for point in points}
    return bool(starts) and not any(
        finds_a_way_out(vmap, start, search_distance, **options) for start in starts
    )


class Shadow:
    """Voxels behind a cluster: hidden from `origin` by one of its points.

    A voxel is hidden if its centre lies more than one edge further away than a point that the
    line of sight to the centre passes within half a diagonal.
    """

    def __init__(self, vmap: VoxelMap, points, origin) -> None:
        self.vmap = vmap
        self.points = np.asarray(points, np.float64) - origin
        self.origin = origin

    def __call__(self, voxel: Voxel) -> bool:
        size = self.vmap.config.voxel_size
        center = (np.array(voxel) + 0.5) * size - self.origin
        distance = float(np.sqrt(center @ center))
        if distance == 0.0:
            return False
        along = self.points @ (center / distance)
        aside = self.points - along[:, None] * (center / distance)
        near = np.einsum("ij,ij->i", aside, aside) <= (math.sqrt(3) / 2 * size) ** 2
        return bool((near & (along > 0) & (distance - along > size)).any())


def is_close(vmap: VoxelMap, points, close_distance: float) -> bool:
    """Rule A for one cluster: strictly closer to the centre of an occupied voxel."""
    centers = (np.array(vmap.occupied(), np.float64).reshape(-1, 3) + 0.5) * vmap.config.voxel_size
    difference = centers[:, None, :] - points[None, :, :]
    square = difference[..., 0] ** 2 + difference[..., 1] ** 2 + difference[..., 2] ** 2
    return bool((square < close_distance**2).any())


def diagonal(points) -> float:
    return math.sqrt(((points.max(axis=0) - points.min(axis=0)) ** 2).sum())


def groups(clusters, distance: float | None) -> list[set[int]]:
    """For every cluster those that are linked to it by gaps of at most `distance`."""
    linked = [{index} for index in range(len(clusters))]
    if distance is None:
        return linked
    for a, b in itertools.combinations(range(len(clusters)), 2):
        difference = clusters[a][:, None, :] - clusters[b][None, :, :]
        if ((difference**2).sum(axis=2) <= distance**2).any() and linked[a] is not linked[b]:
            linked[a] |= linked[b]
            for member in linked[b]:
                linked[member] = linked[a]
    return linked


def classify(vmap: VoxelMap, points, labels, origin, config) -> list[int]:
    """Rules A, B and C with the gates; clusters 0, 1, ... all have points."""
    points, origin = np.asarray(points, np.float64), np.asarray(origin, np.float64)
    clusters = [points[labels == label] for label in range(max(labels, default=-1) + 1)]
    background = [is_background(vmap, cluster, config) for cluster in clusters]
    found = []
    for index, group in enumerate(groups(clusters, config.group_distance)):
        fragments = [clusters[member] for member in group if not background[member]]
        if len(fragments) < len(group):
            found.append(BACKGROUND)
        else:
            extent = diagonal(np.concatenate(fragments))
            found.append(flying_or_unknown(vmap, clusters[index], extent, origin, config))
    return found


def is_background(vmap: VoxelMap, points, config) -> bool:
    too_large = config.background_extent is not None and diagonal(points) > config.background_extent
    return too_large or is_close(vmap, points, config.close_distance)


def flying_or_unknown(vmap: VoxelMap, points, extent: float, origin, config) -> int:
    too_far = config.max_distance is not None and (
        math.sqrt(((points.mean(axis=0) - origin) ** 2).sum()) > config.max_distance
    )
    too_large = config.max_extent is not None and extent > config.max_extent
    width, depth, height = np.ptp(points, axis=0)
    upright = (
        config.upright_height is not None
        and height >= config.upright_height
        and math.hypot(width, depth) <= 0.4 * height
    )
    inside = all(vmap.admits(vmap.voxel_at(point)) for point in points)
    if len(points) < config.min_points or too_large or too_far or upright or not inside:
        return UNKNOWN
    search_distance = config.search_distance
    if config.shadow == "own":  # a way out leads away from the cluster, not across it
        search_distance = max(search_distance, 0.5 * search_distance + width + depth + height)
    floating = is_floating(
        vmap,
        points,
        search_distance,
        open_border=config.border == "open",
        is_wall=Shadow(vmap, points, origin) if config.shadow == "own" else None,
        expand_start=config.own_voxels == "expanded",
    )
    return FLYING if floating and clearance(vmap, points) >= config.min_clearance else UNKNOWN


def clearance(vmap: VoxelMap, points, *, seen_from=None) -> float:
    """Share of free voxels among the neighbours of the cluster's own.

    Seen from a place, uncertain voxels in the cluster's shadow are left out: no ray passes them.
    """
    own = {vmap.voxel_at(point) for point in points}
    shell = {neighbour for voxel in own for neighbour in beside(voxel)} - own
    if seen_from is not None:
        hides = Shadow(vmap, points, seen_from)
        shell = {
            voxel
            for voxel in shell
            if vmap.is_free(voxel) or vmap.is_tentative(voxel) or not hides(voxel)
        }
    return sum(map(vmap.is_free, shell)) / max(len(shell), 1)
