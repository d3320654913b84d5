"""Models of 3D and 2D LiDARs, and presets of commercial ones."""

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import Field, model_validator

from lidar_core.config import Config
from lidar_core.sensors import sensor_named

Elevation = Annotated[float, Field(ge=-90, le=90)]


class Spinning(Config):
    """Rows of fixed elevation that turn once per scan, counter-clockwise seen from above.

    Rays are ordered row by row; the rays of one column are fired together.
    """

    kind: Literal["spinning"] = "spinning"
    elevations_deg: tuple[Elevation, ...] = Field(
        min_length=1, max_length=4096, description="Elevation of every row [deg], top row first."
    )
    columns: int = Field(default=1024, ge=1, le=65536, description="Columns per turn (no unit).")
    azimuth_start: float = Field(default=0.0, description="Azimuth of the first column [rad].")
    azimuth_per_scan: float = Field(default=0.0, description="Turn of the pattern per scan [rad].")


class Rosette(Config):
    """One ray after the other, along a pattern of turns and swings that never repeats.

    The swing is a triangle wave in elevation. With `azimuth_half_deg`, the azimuth is a triangle
    wave too and does not turn. The pattern imitates the scans of non-repetitive sensors, not a
    maker's formula.
    """

    removed: ClassVar[Mapping[str, str]] = {
        "turn_rate": "it makes 16.18 turns or swings in azimuth per second",
        "swing_rate": "it swings 2236 times per second in elevation",
        "elevation_min_deg": "write it as the first value of elevation_deg",
        "elevation_max_deg": "write it as the second value of elevation_deg",
    }
    kind: Literal["rosette"] = "rosette"
    rays: int = Field(default=20_000, ge=1, le=4_000_000, description="Rays per scan (no unit).")
    elevation_deg: tuple[Elevation, Elevation] = Field(
        description="Lowest and highest elevation [deg]."
    )
    azimuth_half_deg: float | None = Field(
        default=None,
        gt=0,
        lt=180,
        description="Azimuth to either side of the x axis; none: turns [deg].",
    )

    @model_validator(mode="after")
    def _lowest_is_below_highest(self) -> Self:
        low, high = self.elevation_deg
        if low >= high:
            raise ValueError(f"elevation_deg: expected lowest < highest, got {low}, {high}")
        return self


class Planar(Config):
    """A 2D LiDAR: one ray after the other in the plane z = 0 of its frame."""

    kind: Literal["planar"] = "planar"
    beams: int = Field(default=1081, ge=2, le=1_000_000, description="Rays per scan (no unit).")
    angle_min: float = Field(
        default=-2.356194490192345, description="Bearing of the first ray [rad]."
    )
    angle_increment: float = Field(
        default=0.004363323129985824,
        description="Angle from one ray to the next, < 0 for clockwise; at most one turn in"
        " total [rad].",
    )
    sweep_time: float = Field(
        default=0.01875,
        ge=0,
        le=10,
        description="Time from the first ray to the last; 0: all at once [s].",
    )

    @property
    def time_increment_ns(self) -> int:
        """Time from one ray to the next [ns]."""
        return round(self.sweep_time * 1e9 / (self.beams - 1))


class Beam(Config):
    """Beam with a width in azimuth: at an edge it hits the object and the surface behind it."""

    half_width: float = Field(gt=0, le=0.1, description="To either side of the ray [rad].")
    lines: int = Field(
        default=9, ge=2, le=64, description="Number of lines that represent the beam (no unit)."
    )
    returns: Literal["first", "mean", "mixed"] = Field(
        default="first",
        description="Reported range: of the nearest surface that the beam hits (first), the mean of"
        " all (mean), or of those less than `pulse_length` behind the nearest (mixed) (no unit).",
    )
    pulse_length: float = Field(
        default=0.3,
        gt=0,
        le=10,
        description="Echoes nearer to one another than this become one [m].",
    )

    @property
    def echo_length(self) -> float:
        """Largest distance behind the first surface at which other surfaces count [m]."""
        return {"first": 0.0, "mean": float("inf"), "mixed": self.pulse_length}[self.returns]


class LidarModel(Config):
    """A LiDAR. `preset` supplies every value that is not given.

    Presets are the names of `lidar_core.sensors.SENSORS`, with the makers' nominal figures. A scan
    of a preset contains the output of the sensor's driver (`delivery`); `ideal` makes all rays
    known.
    """

    removed: ClassVar[Mapping[str, str]] = {
        "dropout_is_no_return": "lost returns tell nothing; every `delivery` but rays hides them",
    }
    pattern: Annotated[Spinning | Rosette | Planar, Field(discriminator="kind")] = Field(
        description="Directions and their order (see the two kinds for units)."
    )
    scan_rate: float = Field(default=10.0, gt=0, le=1000, description="Scans per second [Hz].")
    snapshot: bool = Field(
        default=False, description="All rays at the start of the scan (no unit)."
    )
    range_min: float = Field(
        default=0.3, ge=0, le=100, description="Nearer surfaces give no information [m]."
    )
    range_max: float = Field(
        default=100.0, gt=0, le=1e4, description="Surfaces from here on: no return [m]."
    )
    range_std: float = Field(
        default=0.03, ge=0, le=1, description="Standard deviation of the ranges [m]."
    )
    dropout: float = Field(
        default=0.0, ge=0, le=1, description="Probability of a lost return (no unit)."
    )
    delivery: Literal["rays", "dropped", "zeros", "organised"] = Field(
        default="rays",
        description="Output of the driver of a 3D LiDAR for rays without return: known rays"
        " with directions (rays), missing rows, rows (0, 0, 0), or rows of NaN;"
        " only rays has directions and a mask (no unit).",
    )
    point_times: bool = Field(
        default=True, description="True if the driver gives a time per point (no unit)."
    )
    ideal: bool = Field(
        default=False,
        description="Deliver all rays with directions and times, instead of the driver's data"
        " (no unit).",
    )
    beam: Beam | None = Field(
        default=None,
        description="Width of the light; without it rays are lines (see there for units).",
    )

    @classmethod
    def preset(cls, name: str, **changes: Any) -> Self:
        """Take the preset `name`, with `changes` to its fields.

        Raises
        ------
        ConfigError
            There is no such preset, or a change is not valid.
        """
        return cls.load({"preset": name, **changes})

    @property
    def period_ns(self) -> int:
        """Duration of a scan [ns]."""
        return round(1e9 / self.scan_rate)

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of a scan: (rows, columns) if it is organised, else (rays,)."""
        if isinstance(self.pattern, Spinning):
            return len(self.pattern.elevations_deg), self.pattern.columns
        return (self.pattern.beams if isinstance(self.pattern, Planar) else self.pattern.rays,)

    @model_validator(mode="before")
    @classmethod
    def _fill_in_preset(cls, values: Any) -> Any:
        if not isinstance(values, Mapping) or "preset" not in values:
            return values
        given = dict(values)
        name = given.pop("preset")
        sensor = sensor_named(name)
        return {**sensor.model, "delivery": sensor.delivery, **given}

    @model_validator(mode="after")
    def _ranges_are_ordered(self) -> Self:
        if self.range_min >= self.range_max:
            raise ValueError("expected range_min < range_max")
        return self

    @model_validator(mode="after")
    def _sweep_is_over_in_time(self) -> Self:
        if isinstance(self.pattern, Planar):
            sweep_ns = self.pattern.time_increment_ns * self.pattern.beams
            if not self.snapshot and sweep_ns > self.period_ns:
                raise ValueError("expected sweep_time within 1 / scan_rate")
        return self
