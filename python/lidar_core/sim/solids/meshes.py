"""Generators of triangle meshes: vertices (V, 3) float64 [m] and faces (F, 3) uint32."""

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Triangles: TypeAlias = tuple[NDArray[np.float64], NDArray[np.uint32]]


def sphere_mesh(radius: float, *, rings: int, sectors: int) -> Triangles:
    """Make a sphere of `rings` bands of latitude and `sectors` of longitude, corners on it.

    Examples
    --------
    >>> vertices, faces = sphere_mesh(1.0, rings=16, sectors=24)
    >>> len(vertices), len(faces)
    (362, 720)
    """
    latitude = np.pi * np.arange(1, rings) / rings
    longitude = 2 * np.pi * np.arange(sectors) / sectors
    sine, cosine = np.sin(latitude)[:, None], np.cos(latitude)[:, None]
    bands = np.stack(
        np.broadcast_arrays(sine * np.cos(longitude), sine * np.sin(longitude), cosine), axis=-1
    )
    vertices = np.concatenate([[[0, 0, 1]], bands.reshape(-1, 3), [[0, 0, -1]]]) * radius
    index = 1 + np.arange((rings - 1) * sectors).reshape(rings - 1, sectors)
    after = np.roll(index, -1, axis=1)
    upper, lower, upper_after, lower_after = index[:-1], index[1:], after[:-1], after[1:]
    last = np.full(sectors, len(vertices) - 1)
    faces = [
        np.stack([np.zeros(sectors, int), index[0], after[0]], axis=-1),
        np.stack([upper, lower, upper_after], axis=-1).reshape(-1, 3),
        np.stack([upper_after, lower, lower_after], axis=-1).reshape(-1, 3),
        np.stack([last, after[-1], index[-1]], axis=-1),
    ]
    return vertices, np.concatenate(faces).astype(np.uint32)


def hexacopter_mesh(radius: float) -> Triangles:
    """Make a hub, six arms with rotor discs, and two skids, inside a sphere of `radius` [m].

    The discs are solid: a LiDAR sees turning rotors only now and then, so that this is the most
    that a drone of the size returns.
    """
    return _multicopter(radius, [np.pi / 3 * arm for arm in range(6)], rotor=0.25)


def quadcopter_mesh(radius: float) -> Triangles:
    """Make a quadcopter inside a sphere of `radius` [m]: hub, arms in an X, rotor discs, skids.

    The discs are solid, as those of `hexacopter_mesh`.

    Examples
    --------
    >>> vertices, faces = quadcopter_mesh(0.25)
    >>> float(np.linalg.norm(vertices, axis=1).max().round(6))
    0.25
    """
    return _multicopter(radius, [np.pi / 4 * (2 * arm + 1) for arm in range(4)], rotor=0.28)


def _multicopter(radius: float, angles: list[float], *, rotor: float) -> Triangles:
    parts = [_prism(8, 0.30, -0.12, 0.14)]
    for angle in angles:
        ahead = np.array([np.cos(angle), np.sin(angle), 0.0])
        parts.append(_bar(0.2 * ahead, 0.75 * ahead, 0.04))
        disc, faces = _prism(16, rotor, 0.05, 0.08)
        parts.append((disc + 0.73 * ahead, faces))
    for side in (-0.25, 0.25):
        parts.append(_bar(np.array([-0.4, side, -0.4]), np.array([0.4, side, -0.4]), 0.03))
        parts.append(_bar(np.array([0.0, 0.5 * side, -0.1]), np.array([0.0, side, -0.4]), 0.03))
    vertices, faces = _join(parts)
    return vertices * (radius / np.linalg.norm(vertices, axis=1).max()), faces


def _prism(sides: int, radius: float, bottom: float, top: float) -> Triangles:
    """Make a closed upright prism around the z axis."""
    angle = 2 * np.pi * np.arange(sides) / sides
    ring = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1)
    rims = [np.column_stack([ring, np.full(sides, height)]) for height in (bottom, top)]
    vertices = np.concatenate([*rims, [[0, 0, bottom], [0, 0, top]]])
    here = np.arange(sides)
    after = np.roll(here, -1)
    faces = [
        np.stack([here, after, here + sides], axis=-1),
        np.stack([after, after + sides, here + sides], axis=-1),
        np.stack([after, here, np.full(sides, 2 * sides)], axis=-1),
        np.stack([here + sides, after + sides, np.full(sides, 2 * sides + 1)], axis=-1),
    ]
    return vertices, np.concatenate(faces).astype(np.uint32)


def _bar(start: NDArray[np.float64], end: NDArray[np.float64], thickness: float) -> Triangles:
    """Make a bar of square section between two points."""
    way = end - start
    length = float(np.linalg.norm(way))
    ahead = way / length
    aside = np.cross(ahead, [0.0, 0.0, 1.0])
    aside /= np.linalg.norm(aside)
    vertices, faces = _prism(4, thickness, 0.0, length)
    axes = np.stack([aside, np.cross(ahead, aside), ahead])
    return vertices @ axes + start, faces


def _join(parts: list[Triangles]) -> Triangles:
    offsets = np.cumsum([0, *(len(vertices) for vertices, _ in parts[:-1])])
    vertices = np.concatenate([vertices for vertices, _ in parts])
    faces = [faces + offset for (_, faces), offset in zip(parts, offsets, strict=True)]
    return vertices, np.concatenate(faces).astype(np.uint32)
