"""Nominal figures of commercial LiDARs, for simulator, detector and circles.

Rounded, and not compared with the current data sheet of every maker. Rows are even between the
first and the last where no other ones are given; ranges are those on dark surfaces where makers
give them, noise (one standard deviation) and shortest ranges typical values where they give none.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from math import radians
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_core.errors import ConfigError, unknown

__all__ = [
    "LONGEST_2D",
    "LONGEST_3D",
    "SENSORS",
    "Sensor",
    "far_median",
    "far_text",
    "sensor_named",
]

LONGEST_2D, LONGEST_3D = 500.0, 1000.0
"""Median range of a scan that no 2D or 3D LiDAR for robots measures [m]."""
_SAMPLE = 1000  # returns of which the median is taken: it is no exact figure


@dataclass(frozen=True, slots=True)
class Sensor:
    """One LiDAR.

    Attributes
    ----------
    title : str
        Maker and name.
    note : str
        Origin of the numbers, and differences from the real pattern.
    model : mapping
        Values of `lidar_core.sim.LidarModel`.
    delivery : str
        Output of the driver for rays without return, as `lidar_core.sim.LidarModel.delivery`:
        "dropped" rows, rows of "zeros", "organised" rows of NaN, or "rays" that are all known.
    """

    title: str
    note: str
    model: Mapping[str, Any]
    delivery: str = "rays"

    @property
    def drops_rays(self) -> bool:
        """Return whether its driver leaves out rays without return."""
        return self.delivery == "dropped"

    @property
    def pattern(self) -> Mapping[str, Any]:
        """Directions of its rays."""
        pattern: Mapping[str, Any] = self.model["pattern"]
        return pattern

    @property
    def is_planar(self) -> bool:
        """Return whether it is a 2D LiDAR."""
        return bool(self.pattern["kind"] == "planar")


def sensor_named(name: str, *, kind: str | None = None) -> Sensor:
    """Return the sensor that presets call `name`.

    Raises
    ------
    ConfigError
        There is no such sensor, or it has another pattern.
    """
    known = [one for one, sensor in SENSORS.items() if kind in (None, sensor.pattern["kind"])]
    if name not in known:
        raise ConfigError(unknown("preset", name, known))
    return SENSORS[name]


def far_median(values: NDArray[np.floating[Any]], longest: float) -> float | None:
    """Return the median range of a scan if it is longer than `longest`, else None [m].

    Parameters
    ----------
    values : ndarray, shape (B,) or (N, 3), float32
        Ranges, or points in the frame of the sensor [m].
    longest : float
        `LONGEST_2D` or `LONGEST_3D`.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        some = values[:: max(1, len(values) // _SAMPLE)].astype(np.float64)
        ranges = some if some.ndim == 1 else np.linalg.norm(some, axis=1)
    seen = ranges[np.isfinite(ranges) & (ranges > 0)]
    # Drivers that count give all rays without return one range, such as 65535.
    seen = seen[seen < seen.max()] if len(seen) else seen
    median = float(np.median(seen)) if len(seen) else 0.0
    return median if median > longest else None


def far_text(median: float, *, is_planar: bool) -> str:
    """Return what a `far_median` means, and what helps."""
    if is_planar:
        return (
            f"half of the ranges are more than {median:,.0f} m, farther than any 2D LiDAR measures:"
            " write ranges in millimetres in metres, range_min and range_max, too"
        )
    return (
        f"half of the points are more than {median:,.0f} m away, farther than any LiDAR measures:"
        " write points in millimetres in metres, and those in coordinates of a map, such as UTM,"
        " in the frame of the sensor"
    )


def _even(top: float, bottom: float, rows: int) -> tuple[float, ...]:
    return tuple(np.linspace(top, bottom, rows).tolist())


def _spinning(elevations_deg: tuple[float, ...], columns: int, **more: Any) -> dict[str, Any]:
    pattern = {"kind": "spinning", "elevations_deg": elevations_deg, "columns": columns}
    return {"pattern": pattern, **more}


def _rosette(elevation_deg: tuple[float, float], **pattern: Any) -> dict[str, Any]:
    return {"kind": "rosette", "elevation_deg": elevation_deg, **pattern}


def _planar(angle_deg: float, beams: int, sweep_time: float, **more: Any) -> dict[str, Any]:
    angle = radians(angle_deg)
    pattern = {
        "kind": "planar",
        "beams": beams,
        "angle_min": -angle / 2,
        "angle_increment": angle / (beams - 1),
        "sweep_time": sweep_time,
    }
    return {"pattern": pattern, **more}


_OUSTER = {
    "os0": (45.0, {"range_max": 50.0}),
    "os1": (22.5, {"range_max": 100.0}),
    "os2": (11.25, {"range_min": 0.8, "range_max": 200.0}),
}
_HDL64 = (*_even(2.0, -8.33, 32), *_even(-8.83, -24.33, 32))
_PANDAR64 = (
    15.0,
    11.0,
    8.0,
    5.0,
    3.0,
    2.0,
    *_even(11 / 6, -6.0, 48),
    *_even(-7.0, -14.0, 8),
    -19.0,
    -25.0,
)

SENSORS: Mapping[str, Sensor] = {
    **{
        f"{name}-{rows}": Sensor(
            f"Ouster {name.upper()}-{rows}",
            "1024 columns at 10 Hz",
            _spinning(_even(half, -half, rows), 1024, **ranges),
            delivery="organised",
        )
        for name, (half, ranges) in _OUSTER.items()
        for rows in (32, 64, 128)
    },
    "vlp-16": Sensor(
        "Velodyne VLP-16",
        "0.2° at 10 Hz",
        _spinning(_even(15.0, -15.0, 16), 1800, range_min=0.5, range_max=100.0),
        delivery="dropped",
    ),
    "hdl-32e": Sensor(
        "Velodyne HDL-32E",
        "46.08 us per firing",
        _spinning(_even(10.67, -30.67, 32), 2170, range_min=0.9, range_max=80.0, range_std=0.02),
        delivery="dropped",
    ),
    "hdl-64e": Sensor(
        "Velodyne HDL-64E",
        "two blocks of even rows",
        _spinning(_HDL64, 2083, range_min=0.9, range_max=120.0, range_std=0.02),
        delivery="dropped",
    ),
    "vls-128": Sensor(
        "Velodyne VLS-128 (Alpha Prime)",
        "53.3 us per firing; the real rows are denser about the horizon",
        _spinning(_even(15.0, -25.0, 128), 1876, range_min=1.0, range_max=220.0),
        delivery="dropped",
    ),
    "xt32": Sensor(
        "Hesai PandarXT-32",
        "0.18° at 10 Hz",
        _spinning(_even(15.0, -16.0, 32), 2000, range_min=0.05, range_max=80.0, range_std=0.01),
        delivery="dropped",
    ),
    "pandar64": Sensor(
        "Hesai Pandar64",
        "0.2° at 10 Hz",
        _spinning(_PANDAR64, 1800, range_max=200.0, range_std=0.02),
        delivery="dropped",
    ),
    "qt128": Sensor(
        "Hesai QT128",
        "105.2° and 0.4° at 10 Hz; the real rows are not quite even",
        _spinning(_even(52.6, -52.6, 128), 900, range_min=0.05, range_max=20.0, range_std=0.02),
        delivery="dropped",
    ),
    "rs16": Sensor(
        "RoboSense RS-LiDAR-16",
        "0.2° at 10 Hz",
        _spinning(_even(15.0, -15.0, 16), 1800, range_min=0.4, range_max=150.0, range_std=0.02),
        delivery="dropped",
    ),
    "livox-mid360": Sensor(
        "Livox Mid-360",
        "field of view, 200,000 points/s; turns and a triangle wave of elevation stand for"
        " the real pattern, which is not published",
        {"pattern": _rosette((-7.0, 52.0)), "range_min": 0.1, "range_max": 40.0, "range_std": 0.02},
        delivery="zeros",
    ),
    "livox-avia": Sensor(
        "Livox Avia",
        "field of view 70.4° x 77.2°, 240,000 points/s; two triangle waves, which fill the"
        " rectangle, stand for the real petals of six lines",
        {
            "pattern": _rosette((-38.6, 38.6), rays=24_000, azimuth_half_deg=35.2),
            "range_min": 1.0,
            "range_max": 190.0,
            "range_std": 0.02,
        },
        delivery="zeros",
    ),
    "livox-hap": Sensor(
        "Livox HAP",
        "field of view 120° x 25°, 452,000 points/s; two triangle waves stand for the real pattern",
        {
            "pattern": _rosette((-12.5, 12.5), rays=45_200, azimuth_half_deg=60.0),
            "range_min": 0.5,
            "range_max": 150.0,
            "range_std": 0.02,
        },
        delivery="zeros",
    ),
    "livox-horizon": Sensor(
        "Livox Horizon",
        "field of view 81.7° x 25.1°, 240,000 points/s; two triangle waves stand for the real"
        " pattern",
        {
            "pattern": _rosette((-12.55, 12.55), rays=24_000, azimuth_half_deg=40.85),
            "range_min": 0.5,
            "range_max": 90.0,
            "range_std": 0.02,
        },
        delivery="zeros",
    ),
    "utm-30lx": Sensor(
        "Hokuyo UTM-30LX",
        "1440 steps per turn of 25 ms",
        {
            "pattern": {"kind": "planar"},
            "scan_rate": 40.0,
            "range_min": 0.1,
            "range_max": 30.0,
            "range_std": 0.01,
        },
    ),
    "urg-04lx": Sensor(
        "Hokuyo URG-04LX",
        "1024 steps per turn",
        _planar(239.77, 683, 0.0667, range_min=0.06, range_max=4.095, range_std=0.01),
    ),
    "rplidar-s1": Sensor(
        "Slamtec RPLIDAR S1",
        "9,200 points/s at 10 Hz; 10 m on black, 40 m on white",
        _planar(360.0 - 360.0 / 920, 920, 0.0998, range_min=0.1, range_max=40.0, range_std=0.05),
    ),
    "lms111": Sensor(
        "SICK LMS111",
        "0.5° at 50 Hz",
        _planar(270.0, 541, 0.015, scan_rate=50.0, range_min=0.5, range_max=20.0, range_std=0.012),
    ),
    "lms151": Sensor(
        "SICK LMS151",
        "0.5° at 50 Hz, 50 m",
        _planar(270.0, 541, 0.015, scan_rate=50.0, range_min=0.5, range_max=50.0, range_std=0.012),
    ),
    "tim551": Sensor(
        "SICK TiM551",
        "1° at 15 Hz",
        _planar(270.0, 271, 0.05, scan_rate=15.0, range_min=0.05, range_max=10.0, range_std=0.02),
    ),
    "tim571": Sensor(
        "SICK TiM571",
        "0.33° at 15 Hz",
        _planar(270.0, 811, 0.05, scan_rate=15.0, range_min=0.05, range_max=25.0, range_std=0.02),
    ),
}
"""By the name that presets have."""


def __dir__() -> list[str]:
    return __all__
