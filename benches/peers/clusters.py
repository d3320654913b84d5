"""Euclidean clusters of all returns of a scan: single linkage, no smallest size, one thread."""

from pathlib import Path

import numpy as np
from native import PLAIN, MissingError, programs
from numpy.typing import NDArray
from rays import read_scans
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree
from sklearn.cluster import DBSCAN
from turns import Gate, System, Turns, take_turns

import lidar_core as lc

TOLERANCE = 0.25
YARDSTICK, OURS = "cluster_hash", "lidar_core"
PCL = "PCL EuclideanClusterExtraction"
GATES = [Gate(f"{PCL} ({PLAIN})", YARDSTICK, 8)]

Points = NDArray[np.float32]


def by_lidar_core(points: Points) -> int:
    """Clusters that lidar_core finds."""
    return int(lc.cluster_points(points, max_distance=TOLERANCE, min_points=1).max()) + 1


def by_scipy(points: Points) -> int:
    """Clusters as connected components of all close pairs."""
    pairs = cKDTree(points).query_pairs(TOLERANCE, output_type="ndarray")
    near = coo_array((np.ones(len(pairs), bool), pairs.T), shape=(len(points),) * 2)
    return int(connected_components(near, directed=False)[0])


def by_sklearn(points: Points) -> int:
    """Clusters by DBSCAN, where every point is a core."""
    found = DBSCAN(eps=TOLERANCE, min_samples=1, algorithm="kd_tree").fit(points)
    return int(found.labels_.max()) + 1


def measure(yardstick: Path, folder: Path, scans: list[int], title: str) -> Turns:
    """All systems in turn; stops unless they find the same number of clusters."""
    points = [
        np.ascontiguousarray(rays[np.isfinite(rays[:, 3]), 3:]) for _, rays in read_scans(folder)
    ]
    systems = [
        System.program(YARDSTICK, yardstick, "cluster", folder),
        System(OURS, lambda scan: by_lidar_core(points[scan])),
    ]
    try:
        systems += [
            System.program(f"{PCL} ({kind})", path, folder)
            for kind, path in programs("pcl").items()
        ]
    except MissingError as why:
        print(f"PCL is left out: {why}.\n")
    systems += [
        System("scipy cKDTree, connected components", lambda scan: by_scipy(points[scan])),
        System("scikit-learn DBSCAN", lambda scan: by_sklearn(points[scan])),
    ]
    turns = take_turns(title, systems, scans)
    if any(counts != turns.counts[YARDSTICK] for counts in turns.counts.values()):
        raise SystemExit(f"the systems find different numbers of clusters: {turns.counts}")
    return turns
