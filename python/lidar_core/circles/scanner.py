"""Rays and range limits of a 2D LiDAR."""

import math
from collections.abc import Mapping
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from lidar_core.config import Config
from lidar_core.sensors import sensor_named

_MOST_BEAMS = 100_000


class Scanner(Config):
    """A 2D LiDAR; the defaults are the paper's: a Hokuyo UTM-30LX, limited to 10 m.

    `preset`, a 2D sensor of `lidar_core.sensors.SENSORS`, supplies all values that are not given.
    Values may be given by position, in the order of the fields. Source: Sanchez-Lopez et al., sec.
    VI-B.

    Examples
    --------
    >>> scanner = Scanner(-math.pi / 2, math.pi / 180, 181, 0.1, 30.0)
    >>> scanner.field_of_view == math.pi
    True
    """

    angle_min: float = Field(
        default=math.radians(-135.0),
        ge=-4 * math.pi,
        le=4 * math.pi,
        description="Bearing of the first ray, counter-clockwise from the x axis [rad].",
    )
    angle_increment: float = Field(
        default=math.radians(0.25),
        ge=-1.0,
        le=1.0,
        description="Step from ray to ray [rad], not 0; negative: the scanner turns clockwise.",
    )
    n_beams: int = Field(
        default=1081, ge=2, le=_MOST_BEAMS, description="Rays of one sweep (count, no unit)."
    )
    range_min: float = Field(
        default=0.1, ge=0, le=20, description="Nearest surface that is measured [m]."
    )
    range_max: float = Field(
        default=10.0, gt=0, le=500, description="Farthest surface that is measured [m]."
    )

    def __init__(self, *values: float, **named: Any) -> None:
        fields = type(self).model_fields
        if len(values) > len(fields):
            raise TypeError(f"Scanner takes {len(fields)} values, got {len(values)}")
        given = dict(zip(fields, values, strict=False))
        if twice := given.keys() & named.keys():
            raise TypeError(f"Scanner got {', '.join(sorted(twice))} twice")
        super().__init__(**given, **named)

    # As in Config: a scanner inside another model is validated as a part of it.
    __init__.__pydantic_base_init__ = True  # type: ignore[attr-defined]

    @model_validator(mode="before")
    @classmethod
    def _fill_in_preset(cls, values: Any) -> Any:
        if not isinstance(values, Mapping) or "preset" not in values:
            return values
        given = dict(values)
        return {**_values_of(given.pop("preset")), **given}

    @model_validator(mode="after")
    def _is_a_sweep(self) -> Self:
        if not 0 < self.field_of_view <= 2 * math.pi + abs(self.angle_increment):
            raise ValueError(
                "expected angle_increment other than 0 and at most one turn in all, got a sweep"
                f" of {self.field_of_view:.4g} rad"
            )
        if self.range_min >= self.range_max:
            raise ValueError("expected range_min < range_max")
        return self

    @property
    def field_of_view(self) -> float:
        """Angle from the first ray to the last [rad]."""
        return abs(self.angle_increment) * (self.n_beams - 1)

    def bearings(self) -> NDArray[np.float64]:
        """Bearing of every ray, shape (n_beams,) [rad]."""
        steps = np.arange(self.n_beams, dtype=np.float64)
        return np.asarray(self.angle_min + self.angle_increment * steps, dtype=np.float64)


def _values_of(preset: str) -> dict[str, Any]:
    model = sensor_named(preset, kind="planar").model
    names = {"beams": "n_beams"}
    shape = {
        names.get(name, name): value
        for name, value in model["pattern"].items()
        if name in ("beams", "angle_min", "angle_increment")
    }
    return {**shape, "range_min": model["range_min"], "range_max": model["range_max"]}


def scanner_name(sensor: str, rays: int, scanners: Mapping[str, Scanner]) -> str:
    """Return the name in a pipeline for scans of `sensor` with this many rays.

    A sensor with scans of several lengths counts as several LiDARs in the pipeline.
    """
    other = layout_name(sensor, rays)
    return other if other in scanners else sensor


def layout_name(name: str, rays: int) -> str:
    """Name of the scans of LiDAR `name` that have another number of rays than most."""
    return f"{name}, {rays} rays"
