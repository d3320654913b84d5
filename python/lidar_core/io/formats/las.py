"""LAS and LAZ files: one scan each."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_core.io.files.las import read_las
from lidar_core.io.formats.sequence import POINT, SequenceRecording
from lidar_core.io.readers import register_reader

FAR = 1000.0  # coordinates beyond are given from a nearer corner [m]


@register_reader("LAS", [".las", ".laz"], extra="io", folder="together")
class LasRecording(SequenceRecording):
    """LAS and LAZ files; coordinates are relative to a corner near the cloud, given as a pose.

    National grid coordinates have more digits than float32.
    """

    format = "LAS"

    def _rows(self, file: Path) -> NDArray[Any]:
        points, intensity = read_las(file, self.options)
        corner = self._corner(points)
        rows = np.empty(len(points), POINT)
        for axis, name in enumerate("xyz"):
            rows[name] = points[:, axis] - corner[axis]
        rows["intensity"] = intensity
        return rows

    def _find_poses(self) -> NDArray[np.float64]:
        with self._reading_one():
            corners = [self._corner(read_las(file, self.options)[0]) for file in self._files]
        if not np.any(corners):
            return np.empty((0, 4, 4))
        poses = np.tile(np.eye(4), (len(corners), 1, 1))
        poses[:, :3, 3] = corners
        return poses

    def _corner(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Origin of the scan: zero, or full kilometres near a far cloud."""
        lowest = points.min(axis=0) if len(points) else np.zeros(3)
        far = np.abs(lowest) > FAR
        return np.asarray(np.where(far, np.floor(lowest / FAR) * FAR, 0.0))
