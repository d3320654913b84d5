"""Pipelines for streams; each is made when the first scans are known."""

from abc import ABC, abstractmethod
from typing import Generic

from lidar_core.circles import CirclePipeline, CirclesConfig, Scanner
from lidar_core.circles.scan_layout import check_no_rays, scanner_of
from lidar_core.flying import FlyingObjectDetector
from lidar_core.live.outputs.update import CirclesUpdate, FlyingUpdate, LiveCapability, Update
from lidar_core.messages import LaserScan, PosedScan, Scan, ScanT

__all__ = ["CirclesLive", "FlyingLive", "LivePipeline"]


class LivePipeline(ABC, Generic[ScanT]):
    """Pipeline for posed scans of one kind.

    Attributes
    ----------
    capability : str
        Capability of the pipeline.
    sort : type
        `Scan` or `LaserScan`.
    """

    capability: LiveCapability
    sort: type[ScanT]

    def is_ready(self, scan: ScanT) -> bool:
        """Look at a scan before `take`; return False while scans of other LiDARs are missing."""
        del scan
        return True

    @abstractmethod
    def take(self, item: PosedScan[ScanT], frame_id: str) -> Update | str:
        """Process one scan; return the reason if it was rejected."""


class FlyingLive(LivePipeline[Scan]):
    """Live pipeline of flying objects.

    Parameters
    ----------
    detector : FlyingObjectDetector
        Detector that gets every scan.
    """

    capability = "flying"
    sort = Scan

    def __init__(self, detector: FlyingObjectDetector) -> None:
        self.detector = detector

    def take(self, item: PosedScan[Scan], frame_id: str) -> Update | str:
        """Process one scan."""
        frame = self.detector.process(item)
        return frame.rejected or FlyingUpdate(item, frame, frame_id)


class CirclesLive(LivePipeline[LaserScan]):
    """Live pipeline of circles; the scanners are those of the stream.

    Parameters
    ----------
    config : CirclesConfig
        Configuration; its `scanner` limits the ranges.
    n_scanners : int
        LiDARs of which a scan has to be known before the first one is taken.

    Attributes
    ----------
    pipeline : CirclePipeline or None
        Pipeline that gets every scan; None until all LiDARs are known.
    config : CirclesConfig
    allow_untrusted : bool
        True if untrusted models may run.

    Raises
    ------
    ConfigError
        The configuration states rays that the scans would override.
    """

    capability = "circles"
    sort = LaserScan

    def __init__(
        self, config: CirclesConfig, *, n_scanners: int, allow_untrusted: bool = False
    ) -> None:
        check_no_rays(config)
        self.allow_untrusted = allow_untrusted
        self.config = config
        self._n_scanners = n_scanners
        self._found: dict[str, Scanner] = {}
        self.pipeline: CirclePipeline | None = None

    def is_ready(self, scan: LaserScan) -> bool:
        """Register the scanner of a scan; make the pipeline once all LiDARs are known.

        Raises
        ------
        FormatError
            Scans that no pipeline can use.
        """
        if self.pipeline is None:
            name = scan.topic or scan.frame_id
            if name not in self._found:
                self._found[name] = scanner_of(scan, self.config, name)
            if len(self._found) >= self._n_scanners:
                scanners = {**self._found, **self.config.scanners}
                values = self.config.model_dump() | {"scanners": scanners}
                self.pipeline = CirclePipeline(
                    type(self.config).load(values), allow_untrusted=self.allow_untrusted
                )
        return self.pipeline is not None

    def take(self, item: PosedScan[LaserScan], frame_id: str) -> Update | str:
        """Process one scan."""
        if self.pipeline is None:
            return "scans of other LiDARs are missing"
        frame = self.pipeline.process(item)
        return frame.rejected or CirclesUpdate(item, frame, frame_id)


def __dir__() -> list[str]:
    return __all__
