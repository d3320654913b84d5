"""Whose legs are whose where two people pass each other, against every way written down."""

import numpy as np
import pytest
from helpers.legs import legs

import reference.circles_front as front
from lidar_core.circles import CirclePipeline, CirclesConfig, Scanner
from reference import circle_limbs as oracle

SCANNER = Scanner(-np.pi / 2, np.pi / 720, 720, 0.1, 8.0)
RATE, SECONDS = 10.0, 6.0
HALL = (12.5, 0.0, 5.0)
KNOWN = 2.0
"""Time after which both people are known [s]."""
CLEAR = 0.3
"""Difference of costs above which the choice does not depend on the last digits of the places that
are expected: those that `map_at` returns do not contain changes between standing and moving."""
ALIKE = 0.98
"""Share of limbs with the person of the oracle. The rest: an element that was not yet seen on two
legs, a place that depends on such a change, and legs whose whole is nearer to somebody else."""


def crossing(seed):
    """Every scan of two people who pass each other: the map before it, and what it found."""
    rng = np.random.default_rng(seed)
    aside, (one, two), x = rng.uniform(0.15, 0.6), rng.uniform(0.7, 1.2, 2), rng.uniform(2.0, 3.0)
    ways = [((x, -3.0), (0.0, one)), ((x + aside, 3.0), (0.0, -two))]
    pipeline = CirclePipeline(CirclesConfig(scanner=SCANNER))
    for scan in range(round(SECONDS * RATE)):
        time = scan / RATE
        both = [leg for at, way in ways for leg in legs(time, start=at, velocity=way)]
        circles = np.array([*both, HALL])
        ranges = front.cylinder_ranges(SCANNER.bearings(), np.eye(4), circles)
        ranges = ranges + rng.normal(0, 0.01, len(ranges))
        stamp = round(time * 1e9) + 10**9
        before = pipeline.map_at(stamp) if scan else None
        frame = pipeline.process(ranges.astype(np.float32), np.eye(4), stamp)
        if before is not None and time >= KNOWN:
            yield before, frame


def test_legs_are_shared_out_like_every_way_written_down():
    same = []
    for seed in range(4400, 4406):
        for before, frame in crossing(seed):
            people = before.person_probability > 0.9
            if np.count_nonzero(people) != 2:
                continue
            seen = frame.circles_world
            thin = np.flatnonzero(seen.parameters[:, 2] <= 0.17)
            shares, margin = oracle.shared_out(
                before.center[people],
                seen.parameters[thin, :2],
                seen.parameters[thin, 2],
                seen.covariance[thin, 2, 2],
            )
            if margin > CLEAR:
                for person, own in zip(before.id[people], shares, strict=True):
                    same += [frame.element[thin[leg]] == person for leg in own]
    assert len(same) > 500
    assert np.mean(same) > ALIKE


@pytest.mark.parametrize(
    ("limbs", "radii", "expected"),
    [
        # The front leg of the first person is where the second one is expected.
        ([[-0.3, 0.0], [0.3, 0.0], [0.2, 0.1], [0.4, -0.1]], [0.07] * 4, [{0, 1}, {2, 3}]),
        ([[0.0, -0.1], [0.0, 0.1], [0.8, 0.1]], [0.07] * 3, [{0, 1}, {2}]),
        # An arm beside a trunk is no pair.
        ([[-0.1, 0.0], [0.1, 0.0]], [0.045, 0.16], [{0}, {1}]),
        ([[-0.4, 0.0], [5.0, 0.0]], [0.07] * 2, [{0}, set()]),
    ],
)
def test_the_oracle_knows_whose_legs_are_whose(limbs, radii, expected):
    people = np.array([[0.0, 0.0], [0.3, 0.0]])
    shares, _ = oracle.shared_out(
        people, np.array(limbs), np.array(radii), np.full(len(radii), 1e-5)
    )
    assert shares == expected
