"""Configuration of the datasets of single circles."""

from collections.abc import Mapping
from typing import Annotated, ClassVar, Literal, Self

from pydantic import Field, model_validator

from lidar_core.circles.scanner import Scanner
from lidar_core.config import Config

NotNegative = Annotated[float, Field(ge=0, le=1)]
Radius = Annotated[float, Field(gt=0, le=10)]


class DatasetConfig(Config):
    """Circles in front of a scanner, and disturbances of its view; the defaults are the paper's.

    Ranges of values, as `range_std`, are drawn from uniformly, once per sample. Source:
    Sanchez-Lopez et al., sec. IV-B, Table II.

    Examples
    --------
    >>> DatasetConfig.continuous(circles=1000).split_by
    'circle'
    """

    removed: ClassVar[Mapping[str, str]] = {
        "mixed_depth": "a ray that hits circle and background ends up to 0.1 m behind the circle",
        "cut_margins": "samples have the margins with which scans are segmented",
    }
    kind: Literal["lattice", "continuous"] = Field(
        default="lattice",
        description="Circles on a lattice as published, or anywhere (no unit).",
    )
    scanner: Scanner = Field(default=Scanner(), description="Scanner that measures the circles.")
    reach: float = Field(
        default=10.0,
        gt=0,
        le=1000,
        description="Centres lie within this of the scanner in x and y [m].",
    )
    spacing: float = Field(
        default=0.05, gt=0, le=10, description="Lattice: step between centres [m]."
    )
    radius: tuple[Radius, Radius] = Field(
        default=(0.05, 0.5), description="Smallest and largest radius [m], above 0, in order."
    )
    radius_step: float = Field(
        default=0.05, gt=0, le=10, description="Lattice: step between radii [m]."
    )
    draws: int = Field(
        default=2,
        ge=1,
        le=1000,
        description="Lattice: measurements of every circle (count, no unit).",
    )
    circles: int = Field(
        default=1_000_000,
        ge=1,
        le=1_000_000_000,
        description="Continuous: how many, one measurement of each (count, no unit).",
    )
    range_std: tuple[NotNegative, NotNegative] = Field(
        default=(0.01, 0.01), description="Standard deviation of a range, from and to [m], >= 0."
    )
    beam_half_width: tuple[NotNegative, NotNegative] = Field(
        default=(0.0, 0.0), description="Half the width of a ray, from and to [rad], >= 0."
    )
    occluded_share: float = Field(
        default=0.0,
        ge=0,
        le=1,
        description="Share of samples partly hidden by something (no unit).",
    )
    mixed_share: float = Field(
        default=0.0,
        ge=0,
        le=1,
        description="Share of edges of circles where a ray hits circle and background, so that it"
        " ends up to 0.1 m behind the circle (no unit).",
    )
    split_by: Literal["sample", "circle"] = Field(
        default="sample",
        description="Unit of the split into training, validation and test: samples as"
        " published, which puts measurements of one circle into several parts, or"
        " circles (no unit).",
    )
    validation_share: float = Field(
        default=0.16, ge=0, lt=1, description="Share of samples for validation, Table II (no unit)."
    )
    test_share: float = Field(
        default=0.2, ge=0, lt=1, description="Share of samples for the test, Table II (no unit)."
    )
    shard_size: int = Field(
        default=65_536, ge=1, le=10_000_000, description="Samples per file (count, no unit)."
    )

    @classmethod
    def continuous(cls, *, circles: int) -> Self:
        """Return a configuration with circles anywhere, each in only one part of the dataset."""
        return cls(kind="continuous", circles=circles, draws=1, split_by="circle")

    @model_validator(mode="after")
    def _is_in_order(self) -> Self:
        if self.radius[0] > self.radius[1]:
            raise ValueError(f"expected 0 < radius[0] <= radius[1], got {self.radius}")
        for name in ("range_std", "beam_half_width"):
            low, high = getattr(self, name)
            if low > high:
                raise ValueError(f"expected {name} from and to in order, got {low}, {high}")
        if self.validation_share + self.test_share >= 1:
            raise ValueError("expected validation_share + test_share < 1")
        if self.kind == "continuous" and self.draws != 1:
            raise ValueError("expected draws = 1 where kind is continuous")
        return self
