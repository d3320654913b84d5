"""Mistakes in measurements: how to undo each, and the option that corrects it."""

from collections.abc import Callable, Iterator, Mapping
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from lidar_core.fusion.measurement import Measurement
from lidar_core.fusion.recordings.columns.conventions import Azimuth, Turned, turned
from lidar_core.fusion.recordings.table import TableOptions

DEGREES = np.pi / 180
Change: TypeAlias = Callable[[Measurement], Measurement]
Repair: TypeAlias = tuple[str, str, Change]
"""The sensor that makes a mistake, the mistake with its option, and what undoes it."""
_AngleChange: TypeAlias = Callable[[float], float]
_PLACES = {"pose": {"yaw": 2}, "pose-3d": {"yaw": 5}, "gyro": {"rate": 0}}


def of_value(name: str, new: Callable[[float], float]) -> Change:
    """Return a change of one named value; it has no effect on measurements without this value."""

    def changed(m: Measurement) -> Measurement:
        named = {n: k for k, n in enumerate(m.measures or ())} or _PLACES.get(m.sensor, {})
        if name not in named:
            return m
        values = m.values.copy()
        values[named[name]] = new(float(values[named[name]]))
        return m.with_values(values)

    return changed


def _with(new: Callable[[NDArray[np.float64]], NDArray[np.float64]]) -> Change:
    """Return a change that applies `new` to all values of a measurement."""
    return lambda m: m.with_values(new(m.values))


def _scaled(factor: float) -> Change:
    """Return a change that multiplies all values by a factor."""
    return _with(lambda values: factor * values)


def later(seconds: float) -> Change:
    """Return a change that moves a measurement to a later time, by `seconds` [s]."""

    def changed(m: Measurement) -> Measurement:
        return m.with_values(m.values, stamp_ns=m.stamp_ns + round(seconds * 1e9))

    return changed


def _way(what: str, told: Azimuth | None, right: Azimuth | None) -> list[str]:
    """Option that corrects the direction in which `what` counts; empty if it is already set."""
    if right == told:
        return []
    option = f'azimuth={{"{what}": "{right or told}"}}'
    return [option if right else f"leave out {option}"]


_ANGLES: Mapping[tuple[str, Azimuth | None], str] = {
    ("rad", None): "counter-clockwise from x, in radians: they fit as they are",
    ("rad", "clockwise"): "clockwise: they fit with the other sign",
    ("rad", "compass"): "compass angles, clockwise from y: they fit as pi/2 minus the angle",
    ("deg", None): "degrees: they fit times pi/180",
    ("deg", "clockwise"): "degrees, clockwise: they fit times -pi/180",
    ("deg", "compass"): "compass angles in degrees: they fit as pi/2 minus the angle times pi/180",
}
"""What angles of a table may be, by unit and direction, and what makes radians of them."""


def _angle(told: TableOptions, what: Turned, unit: str, way: Azimuth | None) -> _AngleChange:
    """Return a change of an angle: as if its column had been read with this unit and direction."""
    before = told.azimuth.get(what)
    scale = (DEGREES if unit == "deg" else 1.0) / (DEGREES if told.angle_unit == "deg" else 1.0)

    def changed(angle: float) -> float:
        # Both directions are their own inverse: the first call undoes what was told.
        column = turned(np.array([angle]), before)
        return float(turned(scale * column, way)[0])

    return changed


def _angles(told: TableOptions, what: Turned) -> Iterator[tuple[str, _AngleChange]]:
    """Yield possible mistakes of an angle: text with options, and the change that undoes it."""
    for (unit, way), text in _ANGLES.items():
        options = [] if unit == told.angle_unit else [f'angle_unit="{unit}"']
        options += _way(what, told.azimuth.get(what), way)
        if options:
            yield f"{text} ({', '.join(options)})", _angle(told, what, unit, way)
    if told.angle_unit == "rad":
        yield "radians that were taken as degrees", lambda angle: angle / DEGREES


_LIDAR: Mapping[Azimuth | None, str] = {
    None: "x and y of the LiDAR are ahead and to the left: they fit as they are",
    "clockwise": "y of the LiDAR is mirrored (a clockwise azimuth): it fits with the other sign",
    "compass": "x and y of the LiDAR are exchanged",
}
"""What x and y of a LiDAR may be."""


def _turned_place(values: NDArray[np.float64], way: Azimuth | None) -> NDArray[np.float64]:
    """Convert x and y of another convention; the conversion is its own inverse."""
    x, y = values[:2]
    flat = {None: (x, y), "clockwise": (x, -y), "compass": (y, x)}[way]
    return np.array([*flat, *values[2:]])


def _places_turned(told: TableOptions) -> Iterator[tuple[str, Change]]:
    before = told.azimuth.get("lidar")
    for way, text in _LIDAR.items():
        if options := _way("lidar", before, way):

            def changed(
                values: NDArray[np.float64], way: Azimuth | None = way
            ) -> NDArray[np.float64]:
                return _turned_place(_turned_place(values, before), way)

            yield f"{text} ({options[0]})", _with(changed)


def _rates(told: TableOptions) -> tuple[str, Change]:
    """Mistake that turn rates have the opposite sign: its text and the change that undoes it."""
    before = told.azimuth.get("turn_rate")
    text = (
        "turn rates are counter-clockwise: they fit as they are"
        if before
        else "turn rates are clockwise: they fit with the other sign"
    )
    (option,) = _way("turn_rate", before, None if before else "clockwise")
    return f"{text} ({option})", of_value("rate", lambda rate: -rate)


def factor_option(told: TableOptions, factor: float, *names: str) -> str:
    """Return the option that multiplies the named columns by `factor` and factors already set."""
    factors = [f'"{name}": {told.scale.get(name, 1.0) * factor:g}' for name in names]
    return f"scale={{{', '.join(factors)}}}"


_LENGTHS = {"millimetres": 1e-3, "centimetres": 1e-2, "feet": 0.3048, "kilometres": 1e3}
LATE = (0.1, 0.2, 0.3, 0.5, 0.7, 1.0, 1.5, 2.0, 3.0, 5.0)
"""How far a clock is tried to be off [s], both ways."""


def repairs(told: TableOptions) -> list[Repair]:
    """Return possible mistakes in measurements read with these options, except those of lengths."""
    return [
        *(
            ("radar", f"bearings are {what}", of_value("bearing", change))
            for what, change in _angles(told, "bearing")
        ),
        *(
            (sensor, f"yaws of the platform are {what}", of_value("yaw", change))
            for sensor in ("pose", "pose-3d")
            for what, change in _angles(told, "pose_yaw")
        ),
        ("gyro", *_rates(told)),
        *(("lidar", text, change) for text, change in _places_turned(told)),
        (
            "radar",
            "range rates are positive when the range shrinks: they fit with the other sign"
            f" ({factor_option(told, -1, 'range_rate')})",
            of_value("range_rate", lambda rate: -rate),
        ),
    ]


def lengths(told: TableOptions) -> list[Repair]:
    """Return possible mistakes about units of length: of a sensor, or of one position column."""
    found: list[Repair] = []
    for unit, factor in _LENGTHS.items():
        fits = f"times {factor:g} ("
        option = factor_option(told, factor, "range")
        found += [
            (
                "radar",
                f"ranges are {unit}: they fit {fits}{option})",
                of_value("range", factor.__mul__),
            ),
            (
                "lidar",
                f"places of the LiDAR are {unit}: they fit {fits}"
                f"{factor_option(told, factor, 'x', 'y')}; a column z likewise)",
                _scaled(factor),
            ),
        ]
        # Directions that were told have exchanged the columns x and y.
        columns = "yxz" if told.azimuth.get("lidar") == "compass" else "xyz"
        found += [
            (
                "lidar",
                f"{name} of the LiDAR alone is in {unit}: it fits {fits}"
                f"{factor_option(told, factor, name)})",
                _one_scaled(place, factor),
            )
            for place, name in enumerate(columns)
        ]
    return found


def _one_scaled(place: int, factor: float) -> Change:
    """Return a change that multiplies the value at index `place`; no effect if there is none."""
    return _with(lambda v: np.where(np.arange(len(v)) == place, factor * v, v))
