"""Scanners as the scans of a recording or stream state them."""

from lidar_core.circles.config import CirclesConfig
from lidar_core.circles.scanner import Scanner
from lidar_core.errors import ConfigError, FormatError
from lidar_core.messages import LaserScan
from lidar_core.sensors import SENSORS


def scanner_of(scan: LaserScan, config: CirclesConfig, place: str) -> Scanner:
    """Rays of the LiDAR that gave `scan`, within the range limits of `config.scanner`.

    Raises
    ------
    FormatError
        No pipeline can use its scans; the text begins with `place`.
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


def _rays(scanner: Scanner) -> dict[str, float]:
    return {name: getattr(scanner, name) for name in ("n_beams", "angle_min", "angle_increment")}
