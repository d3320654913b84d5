"""The run of `lidar-core detect`: what the shared job needs of the flying-object detector."""

from contextlib import AbstractContextManager
from typing import Any

from rich.console import Console

from lidar_core.cli.common import draw
from lidar_core.cli.flying_run import FlyingRun
from lidar_core.cli.recording_job import MCAP
from lidar_core.flying import FlyingFrame, FlyingObjectDetector
from lidar_core.io import McapWriter, PosedScan
from lidar_core.messages import Scan
from lidar_core.run_folder import RunFolder
from lidar_core.scan_processing import log_flying, sensor_name
from lidar_core.viz import draw_flying


class DetectRun(FlyingRun):
    """A `FlyingRun` that is written to run.mcap on the way, where that is wanted."""

    def __init__(self, detector: FlyingObjectDetector) -> None:
        super().__init__(detector)
        self._mcap: McapWriter | None = None

    def take(self, item: PosedScan[Scan]) -> None:
        """Process one scan."""
        self.process(item, sensor=sensor_name(item.scan))

    def keep(
        self, item: PosedScan[Scan], frame: FlyingFrame, wall_ms: float, *, sensor: str
    ) -> None:
        """Keep what a scan gave that took `wall_ms`, and write it to run.mcap."""
        super().keep(item, frame, wall_ms, sensor=sensor)
        if self._mcap is not None:
            log_flying(self._mcap, item, frame, frame_id=self.frame_id)

    def mcap(self, folder: RunFolder) -> AbstractContextManager[Any]:
        """Open run.mcap for what `take` gives from here on."""
        self._mcap = McapWriter(folder.path / MCAP, tracks_frame=self.frame_id)
        return self._mcap

    def draw(self, folder: RunFolder, name: str, console: Console) -> list[str]:
        """Draw picture.png."""
        view = self.view(f"{name}: {self.n_scans} scans, {len(self.track_ids)} tracks")
        path = folder.path / "picture.png"
        return draw([(path, lambda: draw_flying(view, path))], console)
