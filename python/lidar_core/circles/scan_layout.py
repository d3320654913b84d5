"""Scanners that the scans of a recording or stream describe."""

import math

import numpy as np

from lidar_core.circles.config import CirclesConfig
from lidar_core.circles.scanner import Scanner
from lidar_core.errors import ConfigError, FormatError, InputError
from lidar_core.messages import LaserScan
from lidar_core.sensors import SENSORS

MOST_DEVIATION = 0.25
"""Deviation of a ray from the configured one beyond which it is another ray (rays, no unit).

Drivers state angles in float32, and configuration files round them.
"""


def scanner_of(scan: LaserScan, config: CirclesConfig, place: str) -> Scanner:
    """Return the scanner of `scan`, within the range limits of `config.scanner`.

    Raises
    ------
    FormatError
        The scans cannot be used by a pipeline; the text begins with `place`.
    """
    limits = config.scanner
    try:
        return Scanner(
            angle_min=scan.angle_min,
            angle_increment=scan.angle_increment,
            n_beams=len(scan.ranges),
            range_min=max(scan.range_min, limits.range_min),
            range_max=min(scan.range_max, limits.range_max),
        )
    except ConfigError as error:
        raise FormatError(f"{place}: its scans cannot be used: {error}") from error


def check_no_rays(config: CirclesConfig) -> None:
    """Refuse rays in `config.scanner`, which the scans would override.

    Values of a preset do not count: they are nominal, and files that start from a preset contain
    them.

    Raises
    ------
    ConfigError
        The configuration states rays.
    """
    nominal = [
        Scanner.load({"preset": name}) for name, sensor in SENSORS.items() if sensor.is_planar
    ]
    if config.scanners or any(_rays(one) == _rays(config.scanner) for one in nominal):
        return
    usual = _rays(Scanner())
    for name, value in _rays(config.scanner).items():
        if value != usual[name]:
            raise ConfigError(
                f"scanner.{name}: the recording states this value; to override it for one"
                f' scanner: set scanners."TOPIC".{name}=...'
            )


def check_bearings(scan: LaserScan, scanner: Scanner) -> None:
    """Refuse a scan whose bearings are not those of the configured scanner.

    A scan with another number of rays passes: the pipeline refuses it itself.

    Raises
    ------
    InputError
        A ray deviates by more than a quarter of a step, as in a scan with the rays in the opposite
        order.
    """
    rays = np.size(scan.ranges)
    if rays != scanner.n_beams:
        return
    start, step = (_angle(scan, name) for name in ("angle_min", "angle_increment"))
    # The deviation grows linearly along the scan: its ends have the largest ones.
    first = math.remainder(start - scanner.angle_min, math.tau) if math.isfinite(start) else start
    last = first + (step - scanner.angle_increment) * (rays - 1)
    most = MOST_DEVIATION * abs(scanner.angle_increment)
    if abs(first) <= most and abs(last) <= most:
        return
    raise InputError(
        f"scan: expected the bearings of `scanner`, {scanner.n_beams} rays with angle_min="
        f"{scanner.angle_min:.6g}, angle_increment={scanner.angle_increment:.6g}, got {rays} rays"
        f" with angle_min={start:.6g}, angle_increment={step:.6g}; configure the scanner of the"
        " scans: Scanner(scan.angle_min, scan.angle_increment, len(scan.ranges), scan.range_min,"
        " scan.range_max)"
    )


def _angle(scan: LaserScan, name: str) -> float:
    value = getattr(scan, name)
    try:
        return float(value)
    except (TypeError, ValueError) as error:
        raise InputError(f"scan.{name}: expected a number, got {type(value).__name__}") from error


def _rays(scanner: Scanner) -> dict[str, float]:
    return {name: getattr(scanner, name) for name in ("n_beams", "angle_min", "angle_increment")}
