"""Transforms between named frames over time, interpolated on SE(3)."""

from collections import deque
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lidar_core.errors import FormatError
from lidar_core.io.rotations import pose_matrix, quaternion_from_matrix, slerp
from lidar_core.messages import Pose

_Path: TypeAlias = list[tuple[tuple[str, str], bool]]
"""Edges, each with True where it runs parent to child."""


class NoTransformError(FormatError):
    """Error: two frames are not connected, or not at the requested time."""


@dataclass(slots=True)
class _Edge:
    """Poses of one frame in another, appended in any order, sorted at the first access."""

    stamps: list[int] = field(default_factory=list)
    matrices: list[NDArray[np.float64]] = field(default_factory=list)
    static: NDArray[np.float64] | None = None
    arrays: tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]] | None = None

    def add(self, pose: Pose) -> None:
        if pose.is_static:
            self.static = pose.matrix
            return
        self.stamps.append(pose.stamp_ns)
        self.matrices.append(pose.matrix)
        self.arrays = None

    def forget(self, before_ns: int) -> None:
        """Drop poses older than `before_ns` [ns], except the last of all."""
        stamps, matrices = self.stamps, self.matrices
        kept = [row for row, stamp in enumerate(stamps) if stamp >= before_ns]
        if len(kept) == len(stamps):
            return
        kept = kept or [max(range(len(stamps)), key=stamps.__getitem__)]
        self.stamps = [stamps[row] for row in kept]
        self.matrices = [matrices[row] for row in kept]
        self.arrays = None

    def sorted(self) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
        """Stamps, translations and quaternions, kept in `arrays`; of equal stamps the last one."""
        stamps = np.array(self.stamps, np.int64)
        order = np.argsort(stamps, kind="stable")
        last = np.append(np.diff(stamps[order]) != 0, True)
        order = order[last]
        matrices = np.array(self.matrices)[order]
        quaternions = quaternion_from_matrix(matrices[:, :3, :3])
        self.arrays = (stamps[order], matrices[:, :3, 3], quaternions)
        return self.arrays


class TransformBuffer:
    """Transforms between frames, each edge interpolated between its two nearest poses.

    Parameters
    ----------
    max_gap : float
        Longest time between two poses to interpolate over [s].
    max_extrapolation : float
        Time for which the first pose holds before, and the last pose after, its own time [s].
    """

    def __init__(self, *, max_gap: float, max_extrapolation: float) -> None:
        self._max_gap_ns = round(max_gap * 1e9)
        self._max_hold_ns = round(max_extrapolation * 1e9)
        self._edges: dict[tuple[str, str], _Edge] = {}
        # Paths asked for, until an edge is added: every scan asks for the same one.
        self._paths: dict[tuple[str, str], _Path] = {}

    def add(self, pose: Pose) -> None:
        """Add a pose of `pose.child_frame_id` in `pose.frame_id`."""
        key = (pose.frame_id, pose.child_frame_id)
        if key not in self._edges:
            self._edges[key] = _Edge()
            self._paths.clear()
        self._edges[key].add(pose)

    def forget(self, before_ns: int) -> None:
        """Drop poses older than `before_ns` [ns], except the last of every edge."""
        for edge in self._edges.values():
            edge.forget(before_ns)

    def edges(self) -> dict[tuple[str, str], bool]:
        """Return every pair (parent, child), and whether it is static."""
        return {key: edge.static is not None for key, edge in self._edges.items()}

    def edges_between(self, target: str, source: str) -> set[tuple[str, str]]:
        """Return the pairs (parent, child) on the way between two frames.

        Raises
        ------
        NoTransformError
            The frames are not connected.
        """
        return {key for key, _ in self._path(target, source)}

    def root_of(self, frame: str) -> str:
        """Return the root of the tree that contains `frame`; `frame` itself if it has no parent."""
        parents = {child: parent for parent, child in self._edges}
        seen = {frame}
        while frame in parents and parents[frame] not in seen:
            frame = parents[frame]
            seen.add(frame)
        return frame

    def is_static(self, target: str, source: str) -> bool:
        """Return whether all transforms between the two frames are static."""
        return all(self._edges[key].static is not None for key, _ in self._path(target, source))

    def known_until(self, target: str, source: str) -> int | None:
        """Latest time at which all transforms between the frames are known [ns]; None if static.

        Raises
        ------
        NoTransformError
            The frames are not connected.
        """
        edges = [self._edges[key] for key, _ in self._path(target, source)]
        return min((max(edge.stamps) for edge in edges if edge.static is None), default=None)

    def knots(self, target: str, source: str, start_ns: int, end_ns: int) -> NDArray[np.int64]:
        """Times of recorded poses between the frames, after `start_ns` and before `end_ns` [ns]."""
        stamps = [np.empty(0, np.int64)]
        for key, _ in self._paths.get((target, source)) or self._path(target, source):
            edge = self._edges[key]
            if edge.static is None:
                recorded = (edge.arrays or edge.sorted())[0]
                stamps.append(recorded[(recorded > start_ns) & (recorded < end_ns)])
        return np.unique(np.concatenate(stamps))

    def lookup(self, target: str, source: str, stamps_ns: ArrayLike) -> NDArray[np.float64]:
        """Transforms `target_from_source`, shape (K, 4, 4), at `stamps_ns` (K,) [ns].

        Raises
        ------
        NoTransformError
            The frames are not connected, or a stamp lies outside the poses or in a gap.
        """
        stamps = np.atleast_1d(np.asarray(stamps_ns, np.int64))
        total = np.broadcast_to(np.eye(4), (len(stamps), 4, 4))
        for key, forward in self._paths.get((target, source)) or self._path(target, source):
            step = self._at(key, stamps)
            total = total @ (step if forward else _inverse(step))
        return np.ascontiguousarray(total)

    def _at(self, key: tuple[str, str], stamps: NDArray[np.int64]) -> NDArray[np.float64]:
        edge = self._edges[key]
        if edge.static is not None:
            return np.broadcast_to(edge.static, (len(stamps), 4, 4))
        known, translations, quaternions = edge.arrays or edge.sorted()
        name = f"{key[0]} -> {key[1]}"
        low, high = known[0] - self._max_hold_ns, known[-1] + self._max_hold_ns
        outside = stamps[(stamps < low) | (stamps > high)]
        if len(outside):
            stamp = outside[0]
            apart = (
                f"{(known[0] - stamp) * 1e-9:.3g} s before the first"
                if stamp < low
                else f"{(stamp - known[-1]) * 1e-9:.3g} s after the last"
            )
            raise NoTransformError(
                f"{name} is known from {known[0]} to {known[-1]} ns, not at {stamp} ns ({apart})"
            )
        inside = np.clip(stamps, known[0], known[-1])
        after = np.clip(np.searchsorted(known, inside, side="left"), 1, max(len(known) - 1, 1))
        after = np.minimum(after, len(known) - 1)
        before = np.maximum(after - 1, 0)
        span = np.maximum(known[after] - known[before], 1)
        is_between = (known[before] < inside) & (inside < known[after])
        in_gap = stamps[is_between & (span > self._max_gap_ns)]
        if len(in_gap):
            raise NoTransformError(f"{name} has a gap of more than max_gap at {in_gap[0]} ns")
        part = ((inside - known[before]) / span)[:, None]
        return pose_matrix(
            (1 - part) * translations[before] + part * translations[after],
            slerp(quaternions[before], quaternions[after], part[:, 0]),
        )

    def _path(self, target: str, source: str) -> _Path:
        """Edges from `target` to `source`, each with True if it leads from parent to child."""
        came: dict[str, tuple[str, tuple[str, str], bool] | None] = {target: None}
        queue = deque([target])
        while queue and source not in came:
            frame = queue.popleft()
            for key in self._edges:
                for here, there, forward in ((*key, True), (*key[::-1], False)):
                    if here == frame and there not in came:
                        came[there] = (frame, key, forward)
                        queue.append(there)
        if source not in came:
            raise NoTransformError(f"no transform connects {target!r} and {source!r}")
        path: _Path = []
        step = came[source]
        while step is not None:
            path.append((step[1], step[2]))
            step = came[step[0]]
        self._paths[target, source] = path[::-1]
        return self._paths[target, source]


def _inverse(matrices: NDArray[np.float64]) -> NDArray[np.float64]:
    rotation = np.swapaxes(matrices[:, :3, :3], 1, 2)
    result = np.zeros_like(matrices)
    result[:, :3, :3] = rotation
    result[:, :3, 3] = -np.einsum("kij,kj->ki", rotation, matrices[:, :3, 3])
    result[:, 3, 3] = 1
    return result
