"""Kinds of tracks: what hovers from the first scan on, insects, people at the edge of the view."""

import numpy as np
import pytest
from flying_scenes import YARD, feed, lidar, scans_of, wall, yard

from lidar_core import TrackKind
from lidar_core.flying import FlyingObjectDetector
from lidar_core.sim import (
    Circle,
    Hexacopter,
    Person,
    Simulator,
    Sphere,
    Target,
    Waypoints,
    scenes,
)

FINE = lidar(rows=96, columns=768)
HOVER_S = 2.0
BURN_IN_SCANS = 10
FRONT = 11.5  # of a wall of the yard [m]


def frames_of(scene):
    detector = FlyingObjectDetector()
    return [feed(detector, simulated) for simulated in scans_of(scene)]


def kinds_at(frame, place, reach=0.6):
    """Kinds and numbers of the tracks near a place."""
    near = np.linalg.norm(frame.tracks.position - place, axis=1) <= reach
    return frame.tracks.kind[near].tolist(), frame.tracks.id[near].tolist()


def hovering(*, moves):
    """A ball that hovers for two seconds, and then flies on at 3 m/s if it `moves`."""
    start, end = (6.0, 4.0, 3.5), (6.0, 10.0, 3.5) if moves else (6.0, 4.0, 3.5)
    motion = Waypoints(times=(HOVER_S, HOVER_S + 2.0), positions=(start, end))
    scene = yard(Target(shape=Sphere(radius=0.3), motion=motion), scans=30)
    return start, frames_of(scene)


def test_what_hovers_is_unknown_until_it_moves_and_keeps_its_number():
    place, frames = hovering(moves=True)
    numbers = set()
    for frame in frames[BURN_IN_SCANS : int(10 * HOVER_S)]:
        kinds, ids = kinds_at(frame, place)
        assert kinds == [TrackKind.UNKNOWN]
        numbers |= set(ids)
    moved = [frame for frame in frames if len(frame.tracks.flying)]
    first = moved[0].stamp_ns - frames[0].stamp_ns
    # 0.1 m of way at 3 m/s, and 0.3 s after that.
    assert HOVER_S < first * 1e-9 <= HOVER_S + 0.4 + 1e-6
    numbers |= {number for frame in moved for number in frame.tracks.flying.id.tolist()}
    assert len(numbers) == 1
    assert len(frames[-1].tracks) == len(frames[-1].tracks.flying) == 1


def test_what_hangs_still_never_flies():
    place, frames = hovering(moves=False)
    for frame in frames[BURN_IN_SCANS:]:
        assert kinds_at(frame, place)[0] == [TrackKind.UNKNOWN]
        assert len(frame.tracks.flying) == 0


def test_what_hovers_flies_as_soon_as_it_leaves_its_place():
    """Its shadow was never seen, so that nothing around it shows that it enters free space."""
    start, end = (-5.0, -3.0, 3.5), (-2.4, -8.4, 3.5)
    motion = Waypoints(times=(HOVER_S, HOVER_S + 2.0), positions=(start, end))
    target = Target(shape=Hexacopter(radius=0.325), motion=motion)
    frames = frames_of(yard(target, scans=30, lidar=FINE))
    numbers = {number for frame in frames for number in frame.tracks.id.tolist()}
    assert len(numbers) == 1
    for number, frame in enumerate(frames[BURN_IN_SCANS:], BURN_IN_SCANS):
        has_moved = number > 10 * HOVER_S + 3
        if has_moved or number <= 10 * HOVER_S:
            assert len(frame.tracks.flying) == has_moved


@pytest.mark.nightly
def test_what_begins_to_swing_by_a_hand_does_not_fly():
    times = tuple(HOVER_S + 0.4 * np.arange(6))
    swing = Waypoints(
        times=times, positions=tuple((-5.0, -3.0 + 0.08 * (k % 2), 3.5) for k in range(6))
    )
    frames = frames_of(yard(Target(shape=Sphere(radius=0.2), motion=swing), scans=40, lidar=FINE))
    assert all(len(frame.tracks.flying) == 0 for frame in frames)
    assert len(frames[-1].tracks) == 1


def test_things_on_the_ground_and_at_walls_are_no_hovering_targets():
    post = wall((5.0, -3.0, 0.4), (0.3, 0.3, 0.8))
    sign = wall((11.2, 2.0, 3.0), (0.2, 0.4, 0.4))
    for frame in frames_of(yard(scans=14, bodies=(*YARD, post, sign)))[BURN_IN_SCANS:]:
        assert len(frame.tracks) == 0


@pytest.mark.ci_cases("shape0-4")
@pytest.mark.parametrize(
    ("shape", "kind"), [(Sphere(radius=0.03), TrackKind.CLUTTER), (Sphere(radius=0.15), None)]
)
def test_insects_are_clutter_and_small_targets_fly(shape, kind):
    way = Circle(center=(0.0, 0.0, 3.2), radius=2.5, speed=1.5, phase=0.3)
    frames = frames_of(yard(Target(shape=shape, motion=way), scans=30, lidar=FINE))
    found = [frame.tracks for frame in frames[20:] if len(frame.tracks)]
    assert found
    expected = {TrackKind.FLYING if kind is None else kind}
    assert {number for tracks in found for number in tracks.kind.tolist()} == expected
    for tracks in found:
        np.testing.assert_allclose(tracks.kind_probability.sum(axis=1), 1, atol=1e-9)


@pytest.mark.nightly
@pytest.mark.parametrize(("sensor", "seed"), [("vlp-16", 1001), ("hdl-32e", 1000)])
def test_leaves_in_the_wind_do_not_fly(sensor, seed):
    """Trees of 60 leaves of 6 cm that sway by 25 cm, from a sensor that drives past."""
    scene = scenes.windy_trees(seed, scans=100, sensor=sensor)
    detector = FlyingObjectDetector()
    frames = [detector.process(made, sensor=sensor) for made in Simulator(scene, seed=seed)]
    assert any(len(frame.tracks) for frame in frames[BURN_IN_SCANS:])  # they are seen
    assert not {number for frame in frames for number in frame.tracks.flying.id.tolist()}


@pytest.mark.ci_cases("shape0")
@pytest.mark.parametrize("shape", [Sphere(radius=0.15), Hexacopter(radius=0.325)])
def test_a_target_that_begins_beside_structure_and_stays_there_flies(shape):
    """On a circle of 0.4 m, 1.2 m before a wall: it is larger than a leaf."""
    place = (FRONT - 1.2, 3.0, 3.2)
    way = Circle(center=place, radius=0.4, speed=1.5)
    frames = frames_of(yard(Target(shape=shape, motion=way), scans=40, lidar=FINE))
    found = [len(frame.tracks.flying) for frame in frames[25:]]
    assert sum(found) >= 0.9 * len(found)


@pytest.mark.nightly
def test_a_person_whose_feet_are_out_of_view_does_not_fly():
    """From a height of 3 m and 22.5 degrees down, the feet of who is 5 m away are not seen."""
    line = ((4.0, -2.0, 0.0), (4.0, 2.0, 0.0))
    walk = Waypoints(times=(0.0, 3.0), positions=line)
    person = Target(shape=Person(height=1.85), motion=walk, clutter=True)
    frames = frames_of(yard(person, scans=30, lidar=FINE))
    assert sum(len(frame.tracks.flying) for frame in frames) == 0


@pytest.mark.nightly
def test_a_drone_as_high_as_a_person_flies():
    line = ((5.5, -2.0, 1.7), (5.5, 2.0, 1.7))
    way = Waypoints(times=(0.0, 3.0), positions=line)
    frames = frames_of(
        yard(Target(shape=Hexacopter(radius=0.325), motion=way), scans=30, lidar=FINE)
    )
    found = [len(frame.tracks.flying) for frame in frames[20:]]
    assert sum(found) >= 0.9 * len(found)


def test_rows_of_a_kind_are_chosen():
    _, frames = hovering(moves=True)
    tracks = frames[-1].tracks
    assert len(tracks.where(tracks.kind == TrackKind.GROUND)) == 0
    same = tracks.where(np.ones(len(tracks), bool))
    assert same.to_dict() == tracks.to_dict()
