"""Maps that lidar_core writes for OctoMap, opened with pyoctomap."""

from pathlib import Path

import numpy as np
import pyoctomap

import lidar_core as lc
from lidar_core.io.maps.octomap import write_octomap

RESOLUTION = 0.25
SEED, POINTS = 7, 4000


def check(folder: Path) -> str:
    """Stop unless pyoctomap finds the very voxels that were written; say how many."""
    rng = np.random.default_rng(SEED)
    cloud = rng.normal(scale=8.0, size=(POINTS, 3))
    solid = np.stack(np.meshgrid(*[np.arange(8)] * 3), axis=-1).reshape(-1, 3) * RESOLUTION
    voxel_map = lc.VoxelMap(lc.VoxelMapConfig(voxel_size=RESOLUTION))
    # eight voxels a side, corner to corner of the tree: they become one large leaf
    voxel_map.set_occupied(np.concatenate([cloud, solid + 4.0 + RESOLUTION / 2]))
    expected = keys_of(voxel_map.occupied_points())
    path = write_octomap(folder / "map.bt", voxel_map.occupied_points(), resolution=RESOLUTION)
    tree = pyoctomap.OcTree(RESOLUTION)
    if not tree.readBinary(str(path)):
        raise SystemExit(f"pyoctomap does not read {path}")
    found = leaves(tree)
    if found != expected:
        raise SystemExit(
            f"pyoctomap finds {len(found)} occupied voxels in {path}, {len(expected)} written"
        )
    return f"Exported map: pyoctomap opens it and finds the same {len(found):,} occupied voxels."


def leaves(tree: object) -> set[tuple[int, ...]]:
    """Occupied voxels, larger leaves taken apart."""
    found = set()
    for leaf in tree.begin_leafs():
        if not tree.isNodeOccupied(leaf):
            continue
        size = round(leaf.getSize() / RESOLUTION)
        corner = np.array(leaf.getCoordinate()) - (size - 1) / 2 * RESOLUTION
        steps = np.stack(np.meshgrid(*[np.arange(size)] * 3), axis=-1).reshape(-1, 3)
        found |= keys_of(corner + steps * RESOLUTION)
    return found


def keys_of(points: np.ndarray) -> set[tuple[int, ...]]:
    """Voxels that hold the points."""
    return set(map(tuple, np.floor(points / RESOLUTION).astype(int).tolist()))
