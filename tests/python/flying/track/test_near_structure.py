"""Targets that come close to walls keep their tracks; what stands or walks there gets none."""

from functools import cache

import numpy as np
import pytest
from flying_scenes import RADIUS, YARD, drone, feed, lidar, scans_of, yard

from lidar_core import PointClass, TrackKind, sim
from lidar_core.flying import FlyingObjectDetector
from lidar_core.sim import Body, Cylinder, Target, Waypoints

WALL = 11.5
"""Distance of the face of the wall [m]."""
NEAR = 1.0
"""Errors beyond this are of other things [m]."""


@cache
def flown(*targets, scans, bodies=YARD):
    """Scans, frames, and rows on the targets."""
    scene = yard(*targets, scans=scans, bodies=bodies, lidar=lidar(64, 480))
    made = scans_of(scene)
    detector = FlyingObjectDetector()
    frames = [feed(detector, one) for one in made]
    return made, frames, [one.label.reshape(-1) >= len(bodies) for one in made]


def to_the_wall(gap):
    """From the open to the wall, along it, and back."""
    near, height = WALL - gap - RADIUS, 3.6
    places = ((8.0, 0.0), (8.0, 0.5), (near, 1.0), (near, 2.5), (8.5, 3.5), (8.0, 4.5))
    return drone(*((x, y, height) for x, y in places), seconds=5.0)


@pytest.mark.parametrize(
    ("gap", "share"), [pytest.param(0.5, 0.95, marks=pytest.mark.nightly), (0.3, 0.8)]
)
def test_a_target_is_followed_to_a_wall_and_back(gap, share):
    made, frames, rows = flown(to_the_wall(gap), scans=50)
    tracked, numbers = [], set()
    for simulated, frame, own in list(zip(made, frames, rows, strict=True))[16:]:
        away = np.linalg.norm(frame.tracks.position - simulated.truth.position, axis=1)
        is_on = (away < NEAR) & (frame.tracks.kind == TrackKind.FLYING)
        tracked.append(bool(is_on.any()))
        numbers |= set(frame.tracks.id[is_on].tolist())
        assert not (frame.point_class[~own] == PointClass.FLYING).any()  # the wall stays
    assert np.mean(tracked[6:26]) >= share
    assert tracked[-1]
    assert len(numbers) == 1


def test_people_and_poles_beside_walls_do_not_fly():
    ways = ((8.0, -2.0, 0.0), (WALL - 0.6, -1.0, 0.0), (WALL - 0.6, 2.0, 0.0))
    person = Target(
        shape=sim.Person(height=1.75),
        motion=Waypoints(times=(1.2, 2.2, 4.0), positions=ways),
        clutter=True,
    )
    pole = Body(shape=Cylinder(radius=0.1, height=3.0), position=(WALL - 0.5, 4.0, 1.5))
    _, frames, _ = flown(person, scans=40, bodies=(*YARD, pole))
    assert not any((frame.tracks.kind == TrackKind.FLYING).any() for frame in frames)


@pytest.mark.nightly
def test_a_track_does_not_eat_the_wall_that_its_target_went_behind():
    """The target flies past the end of a wall and is hidden behind it: the wall is no target."""
    behind = drone(
        (8.0, 6.0, 3.6), (10.5, 8.0, 3.6), (14.0, 10.5, 3.6), (16.0, 6.0, 3.6), seconds=4.0
    )
    _, frames, rows = flown(behind, scans=40)
    for frame, own in zip(frames, rows, strict=True):
        assert not (frame.point_class[~own] == PointClass.FLYING).any()
