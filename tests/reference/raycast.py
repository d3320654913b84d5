"""Rays against shapes by school formulas in numpy: slow, all rays against everything.

Every function takes rays in the shape's own frame, origins (N, 3) and unit directions (N, 3),
and returns the least distance >= 0 at which each meets the surface, +inf if it does not.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Meet = Callable[[Array, Array], Array]


def nearest(candidates: list[tuple[Array, NDArray[np.bool_]]]) -> Array:
    """Least distance >= 0 among candidates (N,) where the mask beside it holds."""
    rows = [np.where(mask & (t >= 0), t, np.inf) for t, mask in candidates]
    return np.min(rows, axis=0)


def sphere(radius: float) -> Meet:
    def meet(origins: Array, directions: Array) -> Array:
        b = np.einsum("ij,ij->i", origins, directions)
        c = np.einsum("ij,ij->i", origins, origins) - radius**2
        root = np.sqrt(b * b - c)
        return nearest([(-b - root, b * b >= c), (-b + root, b * b >= c)])

    return meet


def box(size: tuple[float, float, float]) -> Meet:
    half = np.array(size) / 2

    def meet(origins: Array, directions: Array) -> Array:
        candidates = []
        for axis in range(3):
            others = [other for other in range(3) if other != axis]
            for side in (-1, 1):
                t = (side * half[axis] - origins[:, axis]) / directions[:, axis]
                at = origins + t[:, None] * directions
                candidates.append((t, (np.abs(at[:, others]) <= half[others]).all(axis=1)))
        return nearest(candidates)

    return meet


def cylinder(radius: float, height: float) -> Meet:
    def meet(origins: Array, directions: Array) -> Array:
        (x, y, z), (dx, dy, dz) = origins.T, directions.T
        a, b, c = dx * dx + dy * dy, x * dx + y * dy, x * x + y * y - radius**2
        root = np.sqrt(b * b - a * c)
        walls = [(-b - root) / a, (-b + root) / a]
        candidates = [(t, np.abs(z + t * dz) <= height / 2) for t in walls]
        for side in (-1, 1):
            t = (side * height / 2 - z) / dz
            candidates.append((t, np.hypot(x + t * dx, y + t * dy) <= radius))
        return nearest(candidates)

    return meet


def plane(size: tuple[float, float]) -> Meet:
    def meet(origins: Array, directions: Array) -> Array:
        t = -origins[:, 2] / directions[:, 2]
        at = np.abs(origins + t[:, None] * directions)
        return nearest([(t, (at[:, 0] <= size[0] / 2) & (at[:, 1] <= size[1] / 2))])

    return meet


def mesh(vertices: Array, faces: NDArray[np.uint32]) -> Meet:
    """Cramer's rule for origin + t d = a + u (b - a) + v (c - a), of every triangle and ray."""
    a, b, c = np.moveaxis(vertices[faces.astype(int)], 1, 0)[:, :, None]

    def meet(origins: Array, directions: Array) -> Array:
        sides = np.broadcast_arrays(-directions, b - a, c - a, origins - a)
        system = np.stack(sides[:3], axis=-1)  # columns: -d, b - a, c - a
        whole = np.linalg.det(system)
        solution = []
        for column in range(3):
            changed = system.copy()
            changed[..., column] = sides[3]
            solution.append(np.linalg.det(changed) / whole)
        t, u, v = solution
        meets = (u >= 0) & (v >= 0) & (u + v <= 1) & (whole != 0)
        return nearest(list(zip(t, meets, strict=True)))

    return meet


def height_field(heights: Array, cell: float) -> Meet:
    """Two triangles per cell, split along the diagonal from (x, y + cell) to (x + cell, y)."""
    rows, columns = heights.shape
    triangles = []

    def corner(row: int, column: int) -> Array:
        x, y = cell * (row - (rows - 1) / 2), cell * (column - (columns - 1) / 2)
        return np.array([x, y, heights[row, column]])

    for row in range(rows - 1):
        for column in range(columns - 1):
            ends = corner(row + 1, column), corner(row, column + 1)
            triangles.append([corner(row, column), *ends])
            triangles.append([corner(row + 1, column + 1), *ends])
    vertices = np.array(triangles).reshape(-1, 3)
    return mesh(vertices, np.arange(len(vertices), dtype=np.uint32).reshape(-1, 3))


def cast(meet: Meet, world_from_shape: Array, origins: Array, directions: Array) -> Array:
    """Distances (N,) of rays in the world frame to a shape at a pose (4, 4)."""
    shape_from_world = np.linalg.inv(world_from_shape)
    turn, shift = shape_from_world[:3, :3], shape_from_world[:3, 3]
    with np.errstate(all="ignore"):  # parallel rays divide by 0: masked
        return meet(origins @ turn.T + shift, directions @ turn.T)
