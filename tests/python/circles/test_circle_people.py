"""People on two legs are one element; posts are not; what is hidden does not jump."""

import numpy as np
import pytest
from helpers.legs import legs

import reference.circles_front as oracle
from lidar_core.circles import CirclePipeline, CirclesConfig, Scanner

SCANNER = Scanner(-np.pi / 2, np.pi / 720, 720, 0.1, 8.0)
RATE = 10.0
HALL = np.array([(12.5, 0.0, 5.0)])
"""What ends the rays: the side of something large."""


def run(things, *, seconds, seed=4400):
    """Maps of all scans of `things(time)`, rows of (x, y, radius)."""
    rng = np.random.default_rng(seed)
    pipeline = CirclePipeline(CirclesConfig(scanner=SCANNER))
    maps = []
    for scan in range(round(seconds * RATE)):
        time = scan / RATE
        circles = np.vstack([np.array(things(time)).reshape(-1, 3), HALL])
        ranges = oracle.cylinder_ranges(SCANNER.bearings(), np.eye(4), circles)
        ranges = ranges + rng.normal(0, 0.01, len(ranges))
        stamp = round(time * 1e9) + 10**9
        maps.append(pipeline.process(ranges.astype(np.float32), np.eye(4), stamp).map)
    return maps


def near(found, place, reach=0.45):
    return np.flatnonzero(np.linalg.norm(found.center - place, axis=1) < reach)


@pytest.mark.parametrize("seed", [4400, 4401])
def test_a_person_on_two_legs_is_one_element_and_a_person(seed):
    start, velocity = np.array([2.5, -3.0]), np.array([0.1, 1.0])
    things = lambda time: legs(time, start=start, velocity=velocity) if time > 1 else []  # noqa: E731
    maps = run(things, seconds=6.0, seed=seed)
    numbers, slips, counts = set(), [], []
    for scan, found in enumerate(maps):
        time = scan / RATE
        if time < 2.0:
            continue
        own = near(found, start + velocity * time)
        counts.append(len(own))
        numbers.update(found.id[own].tolist())
        slips.extend(np.linalg.norm(found.velocity[own] - velocity, axis=1))
    assert len(numbers) <= 2
    assert np.mean(np.array(counts) == 1) > 0.9
    assert np.sqrt(np.mean(np.square(slips))) < 0.35
    last = maps[-1]
    assert last.person_probability[near(last, start + velocity * 5.9)].max() > 0.9


@pytest.mark.parametrize("seed", [4400, 4401])
def test_arms_that_swing_do_not_swing_the_velocity(seed):
    """A trunk that turns with its arms; the opposite, a sharp turn, is followed within a second."""
    start, corner = np.array([2.5, -2.5]), 3.5

    def place(time):
        on, aside = min(time, corner), max(0.0, time - corner)
        return start + np.array([aside, on])

    def things(time):
        turn = np.sin(2 * np.pi * 0.9 * time)
        axes = np.array([(1.0, 0.0), (0.0, 1.0)]) if time < corner else np.array([(0, 1), (1, 0)])
        at = place(time)
        parts = [(*(at + side * 0.09 * axes[0]), 0.11) for side in (-1, 1)]
        arms = [(*(at + side * (0.23 * axes[0] + 0.2 * turn * axes[1])), 0.045) for side in (-1, 1)]
        return [*parts, *arms]

    maps = run(things, seconds=5.0, seed=seed)
    slips = []
    for scan, found in enumerate(maps):
        time = scan / RATE
        if time < 1.5 or corner <= time < corner + 1.0:
            continue
        velocity = np.array([0.0, 1.0] if time < corner else [1.0, 0.0])
        own = near(found, place(time))
        assert len(own)
        slips.append(np.linalg.norm(found.velocity[own] - velocity, axis=1).max())
    assert np.sqrt(np.mean(np.square(slips))) < 0.15


def test_people_who_pass_each_other_closely_stay_two():
    """Both were known for a second; at 3 s they are 0.3 m apart."""
    ways = [((2.5, -3.0), (0.0, 1.0)), ((2.8, 3.0), (0.0, -1.0))]
    things = lambda time: [leg for at, way in ways for leg in legs(time, start=at, velocity=way)]  # noqa: E731
    maps = run(things, seconds=6.0)
    known = set(maps[20].id.tolist())
    for found, time in ((maps[20], 2.0), (maps[58], 5.8)):
        own = [near(found, np.array(at) + np.array(way) * time) for at, way in ways]
        assert [len(rows) for rows in own] == [1, 1]
    assert {int(number) for rows in own for number in found.id[rows]} <= known


def test_who_was_first_seen_beside_somebody_becomes_no_part_of_them():
    """They walk side by side for 3 s, then cross each other's ways 0.3 m apart."""

    def ways(time):
        one = np.array([3.0, -3.0 + time])
        aside = np.clip(0.9 - 0.8 * max(0.0, time - 5.0), -0.9, 0.9)
        return one, one + np.array([aside, -0.3])

    def things(time):
        one, two = ways(time)
        return [(*one, 0.17), *([(*two, 0.17)] if time > 2.0 else [])]

    maps = run(things, seconds=7.4)
    numbers = [
        [maps[k].id[near(maps[k], way, 0.3)].tolist() for way in ways(k / RATE)] for k in (48, 73)
    ]
    assert [len(own) for two in numbers for own in two] == [1, 1, 1, 1]
    assert numbers[0][0] != numbers[0][1]
    assert sorted(numbers[0]) == sorted(numbers[1])  # alike, and one shape while they pass


@pytest.mark.parametrize("apart", [True, False])
def test_what_stood_apart_stays_two_and_what_never_did_is_one(apart):
    """A crate is pushed to 0.1 m beside a post, or stands there from the first scan on."""

    def things(time):
        away = max(0.0, 1.2 - 0.5 * max(0.0, time - 2.0)) if apart else 0.0
        return [(3.0, 0.0, 0.15), (3.0, 0.5 + away, 0.25)]

    maps = run(things, seconds=7.0)
    both = maps[-1].id[near(maps[-1], (3.0, 0.3), 0.45)].tolist()
    assert len(both) == (2 if apart else 1)
    if apart:
        assert both == maps[15].id[maps[15].radius < 0.5].tolist()


@pytest.mark.parametrize("height", ["legs", "trunk"])
def test_who_passes_a_post_leaves_it_its_number(height):
    """Less than the gap of one object is between both at 3 s."""
    start, way = np.array([2.5, -3.0]), np.array([0.0, 1.0])
    post = (2.85, 0.0, 0.06)

    def things(time):
        now = start + way * time
        body = legs(time, start=start, velocity=way) if height == "legs" else [(*now, 0.18)]
        return [post, *body]

    maps = run(things, seconds=5.0)
    at = [
        near(maps[k], place, 0.3) for k in (20, 48) for place in (post[:2], start + way * k / RATE)
    ]
    assert [len(rows) for rows in at] == [1, 1, 1, 1]
    before, after = (
        [int(maps[k].id[rows[0]]) for rows in two] for k, two in ((20, at[:2]), (48, at[2:]))
    )
    assert before == after
    assert (
        max(
            np.linalg.norm(found.velocity[near(found, post[:2], 0.15)], axis=1).max(initial=0.0)
            for found in maps[20:]
        )
        < 0.3
    )


@pytest.mark.parametrize("heading", [0.0, 1.6, 3.14])
def test_who_starts_to_walk_is_noticed_within_half_a_second(heading):
    """Away from the scanner, across, and towards it."""
    way = np.array([np.cos(heading), np.sin(heading)])

    def things(time):
        return [(*(np.array([4.0, 0.0]) + way * max(0.0, time - 3.0)), 0.2)]

    maps = run(things, seconds=3.6)
    speeds = [np.linalg.norm(found.velocity, axis=1).max(initial=0.0) for found in maps]
    assert max(speeds[5:30]) < 0.05
    assert min(speeds[35:]) > 0.3


def test_what_creeps_is_not_taken_for_standing():
    maps = run(lambda time: [(3.0, -1.0 + 0.35 * max(0.0, time - 1.0), 0.15)], seconds=5.0)
    speeds = [np.linalg.norm(found.velocity, axis=1).max(initial=0.0) for found in maps[20:]]
    assert np.mean(np.array(speeds) > 0.2) > 0.9


def test_what_comes_into_sight_bit_by_bit_does_not_move():
    """Someone walks in front of a large post and a box's face, which stand."""
    things = lambda time: [  # noqa: E731
        (3.5, 0.0, 0.3),
        (3.6, 1.2, 0.12),
        (2.0, -2.0 + 0.8 * time, 0.15),
    ]
    maps = run(things, seconds=5.0)
    speeds = [
        found.velocity[near(found, place, 0.3)]
        for found in maps[8:]
        for place in ((3.5, 0.0), (3.6, 1.2))
    ]
    assert (np.linalg.norm(np.vstack(speeds), axis=1) > 0.3).mean() <= 0.02


def test_two_thin_posts_that_stand_stay_two_elements_and_no_persons():
    maps = run(lambda _: [(2.5, 0.0, 0.06), (2.5, 0.45, 0.06), (4.0, -1.0, 0.15)], seconds=4.0)
    assert all(len(near(found, (2.5, 0.22), 0.4)) == 2 for found in maps[10:])
    assert maps[-1].person_probability.max() < 0.2
    assert len({number for found in maps[5:] for number in found.id.tolist()}) <= 4


def test_a_post_that_is_hidden_does_not_take_the_place_of_another_that_appears():
    """A post goes behind a large box for good, and another appears 1.2 m beside."""

    def things(time):
        hider = [(1.5, 0.0, 0.25)] if time > 2.0 else []
        fresh = [(3.0, 1.2, 0.07)] if time > 3.0 else []
        return [*hider, *([(3.0, 0.0, 0.07)] if time <= 2.0 else []), *fresh]

    maps = run(things, seconds=5.0)
    (old,) = maps[15].id[near(maps[15], (3.0, 0.0), 0.2)].tolist()
    (new,) = maps[-1].id[near(maps[-1], (3.0, 1.2), 0.2)].tolist()
    assert new != old


def test_a_post_that_is_hidden_for_a_second_keeps_its_number():
    def things(time):
        return [(3.0, 0.0, 0.07), *([(1.5, 0.0, 0.25)] if 2.0 < time < 3.0 else [])]

    maps = run(things, seconds=5.0)
    (old,) = maps[15].id[near(maps[15], (3.0, 0.0), 0.2)].tolist()
    (now,) = maps[-1].id[near(maps[-1], (3.0, 0.0), 0.2)].tolist()
    assert now == old


def test_the_filter_of_the_paper_knows_no_persons():
    pipeline = CirclePipeline(CirclesConfig(map=CirclesConfig.paper().map, scanner=SCANNER))
    ranges = oracle.cylinder_ranges(SCANNER.bearings(), np.eye(4), np.array([(2.0, 0.0, 0.2)]))
    found = pipeline.process(ranges.astype(np.float32), np.eye(4), 10**9).map
    assert len(found)
    assert (found.person_probability == 0).all()
