"""Configuration of one LiDAR, and the rays of some that are sold."""

import math
from typing import Literal, Self, TypeAlias

from pydantic import Field, model_validator

from lidar_core.config import Config
from lidar_core.errors import ConfigError
from lidar_core.flying.config_types import MOST_SCANS, Box
from lidar_core.sensors import SENSORS, sensor_named

BeamPreset: TypeAlias = Literal[
    "os0-32", "os0-64", "os0-128", "os1-32", "os1-64", "os1-128", "os2-32", "os2-64", "os2-128",
    "vlp-16", "hdl-32e", "hdl-64e", "vls-128", "xt32", "pandar64", "qt128", "learnt",
]  # fmt: skip
"""Sensors with rows that turn, and rows that are learnt."""


class SensorConfig(Config):
    """One LiDAR: its own robot in view, and the rays that its driver drops."""

    min_range: float = Field(0.3, ge=0, le=20, description="Nearer returns are not used [m].")
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
        le=20,
        description="Where returns keep coming from nearer than this, there is the robot: they,"
        " and rays without return in their directions, are not used [m].",
    )
    mask_empty_only: bool = Field(
        False,
        description="Masks skip only rays without return (the authors' code), not all (no unit).",
    )
    beams: BeamPreset | None = Field(
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

    @classmethod
    def preset(cls, name: str) -> Self:
        """What differs from the defaults for a 3D sensor of `lidar_core.sensors.SENSORS`.

        Raises
        ------
        ConfigError
            There is no such 3D sensor.
        """
        sensor = sensor_named(name)
        if sensor.is_planar:
            raise ConfigError(f"preset: expected a 3D LiDAR, got {name!r}")
        near = max(sensor.model.get("range_min", 0.0), cls().min_range)
        return cls.load({"min_range": near, "beams": name if sensor.drops_rays else None})

    @classmethod
    def paper(cls) -> Self:
        """Every return is used, however near, and no mask is learnt: the paper has neither."""
        return cls(min_range=0.0, learn_mask_scans=0)

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
    **{
        name: (sensor.pattern["columns"], tuple(sorted(sensor.pattern["elevations_deg"])))
        for name, sensor in SENSORS.items()
        if sensor.pattern["kind"] == "spinning"
    },
    "learnt": (1800, ()),
}
"""Rays per revolution at 10 Hz and elevations, lowest first [deg]."""
