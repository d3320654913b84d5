"""Targets far away, where the gaps between the rays are wide."""

from functools import cache

import numpy as np
from flying_scenes import feed, scans_of, wall, yard

from lidar_core.flying import ClusterConfig, FlyingConfig, FlyingObjectDetector
from lidar_core.sim import Body, LidarModel, Plane, Sphere, Spinning, Target, Waypoints

ROWS = tuple(np.linspace(4.0, -4.0, 17).tolist())  # 0.27 m apart at a range of 31 m
SPARSE = LidarModel(pattern=Spinning(elevations_deg=ROWS, columns=1024))
WALLS = (Body(shape=Plane(size=(90.0, 90.0))), wall((-12.0, 0.0, 3.0), (1.0, 20.0, 6.0)))
BURN_IN = FlyingConfig().seed.burn_in_scans


@cache
def far_scans():
    """A ball 31 m away, seen from a sensor on its way."""
    way = Waypoints(times=(0.0, 2.0), positions=((31.0, -2.0, 3.3), (31.0, 2.0, 3.0)))
    sensor = Waypoints(times=(0.0, 2.0), positions=((0.0, 0.0, 3.0), (1.0, 0.0, 3.2)))
    ball = Target(shape=Sphere(radius=0.5), motion=way)
    return scans_of(yard(ball, sensor=sensor, scans=20, bodies=WALLS, lidar=SPARSE))


def looked_at(config):
    """Numbers of detections after the burn-in, and the last frame."""
    detector = FlyingObjectDetector(config)
    frames = [feed(detector, made) for made in far_scans()]
    return [len(frame.detections) for frame in frames[BURN_IN:]], frames[-1]


def test_far_targets_are_found_with_a_long_range_only():
    counts, last = looked_at(FlyingConfig())
    assert not any(counts)
    assert not len(last.tracks)
    counts, last = looked_at(FlyingConfig.long_range())
    assert min(counts) == max(counts) == 1
    miss = np.linalg.norm(last.tracks.position - far_scans()[-1].truth.position, axis=1)
    assert len(miss) == 1
    assert miss[0] < 0.5


def test_a_far_target_falls_apart_without_the_angle():
    fixed = ClusterConfig(max_angle=0.0)
    counts, _ = looked_at(FlyingConfig.long_range().model_copy(update={"cluster": fixed}))
    assert np.mean(counts) > 2
