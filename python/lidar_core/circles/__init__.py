"""Round obstacles in 2D scans: from one sweep of ranges to a map of circles with identities."""

from lidar_core.circles.dataset_config import DatasetConfig
from lidar_core.circles.map import CircleElements, CircleMap, MapEvents
from lidar_core.circles.map_config import CircleMapConfig
from lidar_core.circles.preprocess import limit_range, project_horizontal
from lidar_core.circles.samples import Samples, make_samples
from lidar_core.circles.scan_config import PreprocessConfig, SegmentConfig
from lidar_core.circles.scanner import Scanner
from lidar_core.circles.segmentation import Segments, Side, segment

__all__ = [
    "CircleElements",
    "CircleMap",
    "CircleMapConfig",
    "DatasetConfig",
    "MapEvents",
    "PreprocessConfig",
    "Samples",
    "Scanner",
    "SegmentConfig",
    "Segments",
    "Side",
    "limit_range",
    "make_samples",
    "project_horizontal",
    "segment",
]
