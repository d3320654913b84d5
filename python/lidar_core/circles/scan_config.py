"""Configuration of the steps before circles are fitted."""

from collections.abc import Mapping
from typing import ClassVar, Literal, Self

from pydantic import Field, model_validator

from lidar_core.config import Config
from lidar_core.errors import ConfigError

Plane = tuple[float, float, float, float]


class PreprocessConfig(Config):
    """Range limitation and horizontal projection. Source: Sanchez-Lopez et al., secs. III-A, B."""

    planes: tuple[Plane, ...] = Field(
        default=(),
        max_length=64,
        description="Operating volume: where a x + b y + c z <= d [m] for each (a, b, c, d), world"
        " frame, eq. 4; empty: everywhere.",
    )
    projection: Literal["exact", "paper"] = Field(
        default="exact",
        description="Tilted scans: every point as seen from above, which moves bearings as well,"
        " or ranges by cos(pitch) cos(roll) as in eq. 5 (no unit).",
    )

    @classmethod
    def paper(cls) -> Self:
        """Return the configuration with eq. 5 as published."""
        return cls(projection="paper")

    @model_validator(mode="after")
    def _has_normals(self) -> Self:
        for number, plane in enumerate(self.planes):
            if not any(plane[:3]):
                raise ValueError(f"expected planes with (a, b, c) not all 0, got planes.{number}")
        return self

    @classmethod
    def box(cls, lower: tuple[float, float, float], upper: tuple[float, float, float]) -> Self:
        """Return a configuration with an operating volume between two corners [m], world frame.

        Raises
        ------
        ConfigError
            A corner does not have three values, or `lower` is not below `upper` along all axes.

        Examples
        --------
        >>> flight_arena = PreprocessConfig.box((-2.5, -3, 0.1), (2.5, 3, 5))  # the paper's
        >>> len(flight_arena.planes)
        6
        """
        is_box = len(lower) == len(upper) == 3
        if not (is_box and all(low < high for low, high in zip(lower, upper, strict=True))):
            raise ConfigError(
                "box: expected three values each, lower < upper along every axis, got lower"
                f" {tuple(lower)} and upper {tuple(upper)}"
            )
        planes: list[Plane] = []
        for axis in range(3):
            normal = [0.0, 0.0, 0.0]
            normal[axis] = 1.0
            x, y, z = normal
            planes += [(x, y, z, upper[axis]), (-x, -y, -z, -lower[axis])]
        return cls(planes=tuple(planes))


class SegmentConfig(Config):
    """Object segmentation: rays that ended on the same object.

    Source: Sanchez-Lopez et al., sec. III-C, eq. 6; the adaptive bound is that of Borges & Aldon,
    "Line Extraction in 2D Range Images for Mobile Robotics", 2004.
    """

    removed: ClassVar[Mapping[str, str]] = {
        "criterion": "neighbours are close in polar and in Cartesian space",
        "merge_deviation": "merged parts lie within 3 cm of one circle or line",
        "corner_width": "walls at a corner end 1.2 m apart at least",
        "near_margin": "objects within 0.15 m of the nearest range may go on below it",
        "far_margin": "objects within 1.2 m of the farthest range may go on beyond it",
        "incidence": "surfaces are met at 10 deg at least",
    }
    bound: Literal["adaptive", "fixed"] = Field(
        default="adaptive",
        description="Largest distance of neighbours: as the angle between rays on a surface"
        " allows, or `distance` everywhere (no unit).",
    )
    slack: float = Field(
        default=0.09,
        ge=0,
        le=3,
        description="Addition to the adaptive bound for the noise of the ranges, at least"
        " three of their standard deviations [m].",
    )
    distance: float = Field(
        default=0.2, gt=0, le=10, description="Distance of neighbours with the fixed bound [m]."
    )
    max_gap: int = Field(
        default=2,
        ge=0,
        le=1000,
        description="Rays without return that neighbours may have between them, polar space"
        " (count, no unit).",
    )
    merge_distance: float = Field(
        default=0.5,
        ge=0,
        le=10,
        description="Parts of a surface that something nearer hides in part are one object if"
        " their ends are closer than this [m]; 0: never.",
    )
    corner_depth: float = Field(
        default=0.15,
        ge=0,
        le=10,
        description="Surfaces with a common corner are separate segments if the corner is this deep"
        " behind the line between their other ends [m]; 0: never, as in the paper.",
    )
    min_points: int = Field(
        default=4, ge=1, le=100_000, description="Smaller segments are dropped (count, no unit)."
    )
    min_fraction: float = Field(
        default=0.0,
        ge=0,
        le=1,
        description="Segments with a smaller share of all rays are dropped (share, no unit);"
        " paper: 0.003.",
    )

    @classmethod
    def paper(cls) -> Self:
        """Return the published values: one distance in both spaces, 0.3 % of rays, one pass.

        The distance is not given; the default splits 0.04 % of the paper's circles.
        """
        return cls(
            bound="fixed",
            max_gap=0,
            merge_distance=0.0,
            corner_depth=0.0,
            min_points=1,
            min_fraction=0.003,
        )
