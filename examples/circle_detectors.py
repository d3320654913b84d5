"""How well detectors estimate circles; with 50000 as argument, the tables of docs/training.md.

    python examples/circle_detectors.py [COUNT [RULE [SEED]]]

RULE says where circles lie: square, lattice, disc or polar.
"""

import sys

import numpy as np
from numpy.typing import NDArray

from lidar_core.circles import CircleDetector, DatasetConfig, Samples, Scanner, make_samples

ROWS = 2_000
RULES = ("square", "lattice", "disc", "polar")
RADII, REACH = (0.05, 0.5), 10.5


def samples_of(rule: str, count: int, seed: int) -> Samples:
    """`count` circles that the paper's scanner sees with one ray or more, and 1 cm of noise.

    square: centres anywhere in a square of 20 m, the rule of the training data;
    lattice: the paper's lattice of 0.05 m in the same square, radii as well;
    disc: centres anywhere up to 10.5 m away, also where the range or the view ends;
    polar: distances up to 10.5 m and bearings evenly distributed: more near circles.
    """
    config = DatasetConfig.continuous(circles=count)
    if rule == "square":
        return make_samples(config, count=count, seed=seed)
    random, found = np.random.default_rng(seed), np.empty((0, 3))
    while len(found) < count:
        drawn = drawn_by(rule, random, ROWS)
        found = np.concatenate([found, drawn[are_seen(drawn, config.scanner)]])
    return make_samples(config, count=count, seed=seed, circles=found[:count])


def drawn_by(rule: str, random: np.random.Generator, count: int) -> NDArray[np.float64]:
    """Circles (count, 3) of a rule, whether they are seen or not."""
    if rule == "lattice":
        steps = [random.integers(-200, 201, (2, count)), random.integers(1, 11, (1, count))]
        return 0.05 * np.concatenate(steps).T
    share = random.uniform(size=count)
    distance = REACH * (np.sqrt(share) if rule == "disc" else share)
    bearing = random.uniform(-np.pi, np.pi, count)
    place = distance * np.array([np.cos(bearing), np.sin(bearing)])
    return np.array([*place, random.uniform(*RADII, count)]).T


def are_seen(circles: NDArray[np.float64], scanner: Scanner) -> NDArray[np.bool_]:
    """Whether a ray of the scanner, which is outside of the circle, returns from it."""
    x, y, radius = circles.T[:, :, None]
    distance = np.hypot(x, y)
    off = scanner.bearings() - np.arctan2(y, x)
    half_chord = radius**2 - (distance * np.sin(off)) ** 2
    length = distance * np.cos(off) - np.sqrt(np.maximum(half_chord, 0.0))
    returns = (half_chord > 0) & (scanner.range_min < length) & (length < scanner.range_max)
    return np.asarray(returns.any(axis=1) & (distance > radius)[:, 0])


def main(count: int, rule: str, seed: int) -> None:
    """Print the errors of cnn and ml on so many circles."""
    scanner = Scanner()
    samples = samples_of(rule, count, seed)
    scans = samples.scans(scanner)
    whole = samples.is_whole(scanner)
    groups = {
        "all": np.ones(count, bool),
        "wholly visible, 4 hits or more": whole & (samples.n_hits >= 4),
        "cut": ~whole,
    }
    for name in ("cnn", "ml"):
        detector = CircleDetector(name)
        found = [
            detector.detect(scans[start : start + ROWS], scanner.bearings())
            for start in range(0, count, ROWS)
        ]
        errors = np.concatenate([np.asarray(part) for part in found]) - samples.circles
        covariance = np.concatenate([part.covariance for part in found])
        scaled = np.linalg.solve(covariance, errors[:, :, None])[:, :, 0]
        nees = (errors * scaled).sum(axis=1).mean()
        for group, chosen in groups.items():
            of_sample = np.abs(errors[chosen]).mean(axis=1)
            print(
                f"{name}, {group}: MSE {np.square(errors[chosen]).mean():.3g} m^2,"
                f" MAE {of_sample.mean():.4f} m, p99 {np.quantile(of_sample, 0.99):.3f} m"
            )
        print(f"NEES of {name}: {nees:.2f}, 3 is right")


if __name__ == "__main__":
    given = dict(enumerate(sys.argv[1:]))
    rule = given.get(1, RULES[0])
    if rule not in RULES:
        sys.exit(f"expected one of {', '.join(RULES)}, got {rule}")
    main(int(given.get(0, 5_000)), rule, int(given.get(2, 0)))
