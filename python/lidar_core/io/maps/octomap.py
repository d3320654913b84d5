"""OctoMap's binary trees (.bt): occupied voxels in and out.

Inner nodes are stored depth first, two bits per child in two bytes: 00 unknown, 01 free, 10
occupied, 11 an inner node; bits 0, 1 and 2 of a child's number select the upper halves in x, y and
z. A leaf above the lowest level represents all voxels below it.
"""

from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lidar_core.arrays import as_finite_rows
from lidar_core.errors import FormatError, InputError
from lidar_core.files import check_regular
from lidar_core.io.files.atomic import written_whole
from lidar_core.io.files.guard import check_size, reading
from lidar_core.io.options import ReadOptions
from lidar_core.io.writers import register_writer

DEPTH = 16
HALF = 2 ** (DEPTH - 1)  # voxels from the lattice's edge to its middle
FIRST_LINE = b"# Octomap OcTree binary file"
OCCUPIED, INNER = 2, 3
MAX_HEADER_LINES = 64


def read_octomap(
    path: str | Path, *, options: ReadOptions | None = None
) -> tuple[NDArray[np.float64], float]:
    """Read the centres (N, 3) [m] of the finest occupied voxels of a .bt file, and their edge [m].

    Raises
    ------
    FormatError
        The file has another format.
    LimitError
        A larger file, or more voxels, than the options allow.
    """
    place, chosen = Path(path), options or ReadOptions()
    check_size(
        str(place),
        check_regular(place).stat().st_size,
        limit=chosen.max_record_bytes,
        key="max_record_bytes",
        what="a file of bytes",
    )
    data = place.read_bytes()
    resolution, start = _header(place, data)
    with reading(str(place)):
        nodes = np.frombuffer(data, "<u2", offset=start).tolist()
    corners, depths = _occupied_leaves(place, nodes)
    sizes = 2 ** (DEPTH - depths)
    check_size(
        str(place),
        int((sizes.astype(np.float64) ** 3).sum()),
        limit=chosen.max_points,
        key="max_points",
        what="a tree of occupied voxels",
    )
    keys = _expand(corners, sizes)
    return (keys - HALF + 0.5) * resolution, resolution


@register_writer("OctoMap", [".bt"], takes="points", needs_resolution=True)
def write_voxels(path: Path, points: NDArray[np.float64], resolution: float) -> None:
    """Write the voxels that contain points."""
    write_octomap(path, points, resolution=resolution)


def write_octomap(path: str | Path, points: ArrayLike, *, resolution: float) -> Path:
    """Write the voxels that contain at least one of `points` (N, 3) [m] as occupied, none as free.

    Parameters
    ----------
    path : str or Path
        .bt file, written atomically.
    points : array_like, shape (N, 3)
        Coordinates [m]; the voxels are those of OctoMap's lattice, whose corners are multiples of
        the resolution.
    resolution : float
        Edge of a voxel [m].

    Raises
    ------
    InputError
        Points that are not finite or lie beyond 2^15 voxels from the origin.
    """
    rows = as_finite_rows(points, name="points", rows=None, shape=(3,))
    if not 0 < resolution < np.inf:
        raise InputError(f"resolution: expected a finite number > 0, got {resolution}")
    keys = np.floor(rows / resolution) + HALF
    outside = np.flatnonzero(((keys < 0) | (keys >= 2 * HALF)).any(axis=1))
    if len(outside):
        raise InputError(
            f"points: expected coordinates within {HALF * resolution:g} m of the origin, got"
            f" {rows[outside[0]].tolist()} in row {outside[0]}; a larger resolution reaches further"
        )
    codes = np.unique(_morton(keys.astype(np.int64)))
    nodes = _nodes(codes)
    head = f"id OcTree\nsize {len(nodes) + len(codes)}\nres {resolution!r}\ndata\n"
    place = Path(path)
    with written_whole(place) as temporary:
        temporary.write_bytes(FIRST_LINE + b"\n" + head.encode() + nodes.astype("<u2").tobytes())
    return place


def _header(path: Path, data: bytes) -> tuple[float, int]:
    """Read the header; return the resolution [m] and the byte at which the nodes begin."""
    values: dict[str, str] = {}
    position = 0
    for number in range(MAX_HEADER_LINES):
        end = data.find(b"\n", position)
        line = data[position:end].decode("utf-8", "replace").strip() if end >= 0 else ""
        if end < 0 or (number == 0 and line != FIRST_LINE.decode()):
            break
        position = end + 1
        if line == "data":
            break
        key, _, value = line.partition(" ")
        values[key] = value
    else:
        raise FormatError(f"{path}: no line 'data' in its header")
    if values.get("id") != "OcTree" or "res" not in values:
        raise FormatError(f"{path}: expected a binary OcTree of OctoMap, got {data[:40]!r}")
    with reading(str(path)):
        resolution = float(values["res"])
    if not 0 < resolution < np.inf:
        raise FormatError(f"{path}: expected a finite resolution > 0, got {resolution} m")
    return resolution, position


def _occupied_leaves(path: Path, nodes: list[int]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Lowest keys (L, 3) and depths (L,) of the occupied leaves."""
    corners: list[tuple[int, int, int]] = []
    depths: list[int] = []
    pending = [(0, 0, 0, 0)] if nodes else []
    used = 0
    while pending:
        x, y, z, depth = pending.pop()
        if used == len(nodes) or depth == DEPTH:
            what = "ends early" if used == len(nodes) else f"is deeper than {DEPTH} levels"
            raise FormatError(f"{path}: the tree {what}, at node {used}")
        bits, half = nodes[used], 1 << (DEPTH - 1 - depth)
        used += 1
        below = []
        for child in range(8):
            state = bits >> 2 * child & 3
            if state < OCCUPIED:
                continue
            corner = (x + half * (child & 1), y + half * (child >> 1 & 1), z + half * (child >> 2))
            if state == OCCUPIED:
                corners.append(corner)
                depths.append(depth + 1)
            else:
                below.append((*corner, depth + 1))
        pending += reversed(below)
    if used != len(nodes):
        raise FormatError(f"{path}: {len(nodes) - used} nodes belong to no tree")
    return np.reshape(np.array(corners, np.int64), (-1, 3)), np.array(depths, np.int64)


def _expand(corners: NDArray[np.int64], sizes: NDArray[np.int64]) -> NDArray[np.int64]:
    """Keys (N, 3) of all finest voxels of leaves with these lowest keys and edges."""
    parts = []
    for size in np.unique(sizes).tolist():
        steps = np.stack(np.meshgrid(*[np.arange(size)] * 3, indexing="ij"), axis=-1)
        chosen = corners[sizes == size]
        parts.append((chosen[:, None] + steps.reshape(1, -1, 3)).reshape(-1, 3))
    return np.concatenate([np.empty((0, 3), np.int64), *parts])


def _morton(keys: NDArray[np.int64]) -> NDArray[np.int64]:
    """Morton codes of keys: groups of three bits, from the top, are the numbers of the children."""
    codes = np.zeros(len(keys), np.int64)
    for bit in range(DEPTH):
        for axis in range(3):
            codes |= (keys[:, axis] >> bit & 1) << (3 * bit + axis)
    return codes


def _nodes(codes: NDArray[np.int64]) -> NDArray[np.int64]:
    """Bits of all inner nodes above leaves with these codes, depth first."""
    starts, depths, bits = [], [], []
    for depth in range(DEPTH):
        below = np.unique(codes >> 3 * (DEPTH - depth - 1))
        state = OCCUPIED if depth == DEPTH - 1 else INNER
        names, which = np.unique(below >> 3, return_inverse=True)
        sums = np.zeros(len(names), np.int64)
        np.add.at(sums, which, state << 2 * (below & 7))
        starts.append(names << 3 * (DEPTH - depth))
        depths.append(np.full(len(names), depth))
        bits.append(sums)
    order = np.lexsort((np.concatenate(depths), np.concatenate(starts)))
    return np.asarray(np.concatenate(bits)[order])
