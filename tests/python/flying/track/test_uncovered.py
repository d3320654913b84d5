"""A sensor drives past shop windows: what stands behind them does not fly, what flies does."""

import numpy as np
from flying_scenes import feed

from lidar_core import sim
from lidar_core.flying import FlyingObjectDetector

SCANS, SPEED = 30, 5.0
"""Scans at 10 Hz; speed of the sensor along x [m/s]."""
FRONT, BACK = 8.0, 13.0
"""Distances of the windows and of the walls behind them from the way [m]."""
GROUND = sim.Body(shape=sim.Plane(size=(200.0, 200.0)))


def box(size, position):
    return sim.Body(shape=sim.Box(size=size), position=position)


def rod(radius, low, high, place):
    shape = sim.Cylinder(radius=radius, height=high - low)
    return sim.Body(shape=shape, position=(*place, (low + high) / 2))


def shops(rng):
    """Windows with posters; behind them beams, seats on posts, lamps on cords of 3 cm."""
    found = [GROUND, box((60.0, 0.2, 4.0), (10.0, BACK, 2.0))]
    found += [box((60.0, 0.3, 0.9), (10.0, FRONT, 0.45))]
    found += [box((60.0, 0.3, 1.5), (10.0, FRONT, 3.25))]
    found += [box((60.0, BACK - FRONT, 0.1), (10.0, (FRONT + BACK) / 2, 3.05))]
    found += [box((0.4, 0.3, 4.0), (x, FRONT, 2.0)) for x in np.arange(-18.0, 40.0, 2.5)]
    for x in np.arange(-16.0, 36.0, 3.0):
        poster = (0.5, 0.05, rng.uniform(0.2, 1.0))
        found.append(box(poster, (x + rng.uniform(-1.0, 1.0), FRONT + 0.3, 1.2)))
    for x in np.arange(-16.0, 36.0):
        place = x + rng.uniform(-0.4, 0.4), rng.uniform(FRONT + 1.0, BACK - 1.0)
        seat = rng.uniform(0.7, 1.4)
        found += [rod(0.03, 0.0, seat, place), box((0.3, 0.3, 0.2), (*place, seat - 0.1))]
        place = x + rng.uniform(-0.4, 0.4), rng.uniform(FRONT + 1.0, BACK - 1.0)
        lamp = 3.0 - rng.uniform(0.1, 0.6)
        found += [rod(0.015, lamp, 3.0, place), box((0.25, 0.25, 0.15), (*place, lamp - 0.07))]
        found.append(box((0.05, BACK - FRONT, 0.1), (x, (FRONT + BACK) / 2, 2.95)))
    return tuple(found)


def way(start, velocity):
    """Straight on."""
    end = np.add(start, np.multiply(3.0, velocity))
    return sim.Waypoints(times=(0.0, 3.0), positions=(start, tuple(end.tolist())))


def drive(bodies, *targets):
    """Frames of a sensor that drives along x, with the places of the targets."""
    scene = sim.Scene(
        lidar=sim.LidarModel.preset("os1-128"),
        sensor=way((0.0, 0.0, 1.8), (SPEED, 0.0, 0.0)),
        bodies=bodies,
        targets=targets,
        scans=SCANS,
    )
    detector = FlyingObjectDetector()
    return [(made.truth, feed(detector, made)) for made in sim.simulate(scene, seed=0)]


def tracked(frames):
    """Whether the target is tracked, of the scans with five of its returns or more."""
    near = [
        (np.linalg.norm(frame.tracks.flying.position - truth.position[0], axis=1) < 0.5).any()
        for truth, frame in frames
    ]
    return np.array(near)[[truth.hits[0] >= 5 for truth, _ in frames]]


def test_what_stands_behind_windows_hardly_ever_flies():
    # Without evidence of the edges 18 tracks fly in these two drives. What is left are lamps whose
    # cords no ray meets, seen as a whole at first.
    numbers = [
        {
            number
            for _, frame in drive(shops(np.random.default_rng(seed)))
            for number in frame.tracks.flying.id.tolist()
        }
        for seed in range(2)
    ]
    assert sum(map(len, numbers)) <= 6


def test_what_flies_beside_pillars_is_tracked():
    pillars = [box((0.3, 0.3, 6.0), (x, 6.0, 3.0)) for x in np.arange(-18.0, 40.0, 2.5)]
    wall = box((60.0, 0.2, 6.0), (10.0, 14.0, 3.0))
    drone = sim.Target(
        shape=sim.Sphere(radius=0.3), motion=way((1.0, 9.0, 2.5), (SPEED - 1.0, 0.0, 0.0))
    )
    assert tracked(drive((GROUND, wall, *pillars), drone))[12:].mean() >= 0.9


def test_what_comes_out_behind_a_house_is_tracked_soon():
    house = box((10.0, 4.0, 6.0), (2.0, 8.0, 3.0))
    wall = box((60.0, 0.2, 8.0), (10.0, 20.0, 4.0))
    drone = sim.Target(shape=sim.Sphere(radius=0.3), motion=way((3.0, 12.0, 2.5), (2.0, 0.0, 0.0)))
    found = tracked(drive((GROUND, house, wall), drone))
    assert len(found) >= 12
    assert found[8:].all()
