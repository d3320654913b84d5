"""The run of `lidar-core detect`: what the shared job needs of the flying-object detector."""

from contextlib import AbstractContextManager
from typing import Any

from rich.console import Console

from lidar_core.cli.common import draw
from lidar_core.cli.flying_run import FlyingRun
from lidar_core.cli.run_mcap import RunMcap
from lidar_core.flying import FlyingObjectDetector
from lidar_core.io import PosedScan
from lidar_core.messages import Scan
from lidar_core.run_folder import RunFolder
from lidar_core.viz import draw_flying


class DetectRun(FlyingRun):
    """A `FlyingRun` on a recording, written to run.mcap on the way where that is wanted."""

    def __init__(self, detector: FlyingObjectDetector) -> None:
        super().__init__(detector)
        self._mcap: RunMcap | None = None

    def take(self, item: PosedScan[Scan]) -> None:
        """Process one scan."""
        sensor = item.scan.topic or item.scan.frame_id
        frame = self.process(item.scan, item.world_from_lidar, item.pose_stamps_ns, sensor=sensor)
        if self._mcap is not None:
            self._mcap.write(item, frame)

    def mcap(self, folder: RunFolder) -> AbstractContextManager[Any]:
        """Open run.mcap for what `take` gives from here on."""
        self._mcap = RunMcap(folder, frame_id=self.frame_id)
        return self._mcap

    def draw(self, folder: RunFolder, name: str, console: Console) -> list[str]:
        """Draw picture.png."""
        view = self.view(f"{name}: {self.n_scans} scans, {len(self.track_ids)} tracks")
        path = folder.path / "picture.png"
        return draw([(path, lambda: draw_flying(view, path))], console)
