"""Configuration of one LiDAR, and the rays of some that are sold."""

import math
from typing import Literal

from pydantic import Field, model_validator

from lidar_core.config import Config
from lidar_core.flying.config_types import MOST_SCANS, Box


class SensorConfig(Config):
    """One LiDAR: its own robot in view, and the rays that its driver drops."""

    min_range: float = Field(0.3, ge=0, description="Nearer returns are not used [m].")
    self_box: Box | None = Field(
        None, description="Lower and upper corner of the robot, lidar frame [m]."
    )
    blind_sectors: tuple[tuple[float, float, float, float], ...] = Field(
        (),
        description="Directions that the robot hides: azimuth from, to, elevation from, to [rad].",
    )
    self_mask: tuple[bool, ...] | None = Field(
        None, description="Per point of the cloud: true where the ray hits the robot (no unit)."
    )
    learn_mask_scans: int = Field(
        10,
        ge=0,
        le=MOST_SCANS,
        description="First scans in which the directions towards the robot are learnt, 0 for none"
        " (count, no unit).",
    )
    learn_mask_range: float = Field(
        1.0,
        gt=0,
        description="Where returns keep coming from nearer than this, there is the robot: they,"
        " and rays without return in their directions, are not used [m].",
    )
    mask_empty_only: bool = Field(
        False,
        description="Masks skip only rays without return (the authors' code), not all (no unit).",
    )
    beams: Literal["vlp-16", "hdl-32e", "hdl-64e", "learnt"] | None = Field(
        None,
        description="Rays of a sensor whose driver drops those without return: a preset, or learnt"
        " from the points (no unit). None: such rays are given, or open sky is not cleared.",
    )
    beam_columns: int | None = Field(
        None,
        ge=8,
        le=36_000,
        description="Rays per revolution of each row, if `beams` is set; none: the preset's"
        " (count, no unit).",
    )
    beam_elevations: tuple[float, ...] = Field(
        (), description="Elevation of every row, instead of a preset [rad]."
    )
    returns_per_ray: int = Field(
        1,
        ge=1,
        le=8,
        description="Returns per ray: the cloud is that many equal parts, one after another"
        " (count, no unit).",
    )

    @model_validator(mode="before")
    @classmethod
    def _fill_preset(cls, values: dict[str, object]) -> dict[str, object]:
        preset = BEAM_PRESETS.get(str(values.get("beams")))
        if preset is None:
            return values
        columns, elevations_deg = preset
        filled = {
            "beam_columns": columns,
            "beam_elevations": tuple(round(math.radians(row), 6) for row in elevations_deg),
        }
        given = {name: value for name, value in values.items() if value not in (None, ())}
        return values | filled | given


BEAM_PRESETS: dict[str, tuple[int, tuple[float, ...]]] = {
    "vlp-16": (1800, tuple(range(-15, 16, 2))),
    "hdl-32e": (2170, tuple(-30.67 + 41.34 * row / 31 for row in range(32))),
    "hdl-64e": (
        2083,
        (
            *(-24.33 + row * (24.33 - 8.83) / 31 for row in range(32)),
            *(-8.33 + row * (8.33 + 2.0) / 31 for row in range(32)),
        ),
    ),
    "learnt": (1800, ()),
}
"""Rays per revolution at 10 Hz and elevations [deg], after the manufacturers' data sheets."""
