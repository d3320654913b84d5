"""One scan into a map of voxels on one thread: every ray, or one ray per end voxel."""

from pathlib import Path

import numpy as np
import pyoctomap
from native import MissingError, programs
from numpy.typing import NDArray
from turns import Gate, System, Turns, take_turns

import lidar_core as lc

MAX_RANGE, VOXEL_SIZE = 20.0, 0.25
YARDSTICK, OURS = "ray_scalar", "lidar_core"
APPROXIMATE = "lidar_core, one ray per end voxel"
AGREEMENT = 1e-3
"""Largest relative difference of the voxels visited from the yardstick's."""
PYOCTOMAP = "pyoctomap, default"
GATES = [Gate(PYOCTOMAP, YARDSTICK, 16)]


def read_scans(folder: Path) -> list[tuple[NDArray[np.float64], NDArray[np.float32]]]:
    """Origin of every scan, and its rays (N, 6): direction and end, NaN without return."""
    origins = np.fromfile(folder / "origins.f64", "<f8").reshape(-1, 3)
    return [
        (origin, np.fromfile(folder / f"{number}.f32", "<f4").reshape(-1, 6))
        for number, origin in enumerate(origins)
    ]


def ours(folder: Path, *, threads: int = 1, exact: bool = True) -> System:
    """The map of lidar_core, through Python."""
    rays = "all" if exact else "one_per_end"
    config = lc.VoxelMapConfig(voxel_size=VOXEL_SIZE, max_range=MAX_RANGE, rays=rays)
    voxel_map = lc.VoxelMap(config, threads=threads)
    scans = []
    for origin, rays in read_scans(folder):
        points, directions = np.ascontiguousarray(rays[:, 3:]), np.ascontiguousarray(rays[:, :3])
        missed = np.isnan(points[:, 0])
        scans.append((points, (~missed).astype(np.uint8), origin, directions, missed))

    def work(scan: int) -> int:
        points, classes, origin, directions, missed = scans[scan]
        stats = voxel_map.integrate(
            points, classes, origin, ray_directions=directions, no_return=missed
        )
        return stats.n_visits

    return System(OURS if exact else APPROXIMATE, work)


def pyoctomap_tree(name: str, folder: Path, *, lazy: bool) -> System:
    """A tree of pyoctomap; it gets near returns, else points beyond the greatest range."""
    tree = pyoctomap.OcTree(VOXEL_SIZE)
    scans = []
    for origin, rays in read_scans(folder):
        near = np.linalg.norm(rays[:, 3:] - origin, axis=1) <= MAX_RANGE
        beyond = origin + (MAX_RANGE + 0.5) * rays[:, :3]
        scans.append((np.where(near[:, None], rays[:, 3:], beyond).astype(np.float64), origin))

    def work(scan: int) -> int:
        points, origin = scans[scan]
        tree.insertPointCloud(points, origin, max_range=MAX_RANGE, lazy_eval=lazy, discretize=lazy)
        return int(tree.size())

    return System(name, work)


def octomap_trees(folder: Path) -> list[System]:
    """OctoMap in C++, or nothing and a sentence."""
    try:
        built = programs("octomap")
    except MissingError as why:
        print(f"OctoMap in C++ is left out: {why}.\n")
        return []
    modes = {"default": "default", "lazy": "lazy + discretize"}
    return [
        System.program(f"OctoMap, {title} ({kind})", path, folder, mode)
        for mode, title in modes.items()
        for kind, path in built.items()
    ]


def measure(yardstick: Path, folder: Path, scans: list[int], title: str) -> Turns:
    """All systems in turn; stops if lidar_core did other work than the yardstick."""
    systems = [
        System.program(YARDSTICK, yardstick, "rays", folder),
        ours(folder),
        ours(folder, exact=False),
        *octomap_trees(folder),
        pyoctomap_tree(PYOCTOMAP, folder, lazy=False),
        pyoctomap_tree("pyoctomap, lazy + discretize", folder, lazy=True),
    ]
    turns = take_turns(title, systems, scans)
    visits = np.array([turns.counts[YARDSTICK], turns.counts[OURS]], np.float64)
    if (np.abs(visits[1] / visits[0] - 1) > AGREEMENT).any():
        raise SystemExit(f"lidar_core does not visit what the yardstick visits: {visits.tolist()}")
    return turns
