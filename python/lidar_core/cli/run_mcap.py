"""A run as MCAP, for viewers: scans coloured by class, poses, tracks."""

from types import TracebackType
from typing import Self

import numpy as np

from lidar_core.cli.recording_job import MCAP
from lidar_core.flying import FlyingFrame
from lidar_core.io import McapWriter, PosedScan
from lidar_core.messages import Pose, Scan
from lidar_core.run_folder import RunFolder

CLASSES_TOPIC = "/classes"


class RunMcap:
    """Writes run.mcap scan by scan; a context manager.

    Clouds hold the points with information; their `intensity` is the class: 1 background,
    2 flying, 3 unknown.
    """

    def __init__(self, folder: RunFolder, *, frame_id: str) -> None:
        self._frame_id = frame_id
        self._writer = McapWriter(folder.path / MCAP, tracks_frame=frame_id)

    def __enter__(self) -> Self:
        self._writer.__enter__()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._writer.__exit__(kind, error, trace)

    def write(self, item: PosedScan[Scan], frame: FlyingFrame) -> None:
        """Append one scan and what the detector made of it."""
        if frame.rejected is not None:
            return
        scan = item.scan
        pose = item.world_from_lidar.reshape(-1, 4, 4)[0]
        if scan.frame_id != self._frame_id:
            self._writer.write(Pose(scan.stamp_ns, self._frame_id, scan.frame_id, pose))
        is_point = frame.point_class > 0
        classes = Scan(
            stamp_ns=scan.stamp_ns,
            points=scan.points.reshape(-1, 3)[is_point],
            frame_id=scan.frame_id,
            intensity=frame.point_class[is_point].astype(np.float32),
            topic=CLASSES_TOPIC,
        )
        self._writer.write(classes)
        self._writer.write(frame.tracks)
