"""Round obstacles in 2D scans: from one sweep of ranges to a map of circles with identities."""

from lidar_core.circles.config import CirclesConfig
from lidar_core.circles.dataset_config import DatasetConfig
from lidar_core.circles.estimators.detector import CircleDetector
from lidar_core.circles.estimators.fit_config import FitConfig
from lidar_core.circles.estimators.fitting import Circles, fit_circles
from lidar_core.circles.estimators.network import CircleNetwork
from lidar_core.circles.estimators.trust import trust_model
from lidar_core.circles.mapping.map import CircleMap, MapEvents
from lidar_core.circles.mapping.map_config import CircleMapConfig
from lidar_core.circles.pipeline import CirclePipeline
from lidar_core.circles.preprocess import limit_range, project_horizontal
from lidar_core.circles.results import CircleFrame, CirclesHealth
from lidar_core.circles.samples import Samples, make_samples
from lidar_core.circles.scan_config import PreprocessConfig, SegmentConfig
from lidar_core.circles.scanner import Scanner
from lidar_core.circles.segmentation import Segments, Side, segment
from lidar_core.circles.shape_config import ShapeConfig
from lidar_core.circles.shapes import Shapes, fit_shapes
from lidar_core.messages import ShapeKind
from lidar_core.objects import CircleElements, ShapeElements

__all__ = [
    "CircleDetector",
    "CircleElements",
    "CircleFrame",
    "CircleMap",
    "CircleMapConfig",
    "CircleNetwork",
    "CirclePipeline",
    "Circles",
    "CirclesConfig",
    "CirclesHealth",
    "DatasetConfig",
    "FitConfig",
    "MapEvents",
    "PreprocessConfig",
    "Samples",
    "Scanner",
    "SegmentConfig",
    "Segments",
    "ShapeConfig",
    "ShapeElements",
    "ShapeKind",
    "Shapes",
    "Side",
    "fit_circles",
    "fit_shapes",
    "limit_range",
    "make_samples",
    "project_horizontal",
    "segment",
    "trust_model",
]


def __dir__() -> list[str]:
    return __all__
