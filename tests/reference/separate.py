"""Removal of separate voxels from scratch: sec. III-D, eq. 23."""

from reference.voxel_map import Voxel, VoxelMap

REACH_TOLERANCE = 1e-12  # relative: 0.75 m are 3 voxels of 0.25 m


def groups(voxels: list[Voxel], reach: float) -> list[list[Voxel]]:
    """Voxels linked by steps of at most `reach` voxels."""
    most = (reach * (1 + REACH_TOLERANCE)) ** 2
    left = set(voxels)
    found = []
    while left:
        members = [left.pop()]
        for voxel in members:
            near = [
                v for v in left if sum((a - b) ** 2 for a, b in zip(v, voxel, strict=True)) <= most
            ]
            members.extend(near)
            left.difference_update(near)
        found.append(members)
    return found


def remove_separate(vmap: VoxelMap, *, max_gap: float, min_confident: int) -> int:
    changed = 0
    for members in groups(vmap.occupied(), max_gap / vmap.config.voxel_size):
        if sum(map(vmap.is_confident, members)) < min_confident:
            finite = [voxel for voxel in members if vmap.values[voxel] != float("inf")]
            changed += len(finite)
            for voxel in finite:
                vmap.pull(voxel, vmap.config.g_free, 1)
    return changed
