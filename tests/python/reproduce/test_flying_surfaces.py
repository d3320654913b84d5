"""`flying-surfaces`: which flights there are, and what is counted as sky."""

import numpy as np
import pytest

from lidar_core import sim
from lidar_core.reproduce import Request
from lidar_core.reproduce.flying import surfaces
from lidar_core.reproduce.flying.surfaces import CONDITIONS, RANGES, SENSORS, Truth

PATTERN = sim.Spinning(elevations_deg=(20.0, 10.0, 0.0, -10.0), columns=90)


def world(**changes):
    """A wall to the left that loses its returns, open sky above and around, ground below."""
    wall = sim.Body(shape=sim.Box(size=(60.0, 1.0, 60.0)), position=(0.0, 20.5, 0.0))
    return sim.Scene(
        bodies=(
            wall.model_copy(update={"surface": sim.Surface(reflectivity=0.0)}),
            sim.Body(shape=sim.Plane(size=(200.0, 200.0)), position=(0.0, 0.0, -2.0)),
        ),
        lidar=sim.LidarModel(pattern=PATTERN, delivery="dropped"),
        sensor=sim.Hover(position=(0.0, 0.0, 0.0)),
        scans=2,
        **changes,
    )


class FreeUpTo:
    """A map that is free up to some distance from the sensor."""

    def __init__(self, distance):
        self.distance = distance

    def state_at(self, points):
        return np.where(np.linalg.norm(points, axis=1) < self.distance, 0, 1)


def test_flights_take_turns_in_sensor_motion_and_target():
    todo = surfaces.jobs(Request(seed=0, scans=16_000, threads=1))
    assert {job.arguments["condition"] for job in todo} == set(CONDITIONS)
    for with_target in (False, True):
        numbers = [n for n in range(50) if surfaces.is_with_target(n) == with_target]
        seen = set()
        for number in numbers:
            made = surfaces.scene(0, number, 30, "wet")
            way = made.sensor.knots(3.0)[1][:, :3, 3]
            seen.add((surfaces.turn_of(number)[0], bool(np.ptp(way[:, 0]) > 1.0)))
            assert len(made.targets) == with_target
        assert seen == {(name, moves) for name in SENSORS for moves in (False, True)}


@pytest.mark.parametrize(("distance", "free"), [(3.0, 0), (7.0, 1), (30.0, 3)])
def test_the_true_sky_and_lost_returns_are_counted(distance, free):
    sky, *known, lost, cleared = Truth(world(), 0).count_rays(0, FreeUpTo(distance))
    clear = sim.Simulator(world().idealised(), seed=0).scan(0)
    assert sky == clear.scan.no_return.sum()
    assert 0.2 < sky / PATTERN.columns / 4 < 0.6
    assert known == [sky] * free + [0] * (len(RANGES) - free)
    wall = np.linalg.norm(clear.scan.points.reshape(-1, 3)[clear.label == 0], axis=1)
    assert lost == len(wall) > 50
    assert cleared == (wall < distance).sum()


@pytest.mark.parametrize(
    ("position", "expected"),
    [((6.0, 0.0, 1.0), True), ((0.0, 6.0, 1.0), False), ((6.0, 0.0, -0.9), False)],
)
def test_a_target_is_before_the_sky_if_nothing_is_behind_it(position, expected):
    target = sim.Target(shape=sim.Sphere(radius=0.5), motion=sim.Hover(position=position))
    scene = world(targets=(target,))
    made = sim.Simulator(scene, seed=0).scan(1)
    assert made.truth.hits[0] > 0
    assert Truth(scene, 0).is_before_sky(1, made).tolist() == [expected]
