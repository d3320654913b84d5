"""Legs of somebody who walks, seen from above."""

import numpy as np


def legs(seconds, *, start, velocity, radius=0.07):
    """Two legs (x, y, r): each stands for half a cycle and swings as fast as it has to."""
    velocity = np.array(velocity)
    speed = np.linalg.norm(velocity)
    ahead, aside = velocity / speed, np.array([-velocity[1], velocity[0]]) / speed
    cycle = 1.1
    found = []
    for side, phase in ((-1, 0.0), (1, 0.5)):
        turns = seconds / cycle + phase
        whole, part = np.floor(turns), turns % 1.0
        # Half a cycle on the ground, half a cycle in the air, by twice the way.
        steps = whole + np.clip(2 * part - 1, 0, 1) - phase + 0.25
        place = np.array(start) + ahead * speed * cycle * steps + aside * 0.09 * side
        found.append((*place, radius))
    return found
