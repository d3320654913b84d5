"""Configuration of the evaluation: the only source of its defaults and ranges."""

from pydantic import Field

from lidar_core.config import Config


class EvaluationConfig(Config):
    """What counts as found, and which targets had to be found."""

    gate: float = Field(
        1.0, gt=0, description="An estimate further from every target's centre is false [m]."
    )
    max_distance: float = Field(
        20.0, gt=0, description="Targets further from the sensor need not be found [m]."
    )
    min_hits: int = Field(
        3, ge=0, description="Targets with fewer points need not be found (count, no unit)."
    )
