"""Configuration of the fit of circles to rays."""

from typing import Literal, Self, TypeAlias

from pydantic import Field, model_validator

from lidar_core.config import Config

FitMethod: TypeAlias = Literal["ml", "mode", "taubin", "pratt", "kasa"]
"""Ways of fitting a circle."""


class FitConfig(Config):
    """Fit of circles to groups of rays.

    "ml" and "mode" compare circles with the ranges and with the rays that passed beside the object.
    "ml" reports the mean of all possible circles, weighted by their probability. "mode" reports the
    circle with the largest likelihood. "taubin", "pratt" and "kasa" are algebraic fits to the
    points.
    """

    method: FitMethod = Field(
        default="ml",
        description="Method of the circle fit (no unit). ml: mean of all possible circles, weighted"
        " by their probability given the ranges and the rays that passed beside the object; mode:"
        " circle with the largest likelihood; taubin, pratt, kasa: algebraic fit to the points.",
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
        description="Half the width of a beam [rad]: a circle returns every beam that it reaches"
        " into, so it appears wider by this angle on both sides.",
    )
    min_radius: float = Field(default=0.02, gt=0, le=20, description="Smallest radius [m].")
    max_radius: float = Field(
        default=1.0,
        gt=0,
        le=50,
        description="Largest radius [m]. Where shapes are distinguished, the limit is three times"
        " as large for a circle beside which free space is visible.",
    )
    usual_radius: float = Field(
        default=0.5,
        gt=0,
        le=20,
        description="Radius up to which all radii have the same prior probability; above it, the"
        ' probability falls with the eighth power of the radius; used by "ml" only [m].'
        " Source: sec. IV-A.",
    )

    @model_validator(mode="after")
    def _radii_are_ordered(self) -> Self:
        if self.min_radius >= self.max_radius:
            raise ValueError("expected min_radius < max_radius")
        return self
