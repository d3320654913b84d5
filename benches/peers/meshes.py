"""Rays against a scene: exact shapes and triangles of lidar_core, triangles of Open3D (Embree)."""

from itertools import product
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rays import read_scans
from turns import System, Turns, take_turns

import lidar_core as lc
from lidar_core._core import SimScene, SimShape

RANGE_MAX = 100.0
SIDES = 48
"""Of the prism that stands for a cylinder."""
SPHERE = {"rings": 16, "sectors": 24}
YARDSTICK, OURS = "Open3D, RaycastingScene (Embree)", "lidar_core, triangles"
AGREEMENT = 1e-3
"""Largest difference of two ranges [m]."""
DIFFERENT = 1e-4
"""Share of rays that may differ more: they graze an edge."""

Triangles = tuple[NDArray[np.float64], NDArray[np.uint32]]


def prism(radius: float, height: float) -> Triangles:
    """A standing cylinder with its top, its middle at the origin."""
    turn = 2 * np.pi * np.arange(SIDES) / SIDES
    ring = radius * np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    levels = [np.column_stack([ring, np.full(SIDES, z)]) for z in (-height / 2, height / 2)]
    low, after = np.arange(SIDES), np.roll(np.arange(SIDES), -1)
    top = np.full(SIDES, 2 * SIDES)
    faces = [
        (low, after, after + SIDES),
        (low, after + SIDES, low + SIDES),
        (low + SIDES, after + SIDES, top),
    ]
    corners = np.concatenate([*levels, [[0.0, 0.0, height / 2]]])
    return corners, np.concatenate([np.stack(face, axis=-1) for face in faces]).astype(np.uint32)


def cuboid(size: tuple[float, float, float]) -> Triangles:
    """A box, its middle at the origin."""
    corners = np.array(list(product((-0.5, 0.5), repeat=3))) * size
    sides = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = [half for a, b, c, d in sides for half in ((a, b, c), (a, c, d))]
    return corners, np.array(faces, np.uint32)


def triangles(shape: lc.sim.Plane | lc.sim.Box | lc.sim.Cylinder) -> Triangles:
    """Triangles of one body."""
    if isinstance(shape, lc.sim.Box):
        return cuboid(shape.size)
    if isinstance(shape, lc.sim.Cylinder):
        return prism(shape.radius, shape.height)
    x, y = np.array(shape.size) / 2
    return np.array([[-x, -y, 0], [x, -y, 0], [x, y, 0], [-x, y, 0]]), np.array(
        [[0, 1, 2], [0, 2, 3]], np.uint32
    )


def scene_of(scene: lc.sim.Scene) -> tuple[Triangles, list[tuple[SimShape, NDArray[np.float64]]]]:
    """All bodies and targets as one mesh, and as exact shapes with their poses."""
    corners, faces, exact, held = [], [], [], 0
    placed = [(triangles(body.shape), body.shape, body.position) for body in scene.bodies]
    placed += [
        (
            lc.sim.sphere_mesh(target.shape.radius, **SPHERE),
            target.shape,
            target.motion.positions[0],
        )
        for target in scene.targets
    ]
    for (vertices, sides), shape, position in placed:
        corners.append(vertices + position)
        faces.append(sides + held)
        held += len(vertices)
        pose = np.eye(4)
        pose[:3, 3] = position
        exact += [(surface, pose) for surface, _ in shape.surfaces()]
    return (np.concatenate(corners), np.concatenate(faces).astype(np.uint32)), exact


def by_open3d(mesh: Triangles, rays: list[NDArray[np.float64]]) -> tuple[System, list[object]]:
    """Open3D's scene of Embree; it says what it is by its ranges."""
    import open3d as o3d

    scene = o3d.t.geometry.RaycastingScene(nthreads=1)
    scene.add_triangles(mesh[0].astype(np.float32), mesh[1])
    tensors = [o3d.core.Tensor(np.hstack(both).astype(np.float32)) for both in rays]
    found: list[object] = [None] * len(rays)

    def work(scan: int) -> int:
        found[scan] = scene.cast_rays(tensors[scan], nthreads=1)["t_hit"].numpy()
        return len(found[scan])

    return System(YARDSTICK, work), found


def by_lidar_core(
    name: str, bodies: list[tuple[SimShape, NDArray[np.float64]]], rays: list[NDArray[np.float64]]
) -> tuple[System, list[object]]:
    """The simulator's world."""
    labelled = [(shape, pose, number) for number, (shape, pose) in enumerate(bodies)]
    world = SimScene(labelled, [], threads=1)
    found: list[object] = [None] * len(rays)

    def work(scan: int) -> int:
        found[scan] = world.cast(*rays[scan], RANGE_MAX)[0]
        return len(found[scan])

    return System(name, work), found


def measure(folder: Path, scans: list[int], number: int, title: str) -> Turns:
    """All systems in turn; stops unless the triangles give the same ranges."""
    mesh, exact = scene_of(lc.sim.scenes.performance(scene=number))
    rays = []
    for origin, rows in read_scans(folder):
        directions = rows[:, :3].astype(np.float64)
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        rays.append((np.tile(origin, (len(rows), 1)), directions))
    embree, theirs = by_open3d(mesh, rays)
    ours, same = by_lidar_core(OURS, [(SimShape.mesh(*mesh), np.eye(4))], rays)
    shapes, _ = by_lidar_core("lidar_core, exact shapes", exact, rays)
    turns = take_turns(title, [embree, ours, shapes], scans)
    ranges = np.where(theirs[scans[0]] <= RANGE_MAX, theirs[scans[0]], np.inf)
    with np.errstate(invalid="ignore"):
        apart = np.abs(ranges - same[scans[0]]) > AGREEMENT
    if apart.mean() > DIFFERENT:
        raise SystemExit(f"ranges of {apart.sum()} of {len(apart)} rays differ from Open3D's")
    return turns
