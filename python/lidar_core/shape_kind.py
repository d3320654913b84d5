"""Kinds of shapes in maps of 2D scans, shared by the circle pipeline and by the files it writes."""

from enum import IntEnum


class ShapeKind(IntEnum):
    """What a segment is, and what its parameters mean."""

    CIRCLE = 0
    """Centre x, y, radius [m]."""
    ELLIPSE = 1
    """Centre x, y, longer and shorter semi-axis [m], bearing of the longer one [rad]."""
    RECTANGLE = 2
    """Centre x, y, longer and shorter side [m], bearing of the longer one [rad]. Two sides were
    seen; of one alone nothing tells whether there is a box behind it: it is a line."""
    LINE = 3
    """Bearing of the normal [rad], distance from the origin [m], both ends as positions along the
    line, counted counter-clockwise from the foot of the normal [m]."""
