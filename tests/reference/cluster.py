"""Euclidean clustering by scipy: pairs within reach, then connected components."""

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree


def cluster_points(
    points: NDArray[np.float32],
    *,
    max_distance: float,
    min_points: int,
    max_points: int | None = None,
    max_angle: float = 0.0,
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> NDArray[np.int32]:
    """Labels numbered by first appearance; -1 for unwanted sizes and points not finite."""
    labels = np.full(len(points), -1, np.int32)
    rows = np.flatnonzero(np.isfinite(points).all(axis=1))
    if rows.size == 0:
        return labels
    kept = points[rows].astype(np.float64)
    square = ((kept - np.array(origin)) ** 2).sum(axis=1)
    furthest = max(max_distance, max_angle * np.sqrt(square.max()))
    pairs = cKDTree(kept).query_pairs(furthest * (1 + 1e-9), output_type="ndarray")
    gap = ((kept[pairs[:, 0]] - kept[pairs[:, 1]]) ** 2).sum(axis=1)
    nearer = square[pairs].min(axis=1)
    pairs = pairs[gap <= np.maximum(max_distance**2, max_angle**2 * nearer)]
    links = coo_array((np.ones(len(pairs)), pairs.T), shape=(len(rows), len(rows)))
    component = connected_components(links, directed=False)[1]
    sizes = np.bincount(component)
    number: dict[int, int] = {}
    for row, group in zip(rows, component, strict=True):
        if min_points <= sizes[group] and (max_points is None or sizes[group] <= max_points):
            labels[row] = number.setdefault(int(group), len(number))
    return labels
