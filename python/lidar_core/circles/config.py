"""Configuration of the circle pipeline: the only source of its defaults and ranges."""

from typing import Annotated, Any, Literal, Self, TypeAlias

from pydantic import BeforeValidator, Field

from lidar_core.circles.estimators.detector_name import checked
from lidar_core.circles.estimators.fit_config import FitConfig, FitMethod
from lidar_core.circles.mapping.map_config import CircleMapConfig
from lidar_core.circles.scan_config import PreprocessConfig, SegmentConfig
from lidar_core.circles.scanner import Scanner
from lidar_core.circles.shape_config import ShapeConfig
from lidar_core.config import Config

NetworkName: TypeAlias = Annotated[str, Field(pattern=r"^(cnn|paper-cnn|.+\.onnx)$")]
"""A network that comes with the package, or an ONNX file."""


class CirclesConfig(Config):
    """Configuration from 2D scans to the map: `CirclesConfig()` is best mode, `.paper()` the paper.

    Source: Sanchez-Lopez et al., "Deep learning based semantic situation awareness system for
    multirotor aerial robots using LIDAR", 2019, secs. III-V.
    """

    scanner: Scanner = Field(
        default=Scanner(), description="2D LiDARs that `scanners` does not name (no unit)."
    )
    scanners: dict[str, Scanner] = Field(
        default={}, description="2D LiDARs by the name that `process` is given (no unit)."
    )
    detector: Annotated[FitMethod | NetworkName, BeforeValidator(checked)] = Field(
        default="ml",
        description="Estimator of circles from segments (no unit); it overrides `fit.method`."
        " Also a network: one of the package, or an .onnx file.",
    )
    preprocess: PreprocessConfig = PreprocessConfig()
    segment: SegmentConfig = SegmentConfig()
    fit: FitConfig = FitConfig()
    max_deviation: float = Field(
        default=0.08,
        gt=0,
        description="Segments with a larger root mean square distance of their hits from the"
        " circle, or from the shape that they have, stay out of the map [m].",
    )
    shapes: ShapeConfig = ShapeConfig()
    map: CircleMapConfig = CircleMapConfig()
    on_bad_scan: Literal["raise", "count"] = Field(
        default="raise", description="Reaction to a scan that cannot be used (no unit)."
    )

    @classmethod
    def posts(cls, **changes: Any) -> Self:
        """Best mode for trees, columns and poles, with given changes: see `CircleMapConfig`."""
        return cls(**{"map": CircleMapConfig.posts(), **changes})

    @classmethod
    def paper(cls, **changes: Any) -> Self:
        """The stages as published, with given changes.

        Circles come from the paper's network, which was trained for the paper's scanner: a pipeline
        with another scanner raises ConfigError. `CirclesConfig.paper(detector="taubin")` has all
        other stages as published and works with any scanner.
        """
        paper = {
            "detector": "paper-cnn",
            "preprocess": PreprocessConfig.paper(),
            "segment": SegmentConfig.paper(),
            "max_deviation": 1e6,
            "shapes": ShapeConfig(enabled=False),
            "map": CircleMapConfig.paper(),
        }
        return cls(**paper | changes)
