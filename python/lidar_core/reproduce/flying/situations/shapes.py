"""Simple meshes of flying objects: a fixed wing, an octocopter with a box, a bird, a balloon."""

import numpy as np
from numpy.typing import NDArray

from lidar_core import sim
from lidar_core.sim.solids.shapes import Solid

Box: tuple[tuple[int, int, int], ...] = (
    *((0, 1, 3), (0, 3, 2), (4, 7, 5), (4, 6, 7)),
    *((0, 5, 1), (0, 4, 5), (2, 3, 7), (2, 7, 6)),
    *((0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3)),
)
"""Triangles of a box whose corners are numbered by the bits of their place."""


def _box(low: tuple[float, float, float], high: tuple[float, float, float]) -> NDArray[np.float64]:
    """Corners of a box (8, 3); bits of the index select the low or high end of each axis."""
    return np.array(
        [[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])]
    )


def _mesh(boxes: list[NDArray[np.float64]]) -> sim.Mesh:
    """Join boxes into one mesh whose bounding box has its centre at the origin."""
    vertices = np.concatenate(boxes)
    vertices -= (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    faces = np.concatenate([np.array(Box) + 8 * number for number in range(len(boxes))])
    corners = tuple(tuple(row) for row in vertices.tolist())
    return sim.Mesh(vertices=corners, faces=tuple(tuple(row) for row in faces.tolist()))


def fixed_wing(span: float) -> sim.Mesh:
    """Make the mesh of a fixed-wing aircraft: wing along y, fuselage along x, tail, fin."""
    chord, length = 0.13 * span, 0.55 * span
    return _mesh(
        [
            _box((-0.5 * chord, -0.5 * span, 0.0), (0.5 * chord, 0.5 * span, 0.02 * span)),
            _box(
                (-0.6 * length, -0.03 * span, -0.04 * span),
                (0.4 * length, 0.03 * span, 0.02 * span),
            ),
            _box((-0.6 * length, -0.15 * span, 0.0), (-0.5 * length, 0.15 * span, 0.015 * span)),
            _box((-0.6 * length, -0.01 * span, 0.0), (-0.5 * length, 0.01 * span, 0.12 * span)),
        ]
    )


def octocopter(width: float) -> sim.Mesh:
    """Make the mesh of an octocopter: eight rotors on crossed arms and a box below."""
    arm, disc = 0.5 * width, 0.13 * width
    boxes = [
        _box((-0.15, -0.15, -0.05), (0.15, 0.15, 0.08)),
        _box((-0.2, -0.2, -0.4), (0.2, 0.2, -0.08)),
    ]
    for angle in np.arange(8) * np.pi / 4:
        way = np.array([np.cos(angle), np.sin(angle)])
        rotor = (arm - disc) * way
        boxes.append(
            _box((rotor[0] - disc, rotor[1] - disc, 0.06), (rotor[0] + disc, rotor[1] + disc, 0.09))
        )
        for share in (0.35, 0.55, 0.75):
            x, y = (share * arm * way).tolist()
            boxes.append(_box((x - 0.05, y - 0.05, 0.0), (x + 0.05, y + 0.05, 0.05)))
    return _mesh(boxes)


def bird(span: float) -> sim.Mesh:
    """Make the mesh of a bird, with wings along y and a body along x."""
    return _mesh(
        [
            _box((-0.15 * span, -0.5 * span, 0.0), (0.15 * span, 0.5 * span, 0.04 * span)),
            _box((-0.35 * span, -0.1 * span, -0.1 * span), (0.35 * span, 0.1 * span, 0.1 * span)),
        ]
    )


SIZES: dict[str, tuple[Solid, float]] = {
    "fixed wing 2.2 m": (fixed_wing(2.2), 2.2),
    "fixed wing 1.5 m": (fixed_wing(1.5), 1.5),
    "octocopter 1.5 m": (octocopter(1.5), 1.5),
    "balloon 1 m": (sim.Sphere(radius=0.5), 1.0),
    "quadcopter .35 m": (sim.Quadcopter(radius=0.175), 0.35),
    "bird .3 m": (bird(0.3), 0.3),
}
"""Flying objects and their spans [m]."""
