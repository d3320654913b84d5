"""Configuration of one LiDAR, and the rays of some that are sold."""

import math
from collections.abc import Mapping
from typing import Annotated, ClassVar, Literal, Self, TypeAlias

from pydantic import Field

from lidar_core.config import Config
from lidar_core.errors import ConfigError
from lidar_core.flying.config_types import MOST_SCANS, Box
from lidar_core.sensors import SENSORS, Sensor, sensor_named

SPATIAL = tuple(name for name, sensor in SENSORS.items() if not sensor.is_planar)
"""Names of the 3D sensors."""
# Type checkers and editors cannot read the names from the presets; a test compares the two.
# fmt: off
Beams: TypeAlias = Literal[
    "auto", "given", "learnt",
    "os0-32", "os0-64", "os0-128", "os1-32", "os1-64", "os1-128", "os2-32", "os2-64", "os2-128",
    "vlp-16", "hdl-32e", "hdl-64e", "vls-128", "xt32", "pandar64", "qt128", "rs16",
    "livox-mid360", "livox-avia", "livox-hap", "livox-horizon",
]
# fmt: on

Turn = Annotated[float, Field(ge=-6.3, le=6.3)]
Elevation = Annotated[float, Field(ge=-1.6, le=1.6)]

BeamTable: TypeAlias = tuple[str, tuple[float, ...], int]
"""given or learnt; or rows with their elevations [rad] and the rays of each; or view with lowest
and highest elevation, largest azimuth [rad] and the rays of a scan."""


class SensorConfig(Config):
    """One LiDAR: its own robot in view, and the rays that its driver drops."""

    removed: ClassVar[Mapping[str, str]] = {
        "learn_mask_range": "the robot is looked for within 1 m",
    }
    min_range: float = Field(
        default=0.3, ge=0, le=20, description="Nearer returns are not used [m]."
    )
    self_box: Box | None = Field(
        default=None, description="Lower and upper corner of the robot, lidar frame [m]."
    )
    blind_sectors: tuple[tuple[Turn, Turn, Elevation, Elevation], ...] = Field(
        default=(),
        description="Directions that the robot hides: azimuth from, to, elevation from, to [rad].",
    )
    self_mask: tuple[bool, ...] | None = Field(
        default=None,
        description="Per point of the cloud: true where the ray hits the robot (no unit).",
    )
    learn_mask_scans: int = Field(
        default=10,
        ge=0,
        le=MOST_SCANS,
        description="First scans in which the directions towards the robot are learnt, 0 for none"
        " (count, no unit).",
    )
    mask_empty_only: bool = Field(
        default=False,
        description="Masks skip only rays without return (the authors' code), not all (no unit).",
    )
    find_body: bool = Field(
        default=True,
        description="Find the robot itself by returns that keep their place in the sensor's"
        " frame while the sensor moves, and that are joined to near returns: they"
        " are neither target nor background (no unit).",
    )
    beams: Beams | None = Field(
        default="auto",
        description="Source of the rays without return: auto, given with their directions or"
        " else found from the returns; given, never found; learnt, as auto; or the"
        " name of a sensor, found from the returns and its rays (no unit). None:"
        " given.",
    )
    beam_columns: int | None = Field(
        default=None,
        ge=8,
        le=36_000,
        description="Rays per turn of each of `beam_elevations`; none: 1800 (count, no unit).",
    )
    beam_elevations: tuple[Elevation, ...] = Field(
        default=(), description="Elevation of every row of a sensor that has no name here [rad]."
    )
    returns_per_ray: int = Field(
        default=1,
        ge=1,
        le=8,
        description="Returns per ray: the cloud is that many equal parts, one after another"
        " (count, no unit).",
    )

    @classmethod
    def preset(cls, name: str) -> Self:
        """Return a configuration for a 3D sensor of `lidar_core.sensors.SENSORS`.

        Raises
        ------
        ConfigError
            There is no such 3D sensor.
        """
        sensor = sensor_named(name)
        if sensor.is_planar:
            raise ConfigError(f"preset: expected a 3D LiDAR, got {name!r}")
        near = max(sensor.model.get("range_min", 0.0), cls().min_range)
        return cls.load({"min_range": near, "beams": name if sensor.drops_rays else "auto"})

    @classmethod
    def paper(cls) -> Self:
        """Return the paper's variant: all returns count, robot and sky are not searched for."""
        return cls(min_range=0.0, learn_mask_scans=0, beams=None, find_body=False)

    @property
    def beam_table(self) -> BeamTable:
        """Rays of the sensor, as `beams` and the given rows state them."""
        if self.beams in (None, "given"):
            return ("given", (), 0)
        if self.beam_elevations:
            return ("rows", tuple(sorted(self.beam_elevations)), self.beam_columns or 1800)
        if self.beams in BEAM_TABLES:
            return BEAM_TABLES[self.beams]
        return ("learnt", (), 0)

    @property
    def known_sensors(self) -> tuple[tuple[str, BeamTable], ...]:
        """Sensors that error messages may suggest."""
        return tuple(BEAM_TABLES.items())


def _table(sensor: Sensor) -> BeamTable:
    pattern = sensor.pattern
    if pattern["kind"] == "spinning":
        rows = sorted(math.radians(row) for row in pattern["elevations_deg"])
        return ("rows", tuple(rows), pattern["columns"])
    half = math.radians(pattern.get("azimuth_half_deg", 180.0))
    low, high = map(math.radians, pattern["elevation_deg"])
    return ("view", (low, high, half), pattern.get("rays", 20_000))


BEAM_TABLES: dict[str, BeamTable] = {name: _table(SENSORS[name]) for name in SPATIAL}
"""Rays of the 3D sensors, at 10 Hz."""
