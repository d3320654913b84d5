"""Mistakes in measurements: how to undo each, and the option that corrects it."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from lidar_core.fusion.measurement import Measurement

DEGREES = np.pi / 180
Change = Callable[[Measurement], Measurement]
_PLACES = {"pose": {"yaw": 2}, "pose-3d": {"yaw": 5}, "gyro": {"rate": 0}}


def _of(name: str, new: Callable[[float], float]) -> Change:
    """A change of one value, by its name; of nothing in measurements without it."""

    def changed(m: Measurement) -> Measurement:
        named = {n: k for k, n in enumerate(m.measures or ())} or _PLACES.get(m.sensor, {})
        if name not in named:
            return m
        values = m.values.copy()
        values[named[name]] = new(float(values[named[name]]))
        return m.with_values(values)

    return changed


def _with(new: Callable[[NDArray[np.float64]], NDArray[np.float64]]) -> Change:
    """A change of all values."""
    return lambda m: m.with_values(new(m.values))


def _scaled(factor: float) -> Change:
    """All values times a factor."""
    return _with(lambda values: factor * values)


def later(seconds: float) -> Change:
    """Return the same measurement with a later time [s]."""

    def changed(m: Measurement) -> Measurement:
        return m.with_values(m.values, stamp_ns=m.stamp_ns + round(seconds * 1e9))

    return changed


def _angles(what: str) -> tuple[tuple[str, Callable[[float], float]], ...]:
    """What angles may be, the option that says so, and what undoes it."""
    deg = 'angle_unit="deg"'
    clockwise, compass = (f'azimuth={{"{what}": "{way}"}}' for way in ("clockwise", "compass"))
    return (
        (f"clockwise: they fit with the other sign ({clockwise})", lambda a: -a),
        (
            f"compass angles, clockwise from y: they fit as pi/2 minus the angle ({compass})",
            lambda a: np.pi / 2 - a,
        ),
        (f"degrees: they fit times pi/180 ({deg})", lambda a: a * DEGREES),
        (
            f"degrees, clockwise: they fit times -pi/180 ({deg}, {clockwise})",
            lambda a: -a * DEGREES,
        ),
        (
            "compass angles in degrees: they fit as pi/2 minus the angle times pi/180"
            f" ({deg}, {compass})",
            lambda a: np.pi / 2 - a * DEGREES,
        ),
        ('radians that were taken as degrees (angle_unit="rad")', lambda a: a / DEGREES),
    )


_LENGTHS = {"millimetres": 1e-3, "centimetres": 1e-2, "feet": 0.3048, "kilometres": 1e3}
LATE = (0.1, 0.2, 0.3, 0.5, 0.7, 1.0, 1.5, 2.0, 3.0, 5.0)
"""How far a clock is tried to be off [s], both ways."""
REPAIRS: tuple[tuple[str, str, Change], ...] = (
    *(
        ("radar", f"bearings are {what}", _of("bearing", change))
        for what, change in _angles("bearing")
    ),
    *(
        (sensor, f"yaws of the platform are {what}", _of("yaw", change))
        for sensor in ("pose", "pose-3d")
        for what, change in _angles("pose_yaw")
    ),
    (
        "gyro",
        'turn rates are clockwise: they fit with the other sign (azimuth={"turn_rate":'
        ' "clockwise"})',
        _of("rate", lambda w: -w),
    ),
    (
        "lidar",
        "y of the LiDAR is mirrored (a clockwise azimuth): it fits with the other sign"
        ' (azimuth={"lidar": "clockwise"})',
        _with(lambda values: values * np.where(np.arange(len(values)) == 1, -1.0, 1.0)),
    ),
    (
        "lidar",
        'x and y of the LiDAR are exchanged (azimuth={"lidar": "compass"})',
        _with(lambda values: values[[1, 0, *range(2, len(values))]]),
    ),
    (
        "radar",
        "range rates are positive when the range shrinks: they fit with the other sign"
        ' (scale={"range_rate": -1})',
        _of("range_rate", lambda rate: -rate),
    ),
    *(
        (
            "radar",
            f'ranges are {unit}: they fit times {factor:g} (scale={{"range": {factor:g}}})',
            _of("range", factor.__mul__),
        )
        for unit, factor in _LENGTHS.items()
    ),
    *(
        (
            "lidar",
            f"places of the LiDAR are {unit}: they fit times {factor:g}"
            f' (scale={{"x": {factor:g}, "y": {factor:g}}}; a column z likewise)',
            _scaled(factor),
        )
        for unit, factor in _LENGTHS.items()
    ),
)
"""Mistakes, by the sensor that makes them, and what undoes them."""
LENGTHS = 2 * len(_LENGTHS)
"""Number of those about units of lengths, the last ones."""
LENGTH_TEXTS = frozenset(text for _, text, _ in REPAIRS[-LENGTHS:])
