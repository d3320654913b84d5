"""Reflection of light by surfaces: dark, wet and glossy surfaces, glass."""

from typing import TypeAlias

from pydantic import Field

from lidar_core.config import Config

__all__ = [
    "ASPHALT",
    "CONCRETE",
    "DARK",
    "GLASS",
    "GLOSSY",
    "LEAVES",
    "PLASTIC",
    "WET",
]


class Surface(Config):
    """Shares of the light that hits a surface.

    Scattered light falls with the cosine of incidence and the square of the range. It is detected
    if it exceeds the light of a surface of reflectivity 0.1, hit head-on at `range_max`: data
    sheets state ranges of LiDARs for that. The mirrored share grows from `mirror` to 1 at grazing
    incidence (Schlick 1994): the ray goes on, and its return appears straight ahead at the length
    of the whole path. A surface without values returns every ray.
    """

    reflectivity: float = Field(
        default=0.3, ge=0, le=100, description="Share scattered back at normal incidence (no unit)."
    )
    mirror: float = Field(
        default=0.0,
        ge=0,
        le=1,
        description="Share mirrored at normal incidence; 0: never (no unit).",
    )
    clear: float = Field(
        default=0.0,
        ge=0,
        le=1,
        description="Share of the light that is not mirrored and passes through (no unit).",
    )


CONCRETE = Surface(reflectivity=0.35)
ASPHALT = Surface(reflectivity=0.15)
LEAVES = Surface(reflectivity=0.3)
PLASTIC = Surface(reflectivity=0.2)
"""Surface of drones."""
DARK = Surface(reflectivity=0.02)
"""Black walls and cars: returns from near by only."""
WET = Surface(reflectivity=0.04, mirror=0.02)
"""Wet asphalt: water mirrors what it meets at a grazing angle."""
GLOSSY = Surface(reflectivity=0.08, mirror=0.05)
"""Polished paint and stone."""
GLASS = Surface(reflectivity=0.01, mirror=0.08, clear=0.95)
"""Windows: most light passes, some is mirrored, hardly any comes back."""

Answers: TypeAlias = list[Surface | None]
"""Optical properties of each surface of a scene; None: every ray that hits the surface returns."""


def __dir__() -> list[str]:
    return __all__
