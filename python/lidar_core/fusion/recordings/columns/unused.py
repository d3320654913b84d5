"""Columns of a table of measurements that nothing reads, and what they may be."""

import re
from collections.abc import Collection, Mapping, Sequence
from difflib import get_close_matches

NAMED = 8
"""Columns that a note names."""
ALIKE = 0.8
"""Least similarity of a name to one that is known."""
ALSO_KNOWN = ("cov_", "true_")
"""Starts of columns that other tables of this package have: nobody expects them to be read."""
LENGTH_UNITS = ("m", "mm", "cm", "km", "ft", "feet", "meter", "meters", "metre", "metres")
DEGREES = frozenset(("deg", "degree", "degrees"))
UNITS = DEGREES | {
    *LENGTH_UNITS,
    *("rad", "radian", "radians", "s", "ms", "us", "ns", "mps", "kmh", "kph", "mph", "knots"),
}
"""Parts of names that tell a unit."""
OTHER_NAMES: Mapping[str, str] = {
    **dict.fromkeys(("r", "rng", "rho", "dist", "distance", "radius", "slant_range"), "range"),
    **dict.fromkeys(("az", "azimuth", "azim", "phi", "angle"), "bearing"),
    **dict.fromkeys(("el", "elev", "elevation_angle"), "elevation"),
    **dict.fromkeys(
        ("rr", "rangerate", "rdot", "doppler", "vr", "v_r", "radial_velocity", "radial_speed"),
        "range_rate",
    ),
    **dict.fromkeys(("px", "pos_x", "position_x", "lidar_x"), "x"),
    **dict.fromkeys(("py", "pos_y", "position_y", "lidar_y"), "y"),
    **dict.fromkeys(("pz", "pos_z", "position_z", "lidar_z"), "z"),
    **dict.fromkeys(("gyro", "gyro_z", "omega_z"), "turn_rate"),
    "latitude": "lat",
    "longitude": "lon",
    "altitude": "alt",
    **{f"gt_{name}": f"true_{name}" for name in ("x", "y", "vx", "vy")},
}
"""Usual names of columns, and ours."""


def unused_columns(
    table: Collection[str], used: Collection[str], renamed: Mapping[str, str]
) -> tuple[str, ...]:
    """Return the columns of a table that give no measurement, in their order.

    Parameters
    ----------
    table : collection of str
        Names of the columns of the file.
    used : collection of str
        Our names of columns that were read.
    renamed : mapping of str to str
        Our names to those of the file.
    """
    read = {renamed.get(name, name) for name in used} | set(renamed)
    return tuple(
        name for name in table if name not in read and not name.lower().startswith(ALSO_KNOWN)
    )


def unused_note(names: Sequence[str], used: Collection[str], known: Sequence[str]) -> str | None:
    """Say which columns are not read, and how to name those that look like a known one.

    Parameters
    ----------
    names : sequence of str
        Columns of a table that give no measurement.
    used : collection of str
        Our names of columns that were read; no other column can be one of them.
    known : sequence of str
        Our names of all columns.
    """
    if not names:
        return None
    listed = ", ".join(names[:NAMED])
    if len(names) > NAMED:
        listed += f" and {len(names) - NAMED} more"
    text = f"column {listed} is not used" if len(names) == 1 else f"columns {listed} are not used"
    found: dict[str, str] = {}
    for name in names:
        ours = _meant(name, [one for one in known if one not in used])
        if ours is not None and ours != name and ours not in found:
            found[ours] = name
    if not found:
        return text
    angles = [name for name in found.values() if DEGREES.intersection(_words(name))]
    pairs = ", ".join(f'"{ours}": "{theirs}"' for ours, theirs in found.items())
    unit = ' angle_unit="deg"' if angles else ""
    return f"{text}; did you mean columns={{{pairs}}}{unit}?"


def _meant(name: str, known: Sequence[str]) -> str | None:
    """Return the known column name that `name` probably means; None if none is similar."""
    words = _words(name)
    bare = "_".join(word for word in words if word not in UNITS) or "_".join(words)
    ours = OTHER_NAMES.get(bare, bare)
    if ours in known:
        return ours
    # Short names are like many others; a heading is like a bearing, but is not one.
    near = get_close_matches(bare, known, n=1, cutoff=ALIKE) if len(bare) > 3 else []
    return next(iter(near), None)


def _words(name: str) -> list[str]:
    """Split a name into words in lower case: `Range [m]` and `rangeM` give range and m."""
    split = re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name)
    return [word for word in re.split(r"[^a-z0-9]+", split.lower()) if word]
