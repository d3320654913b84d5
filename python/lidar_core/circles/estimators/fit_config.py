"""Configuration of the fit of circles to rays."""

from typing import Literal, Self, TypeAlias

from pydantic import Field, model_validator

from lidar_core.config import Config

FitMethod: TypeAlias = Literal["ml", "mode", "taubin", "pratt", "kasa"]
"""Ways of fitting a circle."""


class FitConfig(Config):
    """Fit of circles to groups of rays.

    "ml" and "mode" compare circles with the ranges and with the rays that passed beside the object;
    "ml" reports the expected circle, "mode" the most likely one. "taubin", "pratt" and "kasa" are
    algebraic fits to the points.
    """

    method: FitMethod = Field(
        default="ml",
        description="Fit of a circle (no unit): the expected or the most likely circle under"
        " the likelihood of ranges and misses; or an algebraic fit to the points.",
    )
    range_std: float = Field(
        default=0.01,
        gt=0,
        le=0.5,
        description="Standard deviation of a range [m]; the pipeline replaces it in best mode once"
        " its scans show another one. Source: sec. IV-A.",
    )
    beam_half_width: float = Field(
        default=0.0,
        ge=0,
        lt=0.1,
        description="Half the width of a beam as far as a surface returns it: a circle seems"
        " wider by it on both sides [rad].",
    )
    min_radius: float = Field(default=0.02, gt=0, le=20, description="Smallest radius [m].")
    max_radius: float = Field(
        default=1.0,
        gt=0,
        le=50,
        description="Largest radius [m]. Where shapes are distinguished, a circle of which a side"
        " is seen may be three times as large.",
    )
    usual_radius: float = Field(
        default=0.5,
        gt=0,
        le=20,
        description="Circles up to this radius are all as likely, of larger ones the probability"
        ' falls with its eighth power; for "ml" [m]. Source: sec. IV-A.',
    )

    @model_validator(mode="after")
    def _radii_are_ordered(self) -> Self:
        if self.min_radius >= self.max_radius:
            raise ValueError("expected min_radius < max_radius")
        return self
