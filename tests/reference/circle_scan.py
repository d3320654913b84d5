"""What a scanner without noise sees of one circle: every ray by the quadratic equation."""

import numpy as np


def ranges(circle, bearings, range_min, range_max):
    """Distance along every ray to the circle; +inf where it is missed or out of range."""
    x, y, radius = circle
    directions = np.stack([np.cos(bearings), np.sin(bearings)], axis=1)
    along = directions @ [x, y]
    root = along**2 - (x**2 + y**2 - radius**2)
    with np.errstate(invalid="ignore"):
        near = along - np.sqrt(root)
    seen = (root >= 0) & (along > 0) & (near >= range_min) & (near <= range_max)
    return np.where(seen, near, np.inf)
