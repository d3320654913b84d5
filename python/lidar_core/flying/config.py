"""Configuration of the flying-object detector: the only source of defaults and ranges."""

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from lidar_core.config import Config

Corner = tuple[float, float, float]


class VoxelMapConfig(Config):
    """Occupancy of voxels, exponential filter G(v), which has no unit.

    Source: Vrba et al., eqs 6-12 and 20-22; defaults: Table II.
    """

    voxel_size: float = Field(0.25, gt=0, description="Edge of a voxel, v_s [m].")
    g_occ: float = Field(0.0, description="G that background points pull a voxel to (no unit).")
    g_unk: float = Field(-740.0, description="Same for unknown and flying points (no unit).")
    g_free: float = Field(-1000.0, description="Same for rays (no unit).")
    initial: float = Field(-740.0, description="G of a voxel never observed (no unit).")
    threshold_confident: float = Field(-0.1, description="Occupied from here up (no unit).")
    threshold_tentative: float = Field(-300.0, description="Tentative from here up (no unit).")
    threshold_uncertain: float = Field(
        -750.0, description="Uncertain from here up, free below (no unit)."
    )
    extra_thresholds: tuple[float, ...] = Field(
        (), max_length=16, description="Further levels that `state_at` counts, eq. 6 (no unit)."
    )
    max_range: float = Field(
        20.0, gt=0, description="Rays clear no further than this, d_max of eq. 20 [m]."
    )
    end_margin: float = Field(
        0.0, ge=0, description="Rays that hit something end this much earlier [m]."
    )
    ray_unit: Literal["edges", "metres", "diagonals"] = Field(
        "edges",
        description="Length unit of the ray weight of eq. 22: voxel edges, metres (the paper's"
        " text) or voxel diagonals (no unit).",
    )
    ray_gain: float = Field(1.0, gt=0, description="Factor on the ray weight (no unit).")
    bounds: tuple[Corner, Corner] | None = Field(
        None, description="Lower and upper corner of a fixed operating volume [m]; none: no bounds."
    )
    max_voxels: int = Field(
        200_000_000, gt=0, description="Budget of stored voxels, 4.3 bytes each (count, no unit)."
    )

    @model_validator(mode="after")
    def _levels_are_ordered(self) -> Self:
        levels = [
            self.g_free,
            self.threshold_uncertain,
            self.g_unk,
            self.threshold_tentative,
            self.threshold_confident,
            self.g_occ,
        ]
        if levels != sorted(levels):
            raise ValueError(
                "expected g_free <= threshold_uncertain <= g_unk"
                " <= threshold_tentative <= threshold_confident <= g_occ"
            )
        return self
