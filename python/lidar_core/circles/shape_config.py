"""Configuration of segments that are not circles."""

from collections.abc import Mapping
from typing import ClassVar

from pydantic import Field

from lidar_core.config import Config


class ShapeConfig(Config):
    """Selection of the shape of each segment, and of the shapes that enter the map of circles.

    Sources: the shapes are future work of the paper, sec. VII; the values are ours.
    """

    removed: ClassVar[Mapping[str, str]] = {
        "ellipses": "with enabled all shapes go into the map",
        "rectangles": "with enabled all shapes go into the map",
        "faces": "with enabled all shapes go into the map",
        "model_std": "outlines differ from circles by 3 cm",
        "min_hits": "circles beside something nearer have 6 rays at least",
    }
    enabled: bool = Field(
        default=True,
        description="Distinguish lines, rectangles and ellipses from circles, and keep them in the"
        " map as such. Off: every segment is a circle, as in the paper (no unit).",
    )
    max_size: float = Field(
        default=0.5,
        gt=0,
        le=20,
        description="Largest half length of an ellipse, rectangle or free standing line that is a"
        " circle of the map [m].",
    )
