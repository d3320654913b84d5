"""Rows far apart: what no ray passes below stands on the ground; what flies low flies."""

from dataclasses import replace
from itertools import islice

import numpy as np
from flying_scenes import feed, lidar, wall

from lidar_core import TrackKind, sim
from lidar_core.flying import FlyingConfig, FlyingObjectDetector
from lidar_core.reproduce.flying.real_data.labelled_boxes import read_boxes
from lidar_core.reproduce.flying.real_data.sequences import sequence_named, sequence_scans

STREET = "street_128_labelled"


def rows_apart(item):
    """The scan with the rows of every second degree of elevation, as a sparse sensor has them."""
    points = item.scan.points
    elevation = np.degrees(np.arctan2(points[:, 2], np.hypot(points[:, 0], points[:, 1])))
    is_kept = np.round(2 * elevation) % 4 == 0
    return replace(item, scan=replace(item.scan, points=points[is_kept]))


def test_riders_and_vehicles_do_not_fly_before_rows_far_apart(recordings, monkeypatch):
    """A rider 15 m ahead: the row below meets the road in front, the rows beside behind."""
    monkeypatch.setenv("LIDAR_CORE_DATA", str(recordings))
    sequence = sequence_named(STREET)
    boxes, detector, looks = read_boxes(sequence), FlyingObjectDetector(FlyingConfig()), 0
    for number, item in enumerate(map(rows_apart, islice(sequence_scans(sequence), 20))):
        frame = detector.process(item)
        pose = item.world_from_lidar.reshape(-1, 4, 4)[0]
        places = (frame.tracks.flying.position - pose[:3, 3]) @ pose[:3, :3]
        for box in boxes[number]:
            assert not box.holds(places, 0.3).any(), (number, box.name)
            looks += frame.status.gate_open
    assert looks > 200


def test_a_ball_just_above_the_ground_flies():
    """A ball 0.9 m above a street, 15 m ahead of a sensor on a car."""
    rng, seconds, speed = np.random.default_rng(0), np.arange(0.0, 6.5, 0.5), 7.0
    ahead = speed * seconds + 15.0 + np.cumsum(rng.normal(0.0, 0.15, len(seconds)))
    aside = np.cumsum(rng.normal(0.0, 0.08, len(seconds)))

    def way(x, y, z):
        places = tuple(zip(x.tolist(), y.tolist(), [z] * len(x), strict=True))
        return sim.Waypoints(times=tuple(seconds.tolist()), positions=places)

    houses = tuple(
        wall((x, side * rng.uniform(9.0, 12.0), 3.0), (6.0, 4.0, 6.0))
        for x in range(-10, 90, 9)
        for side in (-1.0, 1.0)
    )
    scene = sim.Scene(
        bodies=(sim.Body(shape=sim.Plane(size=(200.0, 60.0)), position=(30.0, 0.0, 0.0)), *houses),
        targets=(sim.Target(shape=sim.Sphere(radius=0.35), motion=way(ahead, aside, 0.9)),),
        lidar=lidar(32, columns=720),
        sensor=way(speed * seconds, 0.0 * seconds, 1.9),
        scans=60,
    )
    detector, tracked, flying = FlyingObjectDetector(), 0, 0
    for made in sim.simulate(scene, seed=0):
        tracks = feed(detector, made).tracks
        near = np.linalg.norm(tracks.position - made.truth.position[0], axis=1) < 0.5
        tracked += int(near.any())
        flying += int((near & (tracks.kind == TrackKind.FLYING)).any())
    assert tracked >= 40
    assert flying >= 0.9 * tracked
