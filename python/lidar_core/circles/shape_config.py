"""What becomes of segments that are no circles."""

from pydantic import Field

from lidar_core.config import Config


class ShapeConfig(Config):
    """Which shape each segment has, and which shapes go into the map of circles.

    Sources: the shapes are future work of the paper, sec. VII; the values are ours.
    """

    enabled: bool = Field(
        True,
        description="Distinguish lines, rectangles and ellipses from circles, and keep them in the"
        " map as such. Off: every segment is a circle, as in the paper (no unit).",
    )
    ellipses: bool = Field(
        True,
        description="Ellipses go into the map; up to `max_size` also as the circle of the mean half"
        " length: a person stays one object (no unit).",
    )
    rectangles: bool = Field(True, description="Same of rectangles (no unit).")
    faces: bool = Field(
        True,
        description="Lines up to that half length that stand free at both ends go into the map as"
        " a circle behind them: one side of a box (no unit).",
    )
    max_size: float = Field(
        0.5,
        gt=0,
        le=20,
        description="Largest half length of an ellipse, rectangle or free standing line that is a"
        " circle of the map [m].",
    )
    model_std: float = Field(
        0.03,
        gt=0,
        le=1,
        description="Standard deviation of the distance between the outline of such an object and"
        " the circle that represents it, added to its covariance [m].",
    )
    min_hits: int = Field(
        6,
        ge=1,
        description="A circle of fewer rays that ends at something nearer is an object only if"
        " nothing is behind its other end: else it is a piece of a wall, as other shapes are with"
        " any number (count, no unit).",
    )
