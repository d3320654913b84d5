"""Limbs of people in plain numpy: whose they are, by writing down every way to share them out."""

from __future__ import annotations

from itertools import combinations

import numpy as np

REACH, STEP = 0.6, 0.75  # of a limb from its person, of two limbs of one person [m]
SPREAD = 0.25  # standard deviation of the middle of the limbs of a person [m]
ONE_HIDDEN, BOTH_HIDDEN = 6.0, 18.0  # -2 ln of probabilities
LEG, ALIKE = 0.1, 0.02  # a limb up to this radius is a leg; standard deviation beyond it [m]


def cost(person, limbs, radii, variances):
    """-2 ln of the likelihood of these limbs of one person; None if they cannot be."""
    if not len(limbs):
        return BOTH_HIDDEN
    if (np.linalg.norm(limbs - person, axis=1) >= REACH).any():
        return None
    off = np.linalg.norm(limbs.mean(axis=0) - person)
    if len(limbs) == 1:
        return (off / SPREAD) ** 2 + ONE_HIDDEN
    if np.linalg.norm(limbs[0] - limbs[1]) >= STEP:
        return None
    thicker = max(0.0, radii.max() - max(radii.min(), LEG))
    return (off / SPREAD) ** 2 + thicker**2 / (variances.sum() + ALIKE**2)


def ways(people, limbs, radii, variances):
    """Every way to share out limbs (N, 2) among people (M, 2): cost, and limbs of each person."""
    own = [
        (choice, cost(people[0], limbs[list(choice)], radii[list(choice)], variances[list(choice)]))
        for size in (0, 1, 2)
        for choice in combinations(range(len(limbs)), size)
    ]
    own = [(set(choice), value) for choice, value in own if value is not None]
    if len(people) == 1:
        return [(value, [choice]) for choice, value in own]
    others = ways(people[1:], limbs, radii, variances)
    return [
        (value + rest, [choice, *theirs])
        for choice, value in own
        for rest, theirs in others
        if not any(choice & one for one in theirs)
    ]


def shared_out(people, limbs, radii, variances):
    """Likeliest way, and by how much the next one costs more."""
    best, *others = sorted(ways(people, limbs, radii, variances), key=lambda way: way[0])
    return best[1], others[0][0] - best[0] if others else np.inf
