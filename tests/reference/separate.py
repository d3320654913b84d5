"""Removal of separate voxels from scratch: sec. III-D, eq. 23."""

import numpy as np

from reference.voxel_map import Voxel, VoxelMap

REACH_TOLERANCE = 1e-12  # relative: 0.75 m are 3 voxels of 0.25 m


def groups(voxels: list[Voxel], reach: float) -> list[list[Voxel]]:
    """Voxels linked by steps of at most `reach` voxels."""
    most = (reach * (1 + REACH_TOLERANCE)) ** 2
    left = np.array(voxels, np.int64).reshape(-1, 3)
    found = []
    while len(left):
        members, left = [tuple(left[-1].tolist())], left[:-1]
        for voxel in members:
            is_near = ((left - voxel) ** 2).sum(axis=1) <= most
            members.extend(map(tuple, left[is_near].tolist()))
            left = left[~is_near]
        found.append(members)
    return found


def has_enough(vmap: VoxelMap, members: list[Voxel], min_confident: int) -> bool:
    return sum(map(vmap.is_confident, members)) >= min_confident


def remove_separate(vmap: VoxelMap, *, max_gap: float, min_confident: int) -> int:
    reach = max_gap / vmap.config.voxel_size
    return remove_groups(vmap, groups(vmap.occupied(), reach), min_confident)


def remove_groups(vmap: VoxelMap, found: list[list[Voxel]], min_confident: int) -> int:
    changed = 0
    for members in found:
        if not has_enough(vmap, members, min_confident):
            finite = [voxel for voxel in members if vmap.values[voxel] != float("inf")]
            changed += len(finite)
            for voxel in finite:
                vmap.pull(voxel, vmap.config.g_free, 1)
    return changed
